"""Figures of a diagnosis; each draws what it is given and returns its axes."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from ffl.diagnose.prove import Overlay
from ffl.diagnose.search import Step
from ffl.diagnose.where import Forces, Map
from ffl.report.page import COLOURS

POINTS = 2000  # most points of a curve


def mismatch_map(ax: Axes, m: Map, title: str) -> Axes:
    """Power of the whitened residual over time and frequency; 1 is noise alone."""
    power = np.maximum(m.power, 0.1)
    top = max(10.0, float(np.quantile(power, 0.999)))
    mesh = ax.pcolormesh(
        m.times, m.frequencies, power, norm=LogNorm(1.0, top), cmap="Blues", shading="nearest",
        rasterized=True,
    )  # fmt: skip
    ax.set_xlabel("time [s]")
    ax.set_ylabel("frequency [Hz]")
    ax.set_title(title)
    ax.grid(False)
    ax.figure.colorbar(mesh, ax=ax, label="power / noise")
    return ax


def force_against(ax: Axes, forces: Forces, variable: str) -> Axes:
    """The force the residual asks for, and the fitted effects' force, over velocity or position."""
    x = forces.velocity if variable == "velocity" else forces.position
    step = max(1, len(x) // POINTS)
    ax.plot(x[::step], forces.wanted[::step], ".", markersize=2, color=COLOURS[6], alpha=0.35,
            label="data")  # fmt: skip
    ax.plot(
        x[::step], forces.fitted[::step], ".", markersize=2, color=COLOURS[1], label="fitted law"
    )
    unit = f"{forces.output_unit}/s" if variable == "velocity" else forces.output_unit
    ax.set_xlabel(f"{variable} [{unit}]")
    ax.set_ylabel(f"force [{forces.unit}]")
    ax.legend(markerscale=4)
    return ax


def ladder(ax: Axes, step: Step) -> Axes:
    """Bars of what each rival of one round added, fitted and held out."""
    rivals = [r for r in step.rivals if np.isfinite(r.score)][::-1]
    names = [r.model.names[-1] for r in rivals]
    at = np.arange(len(rivals))
    fitted = [r.fitted - step.before.fitted for r in rivals]
    held = [r.held_out - step.before.held_out for r in rivals]
    ax.barh(at + 0.2, fitted, 0.38, color=COLOURS[0], label="fitted")
    ax.barh(at - 0.2, held, 0.38, color=COLOURS[1], label="held out")
    ax.set_yticks(at, names)
    ax.set_xscale("symlog", linthresh=30.0)
    ax.axvline(0.0, color=COLOURS[6], linewidth=0.8)
    ax.set_xlabel("log-likelihood gained")
    ax.legend(loc="lower right")
    return ax


def overlay(ax: Axes, o: Overlay, unit: str) -> Axes:
    """Measured, simulated before, simulated after."""
    step = max(1, len(o.t) // POINTS)
    pairs = (
        ("measured", o.y, 6, "-"),
        ("before", o.y_before, 1, "--"),
        ("after", o.y_after, 0, ":"),
    )
    for label, y, colour, line in pairs:
        ax.plot(o.t[::step], y[::step], line, color=COLOURS[colour], label=label)
    ax.set_ylabel(f"y [{unit}]")
    ax.legend(ncols=3)
    return ax


def errors(ax: Axes, o: Overlay, unit: str) -> Axes:
    """What is left, before and after."""
    step = max(1, len(o.t) // POINTS)
    ax.plot(o.t[::step], (o.y - o.y_before)[::step], color=COLOURS[1], label="before")
    ax.plot(o.t[::step], (o.y - o.y_after)[::step], color=COLOURS[0], label="after")
    ax.set_xlabel("time [s]")
    ax.set_ylabel(f"y - simulation [{unit}]")
    ax.legend(ncols=2)
    return ax

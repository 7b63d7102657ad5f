"""Figures of a diagnosis; each draws what it is given and returns its axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.rounds import Step
from ffl.diagnose.maps.picture import MapPicture
from ffl.diagnose.proof.advise import Experiment
from ffl.diagnose.proof.prove import Overlay
from ffl.diagnose.recorded.where import Forces, Map
from ffl.effects import is_speed
from ffl.effects.position_dependent_friction import drawn_out
from ffl.report.page import COLOURS

POINTS = 2000  # most points of a curve
LINEAR = 30.0  # log-likelihood up to which bars are drawn to scale
TICKS = 4  # of a map, at most: two stand side by side
FEW = 3  # decades that leave room for ticks between them


def _seconds(ax: Axes) -> None:
    """Time along x, without a power of ten: a clock counts the seconds of the day."""
    ax.ticklabel_format(axis="x", style="plain", useOffset=False)
    ax.set_xlabel("time [s]")


def mismatch_map(ax: Axes, m: Map, title: str, top: float) -> Axes:
    """Power of the whitened residual over time and frequency, pale where it is noise alone, darkest at
    `top`."""
    mesh = ax.pcolormesh(
        m.times, m.frequencies, np.maximum(m.power, 0.1), norm=LogNorm(1.0, top), cmap="YlOrRd",
        shading="nearest", rasterized=True,
    )  # fmt: skip
    if m.frequencies[-1] > 100.0:
        ax.set_yscale("symlog", linthresh=m.frequencies[-1] / 20)
        ax.set_ylim(0.0, m.frequencies[-1])
    ax.locator_params(axis="x", nbins=TICKS)
    _seconds(ax)
    ax.set_ylabel("frequency [Hz]")
    ax.set_title(title)
    ax.grid(False)
    ax.figure.colorbar(mesh, ax=ax, label="power / noise")
    return ax


def force_against(ax: Axes, forces: Forces, variable: str) -> Axes:
    """The force the residual asks for as dots, the fitted effects' force over it as a line along the
    motion, over velocity or position."""
    x = forces.velocity if variable == "velocity" else forces.position
    step = max(1, len(x) // POINTS)
    ax.plot(x[::step], forces.wanted[::step], ".", markersize=3, color=COLOURS[5], alpha=0.4,
            label="asked for by the data", rasterized=True)  # fmt: skip
    ax.plot(
        x[::step], forces.fitted[::step], ".", markersize=1.5, color=COLOURS[1], label="fitted law",
        rasterized=True,
    )  # fmt: skip
    unit = forces.output_unit
    if is_speed(unit):
        unit = unit if variable == "velocity" else f"{unit} s"
    elif variable == "velocity":
        unit = f"{unit}/s"
    ax.set_xlabel(f"{variable} [{unit}]")
    ax.set_ylabel(f"force [{forces.unit}]")
    ax.legend(markerscale=4)
    return ax


def map_with_data(ax: Axes, p: MapPicture) -> Axes:
    """A map without a name: data as dots, the map as a line, the simplest formula dashed."""
    step = max(1, len(p.x) // POINTS)
    low, high = np.quantile(p.wanted, [0.002, 0.998])
    ax.plot(p.x[::step], p.wanted[::step], ".", markersize=3, color=COLOURS[5], alpha=0.4,
            label="asked for by the data", rasterized=True)  # fmt: skip
    if p.along:  # it has no one value for each x
        ax.plot(p.grid[::step], p.values[::step], ".", color=COLOURS[1], markersize=1.5,
                label="free map", rasterized=True)  # fmt: skip
    else:
        ax.plot(p.grid, p.values, color=COLOURS[1], linewidth=2.0, label="free map")
    if p.formula is not None:
        ax.plot(p.grid, p.formula, "--", color=COLOURS[6], label="formula")
        low, high = min(low, p.formula.min()), max(high, p.formula.max())
    seen = (p.grid >= p.x.min()) & (p.grid <= p.x.max())
    low = min(low, p.values[seen].min(initial=low))
    high = max(high, p.values[seen].max(initial=high))
    ax.set_xlim(p.x.min(), p.x.max())
    ax.set_ylim(low - 0.08 * (high - low), high + 0.08 * (high - low))
    ax.set_xlabel(p.x_label)
    ax.set_ylabel(p.y_label)
    ax.set_title(p.title)
    ax.legend(markerscale=4)
    return ax


def experiment(ax: Axes, e: Experiment, unit: str, input_unit: str) -> Axes:
    """The suggested reference, or command where there is no reference."""
    step = max(1, len(e.t) // POINTS)
    closed = np.ptp(e.r) > 0
    signal = e.r if closed else e.f
    ax.plot(e.t[::step], signal[::step], color=COLOURS[0])
    _seconds(ax)
    ax.set_ylabel(f"reference [{unit}]" if closed else f"command [{input_unit}]")
    return ax


def separations(ax: Axes, e: Experiment) -> Axes:
    """What each experiment that was tried in simulation would tell."""
    tried = e.tried[::-1]
    at = np.arange(len(tried))
    colours = [COLOURS[2] if text == e.text else COLOURS[5] for text, _ in tried]
    ax.barh(at, [value for _, value in tried], color=colours)
    ax.set_yticks(at, [text.split(":")[0] for text, _ in tried], fontsize=8)
    said = "separation [standard deviations]" if e.rivals[1] else "standard error falls by [factor]"
    ax.set_xlabel(said, loc="right")  # it is wider than its axes
    return ax


def ports(ax: Axes, ranked: Sequence[tuple[str, float]]) -> Axes:
    """Log-evidence of the best map at each port."""
    at = np.arange(len(ranked))
    ax.barh(at, [value for _, value in ranked][::-1], color=COLOURS[0])
    ax.set_yticks(at, [name for name, _ in ranked][::-1])
    _signed_log(ax, [value for _, value in ranked])
    ax.set_xlabel("log-evidence of the best map there, over none")
    return ax


def _signed_log(ax: Axes, values: Sequence[float]) -> None:
    """The x axis of bars of either sign: to scale up to LINEAR, beyond it logarithmic, with ticks between
    the decades where there are few of these."""
    low, high = min([0.0, *values]), max([0.0, *values])
    if max(-low, high) <= LINEAR:
        return
    ax.set_xscale("symlog", linthresh=LINEAR)
    decades = 10.0 ** np.arange(1, np.floor(np.log10(max(-low, high))) + 1)
    between = {1: (1.0, 2.0, 3.0, 5.0), 2: (1.0, 3.0), 3: (1.0, 3.0)}.get(len(decades), (1.0,))
    steps = np.outer(decades, between).ravel()
    if len(decades) > FEW:
        steps = steps[1:]  # 10 and -10 stand too near 0
    both = np.concatenate([-steps[::-1], [0.0], steps])
    ax.set_xticks(both[(both >= low) & (both <= high)])
    if len(decades) <= FEW:
        ax.xaxis.set_major_formatter("{x:,.0f}")
    ax.minorticks_off()


def _label(rival: Judged) -> str:
    """The last effect's name and the side it acts on."""
    spec = rival.model.effects[-1]
    side = spec.options.get("side")
    return f"{spec.name}, {side}" if side else spec.name


def friction_table(
    ax: Axes, table: Mapping[str, Sequence[float]], unit: str, output_unit: str, label: str = "",
    smooth: bool = False,
) -> Axes:  # fmt: skip
    """Levels of dry friction over position, moving up and down; `smooth`: on a curve between knots."""
    curve = drawn_out(table) if smooth else table
    for key, colour, side in (("positive", 0, "moving up"), ("negative", 1, "moving down")):
        own, name = COLOURS[colour], f"{side}{label}"
        if label:
            ax.plot(table["grid"], table[key], ".", color=own, label=name, markersize=5)
        else:
            ax.plot(curve["grid"], curve[key], "-", color=own, label=name)
            ax.plot(table["grid"], table[key], ".", color=own, markersize=3)
    ax.set_xlabel(f"position [{output_unit}]")
    ax.set_ylabel(f"level [{unit}]")
    ax.legend()
    return ax


def ladder(ax: Axes, step: Step) -> Axes:
    """Bars of what each rival of one round added, fitted and held out."""
    best: dict[str, Judged] = {}
    for r in sorted((r for r in step.rivals if np.isfinite(r.score)), key=lambda r: -r.score):
        best.setdefault(_label(r), r)
    names, rivals = list(best)[::-1], list(best.values())[::-1]
    at = np.arange(len(rivals))
    fitted = [r.fitted - step.before.fitted for r in rivals]
    held = [r.held_out - step.before.held_out for r in rivals]
    ax.barh(at + 0.2, fitted, 0.38, color=COLOURS[0], label="fitted")
    ax.barh(at - 0.2, held, 0.38, color=COLOURS[1], label="held out")
    ax.set_yticks(at, names)
    _signed_log(ax, [*fitted, *held])
    ax.axvline(0.0, color=COLOURS[6], linewidth=0.8)
    ax.set_xlabel("log-likelihood gained")
    ax.legend(ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))  # above: bars fill the axes
    return ax


def overlay(ax: Axes, o: Overlay, unit: str, after: str = "after") -> Axes:
    """Measured, simulated before, simulated `after`, as the legend calls it."""
    step = max(1, len(o.t) // POINTS)
    pairs = (
        ("measured", o.y, 6, "-"),
        ("before", o.y_before, 1, "--"),
        (after, o.y_after, 0, ":"),
    )
    for label, y, colour, line in pairs:
        ax.plot(o.t[::step], y[::step], line, color=COLOURS[colour], label=label)
    ax.set_ylabel(f"y [{unit}]")
    ax.legend(ncols=3)
    return ax


def errors(ax: Axes, o: Overlay, unit: str, after: str = "after") -> Axes:
    """What is left, before and `after`, as the legend calls it."""
    step = max(1, len(o.t) // POINTS)
    ax.plot(o.t[::step], (o.y - o.y_before)[::step], color=COLOURS[1], label="before")
    ax.plot(o.t[::step], (o.y - o.y_after)[::step], color=COLOURS[0], label=after)
    _seconds(ax)
    ax.set_ylabel(f"y - simulation [{unit}]")
    ax.legend(ncols=2)
    return ax

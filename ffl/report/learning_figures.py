"""Figures of a learning campaign; each draws what it is given and returns its axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, MultipleLocator, SymmetricalLogLocator

from ffl.report.page import COLOURS, LINES, MARKERS, Dash
from ffl.systems.state_space import Array

LINEAR = 2.0  # times its last value: where a parameter went farther, a picture of it is logarithmic
Curve = tuple[str, Array]  # label, values


class Look(TypedDict):
    """Colour and dash of a line."""

    color: str
    linestyle: Dash


def look(index: int) -> Look:
    """Colour and dash of the index-th run, the same in every figure."""
    return {"color": COLOURS[index % len(COLOURS)], "linestyle": LINES[index % len(LINES)]}


def error_per_trial(ax: Axes, runs: Sequence[Curve], unit: str) -> Axes:
    """2-norm of the error of every trial, logarithmic."""
    for index, (label, norms) in enumerate(runs):
        trials = np.arange(1, len(norms) + 1)
        marker = MARKERS[index % len(MARKERS)]
        ax.semilogy(trials, norms, marker=marker, markersize=5, label=label, **look(index))
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlabel("trial")
    ax.set_ylabel(f"$\\|e_j\\|_2$ [{unit}]")
    ax.legend(ncols=2)
    return ax


def over_time(
    ax: Axes, time: Array, runs: Sequence[Curve], label: str, marks: Sequence[float] = ()
) -> Axes:
    """Signals over time with dotted lines at `marks` (start and end of the motion)."""
    for index, (_, values) in enumerate(runs):
        ax.plot(time, values, linewidth=1.1, **look(index))
    for mark in marks:
        ax.axvline(mark, color="#1b1f24", linestyle=":", linewidth=1.0)
    ax.set_xlim(time[0], time[-1])
    ax.ticklabel_format(axis="x", style="plain")
    ax.set_xlabel("time [s]")
    ax.set_ylabel(label)
    return ax


def bode(
    magnitude_ax: Axes,
    phase_ax: Axes,
    frequencies: Array,
    plants: Sequence[Curve],
    inverses: Sequence[tuple[int, str, Array]],
    band: tuple[float, float],
    gain_unit: str,
) -> tuple[Axes, Axes]:
    """Magnitude and phase of plants (dark) and of F^-1 (the runs' colours); `band` is shaded."""
    greys: list[Look] = [{"color": colour, "linestyle": "-"} for colour in ("#1b1f24", "#8a939c")]
    curves = [(greys[k % 2], 2.4, label, h) for k, (label, h) in enumerate(plants)]
    curves += [(look(index), 1.3, label, response) for index, label, response in inverses]
    for style, width, label, response in curves:
        magnitude_ax.loglog(frequencies, np.abs(response), label=label, linewidth=width, **style)
        phase = np.degrees(np.unwrap(np.angle(response)))
        phase -= 360.0 * np.round((phase[0] + 180.0) / 360.0)
        phase_ax.semilogx(frequencies, phase, linewidth=width, **style)
    for ax in (magnitude_ax, phase_ax):
        ax.axvspan(*band, color="#f0e442", alpha=0.18, linewidth=0)
        ax.set_xlim(frequencies[0], frequencies[-1])
    magnitude_ax.set_ylabel(f"magnitude [{gain_unit}]")
    phase_ax.set_ylabel("phase [deg]")
    phase_ax.set_xlabel("frequency [Hz]")
    low, high = phase_ax.get_ylim()
    step = next((s for s in (15, 30, 45, 90, 180, 360) if (high - low) / s <= 8), 720)
    phase_ax.yaxis.set_major_locator(MultipleLocator(step))
    magnitude_ax.legend(ncols=2)
    return magnitude_ax, phase_ax


def impulse(ax: Axes, time: Array, response: Array, unit: str) -> Axes:
    """Impulse response; zero is drawn so that a first move the wrong way is seen."""
    ax.axhline(0.0, color="#57606a", linewidth=0.8)
    ax.plot(time, response, color=COLOURS[0])
    ax.set_xlim(time[0], time[-1])
    ax.set_xlabel("time [s]")
    ax.set_ylabel(f"impulse response [{unit}]")
    return ax


def cumulative(
    ax: Axes, curves: Sequence[tuple[int, str, Array, Array]], sample_time: float
) -> Axes:
    """Cumulative power of the error in per cent of the group's largest."""
    for index, label, frequencies, percent in curves:
        ax.semilogx(frequencies[1:], percent[1:], label=label, **look(index))
    first = min((c[2][1] for c in curves), default=0.1)
    ax.set_xlim(max(first, 0.05), 0.5 / sample_time)
    ax.set_ylim(0, 105)
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel("cumulative power of $e$ [%]")
    ax.legend(loc="lower right")
    return ax


def parameters(ax: Axes, theta: Array, title: str) -> Axes:
    """Each parameter over the trials, relative to the magnitude of its last value."""
    last = np.abs(theta[-1])
    relative = theta[:, last > 0] / last[last > 0]
    trials = np.arange(1, len(theta) + 1)
    for k, column in enumerate(relative.T):
        ax.plot(trials, column, color=COLOURS[k % 6], linestyle=LINES[(k // 6) % 6], linewidth=1.1)
    if np.abs(relative).max(initial=0.0) > LINEAR:
        ax.set_yscale("symlog", linthresh=LINEAR)
        ax.yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=LINEAR))
    ax.set_title(title)
    ax.set_xlabel("trial")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=6))
    return ax

"""Figures 3, 4 and 5 of the 2018 kernel paper, and an inverse with its band; drawn, not computed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from ffl.identify.inverse import IdentifiedInverse
from ffl.identify.kernel2018 import Example6, Kernel2018
from ffl.report.page import COLOURS, LINES

LABELS = {
    "perfect": "perfect inverse",
    "least_squares": "least squares",
    "causal_kernel": "causal kernel",
    "noncausal_kernel": "non-causal kernel",
    "data_driven_poles": "poles from data",
    "as_printed": "as printed",
}
FIGURE_4 = ("least_squares", "causal_kernel", "noncausal_kernel")


def figure_3(example: Example6, axes: Sequence[Axes]) -> Sequence[Axes]:
    """Feedforward of both readings of Example 6 (top), and their outputs (bottom)."""
    top, bottom = axes
    t = example.t
    top.plot(t, example.noncausal, color=COLOURS[0], marker="o", ms=3, label="two-sided, bounded")
    top.plot(t, example.causal, color=COLOURS[1], linestyle="--", label="causal, unbounded")
    top.set_ylim(-1.5, 8.0)
    top.set_ylabel("feedforward [1]")
    top.legend()
    bottom.plot(t, example.noncausal_output, color=COLOURS[0], marker="o", ms=3, label="two-sided")
    bottom.plot(t, example.causal_output, color=COLOURS[1], linestyle="--", label="causal")
    bottom.plot(t, example.reference, color="#1b1f24", linestyle=":", label="reference")
    bottom.set_xlabel("t [samples]")
    bottom.set_ylabel("output [1]")
    bottom.legend()
    return axes


def figure_4(result: Kernel2018, ax: Axes, limit: float = 1.0) -> Axes:
    """Impulse responses estimated from one realisation; the three direct taps run off the scale."""
    for index, name in enumerate(FIGURE_4):
        found = result.estimates[name]
        ax.plot(
            found.lags,
            found.theta,
            color=COLOURS[(index + 1) % len(COLOURS)],
            linewidth=(0.4, 0.4, 2.2)[index],
            alpha=(0.35, 0.6, 1.0)[index],
            label=LABELS[name],
        )
    ax.plot(
        found.lags, result.true_taps, color="#1b1f24", linewidth=1.2, linestyle="--", label="true"
    )
    ax.set_ylim(-limit, limit)
    ax.set_xlabel("lag k [samples]")
    ax.set_ylabel("$\\theta_k$ [1]")
    for line in ax.legend(ncols=2).get_lines():
        line.set(alpha=1.0, linewidth=1.5)
    return ax


def figure_5(result: Kernel2018, ax: Axes, skip: Sequence[str] = ("as_printed",)) -> Axes:
    """Histograms of ||e||/sqrt(N) over the realisations, on common bins."""
    shown = [name for name in result.methods if name not in skip]
    columns = [result.errors[:, result.methods.index(name)] for name in shown]
    bins = np.linspace(min(c.min() for c in columns), max(c.max() for c in columns), 80).tolist()
    for index, (name, values) in enumerate(zip(shown, columns, strict=True)):
        colour = COLOURS[index % len(COLOURS)]
        ax.hist(values, bins, histtype="stepfilled", alpha=0.25, color=colour)
        ax.hist(values, bins, histtype="step", color=colour, label=LABELS[name])
    ax.axvline(1.0, color="#1b1f24", linestyle="--", linewidth=1.0, label="noise $\\sigma_y$")
    ax.set_xlabel("$\\|e\\|_2/\\sqrt{N}$ [1]")
    ax.set_ylabel("realisations [1]")
    ax.legend()
    return ax


def frequency_response(
    inverses: Mapping[str, IdentifiedInverse],
    frequencies_hz: ArrayLike,
    ax: Axes,
    level: float = 0.95,
) -> Axes:
    """|F| of identified inverses with their credible bands, on logarithmic axes."""
    f = np.asarray(frequencies_hz, float)
    for index, (name, inverse) in enumerate(inverses.items()):
        band = inverse.magnitude_band(f, level)
        colour = COLOURS[index % len(COLOURS)]
        ax.fill_between(f, band.lower, band.upper, color=colour, alpha=0.2, linewidth=0)
        ax.loglog(f, band.middle, color=colour, linestyle=LINES[index % len(LINES)], label=name)
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel("|F| [command per output]")
    ax.legend()
    return ax

"""Figures 3 and 4 of the 2025 Bayesian paper, and what a chain looks like; drawn, not computed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from ffl.identify.bayes.table import METHODS, PAPER, TableOne
from ffl.report.page import COLOURS

LABELS = {
    "naive": "naive",
    "two_step": "two-step",
    "algorithm_1_as_printed": "Algorithm 1\nas printed",
    "algorithm_1": "Algorithm 1\ncorrected",
    "best": "posterior\nmean",
    "oracle": "oracle",
}
INK = "#1b1f24"


def figure_3(table: TableOne, axes: Sequence[Axes]) -> Sequence[Axes]:
    """True impulse responses of (21): forward (left axes), bounded inverse (right axes)."""
    left, right = axes
    left.plot(table.forward_impulse, color=COLOURS[0], marker="o", ms=3)
    left.set_title("forward system", fontsize="medium")
    right.plot(table.inverse_taps, table.inverse_impulse, color=COLOURS[0], marker="o", ms=3)
    right.set_title("inverse system, non-causal", fontsize="medium")
    for ax in axes:
        ax.axhline(0.0, color=INK, linewidth=0.5)
        ax.set_xlabel("t [samples]")
        ax.set_ylabel("impulse response [1]")
    return axes


def figure_4(table: TableOne, axes: Sequence[Axes], floor: float = 0.0) -> Sequence[Axes]:
    """Box plots of the fits: two-step forward models (left axes), inverse models (right axes).

    Fits below `floor` are counted under their box instead of drawn; the paper's mean is a cross.
    """
    left, right = axes
    _boxes(left, [table.forward_fits], ["two-step,\nforward"], floor)
    _boxes(right, [table.fits[m] for m in METHODS], [LABELS[m] for m in METHODS], floor)
    marks = [(i + 1, PAPER[m]) for i, m in enumerate(METHODS) if m in PAPER]
    right.plot(*zip(*marks, strict=True), "x", color=COLOURS[1], ms=7, label="mean in the paper")
    right.legend(loc="lower right")
    return axes


def _boxes(ax: Axes, fits: list[np.ndarray], labels: list[str], floor: float) -> None:
    ax.boxplot(fits, tick_labels=labels, whis=1.5, medianprops={"color": COLOURS[0]})
    ax.set_ylim(floor, 101.0)
    for i, values in enumerate(fits):
        below = int(np.sum(values < floor))
        if below:
            ax.annotate(
                f"{below} below", (i + 1, floor), ha="center", va="bottom", fontsize="small"
            )
    ax.set_ylabel("fit (25) [%]")
    ax.tick_params(axis="x", labelsize="small")

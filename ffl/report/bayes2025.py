"""The page of `ffl reproduce bayes2025`: Table I, Figures 3 and 4 beside ours."""

from __future__ import annotations

import numpy as np

from ffl.identify.bayes import TableOne
from ffl.report import bayes_figures as draw
from ffl.report.page import Page, drawing, subplots


def page(result: TableOne) -> Page:
    """Everything `reproduce` measured, as one self-contained page."""
    made = Page(
        "The 2025 Bayesian paper, reproduced",
        "Suzuki, Oomen, Gonzalez: direct Bayesian identification of inverse systems. "
        f"{len(result.seeds)} data sets, seeds {result.seeds[0]} to {result.seeds[-1]}; "
        f"{result.draws_per_e_step} draws per E-step (the paper: 100,000).",
    )
    made.section("Table I").table(
        ["key", "what", "paper", "ours", "standard error", "unit", "n"],
        [
            [row.key, row.what, row.paper, row.ours, row.std_error, row.unit, row.n]
            for row in result.rows
        ],
        "Mean fit (25) without outliers by the 1.5 IQR rule; the rows ending in _all keep them. "
        "Dropped: " + ", ".join(f"{name} {count}" for name, count in result.dropped.items()) + ".",
    )
    made.text(
        f"Gain of the posterior mean over Algorithm 1 in the same data set: {result.paired_gain:.2f} "
        f"points, standard error {result.paired_gain_std_error:.2f}. Effective sample size of the "
        f"importance sampling: median {np.median(result.effective_sample_sizes):.0f}. Outcomes: "
        + ", ".join(f"{name} {count}" for name, count in result.statuses.items())
        + "."
    )
    with drawing():
        figure, axes = subplots(8.6, 2.9, 1, 2)
        draw.figure_3(result, axes)
    made.section("The system").figure(
        figure,
        "Forward system (21) and its bounded inverse",
        "The forward response is causal; its bounded inverse has taps before time zero. "
        "Counterpart of Figure 3.",
    )
    with drawing():
        figure, axes = subplots(8.6, 4.0, 1, 2, width_ratios=[1, 4])
        draw.figure_4(result, axes)
    made.section("All data sets").figure(
        figure,
        "Fits of forward and inverse models",
        "Each box holds the middle half of the data sets, its line the median; crosses are the "
        "paper's means. The oracle sees the noise-free output, which nobody has. Counterpart of "
        "Figure 4.",
    )
    return made

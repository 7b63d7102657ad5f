"""The page of `ffl reproduce kernel2018`: Figures 3, 4 and 5 and their numbers beside ours."""

from __future__ import annotations

import numpy as np

from ffl.identify.kernel2018 import Kernel2018
from ffl.report import kernel2018_figures as draw
from ffl.report.page import Page, drawing, subplots


def page(result: Kernel2018) -> Page:
    """Everything `reproduce` measured, as one self-contained page."""
    n = len(result.errors)
    made = Page(
        "The 2018 kernel paper, reproduced",
        "Blanken, van den Meijdenberg, Oomen: inverse system estimation for feedforward, a "
        f"kernel-based approach. {n} realisations, seed {result.seed}.",
    )
    made.section("Numbers").table(
        ["key", "what", "paper", "ours", "standard error", "unit", "n"],
        [
            [row.key, row.what, row.paper, row.ours, row.std_error, row.unit, row.n]
            for row in result.rows
        ],
        "Mean of the tracking error on a new reference. Chance moves all methods of a realisation "
        "together, so the rows ending in _excess, paired with the perfect inverse in the same "
        "realisation, tell them apart.",
    )
    made.text(
        f"The 95 % band of the estimate with poles from data holds {result.coverage:.1%} of the "
        "true taps."
    )
    with drawing():
        figure, axes = subplots(8.6, 4.6, 2, 1, sharex=True)
        draw.figure_3(result.example6, axes)
    made.section("Exact inversion").figure(
        figure,
        "Bounded and unbounded inverse of Example 6",
        "P = (z - 2)/z has its zero outside the unit circle. Solved causally its inverse grows "
        "without bound, solved in both directions of time it stays bounded and begins before the "
        "reference does; the output is the same. Counterpart of Figure 3.",
    )
    with drawing():
        figure, axes = subplots(8.6, 6.0, 2, 1)
        draw.figure_4(result, axes[0])
        draw.figure_4(result, axes[1], 1.1 * float(np.abs(result.true_taps).max()))
        axes[0].set_title("as in the paper")
        axes[1].set_title("all of it: the three direct taps")
    made.section("One realisation").figure(
        figure,
        "Estimated taps of the inverse",
        "Least squares pays for its 601 free taps with noise at every lag; the non-causal kernel "
        "knows that the inverse is smooth away from lag zero. The plant has relative degree 2, so "
        "three taps stand far above the rest (bottom) and need direct terms. Counterpart of "
        "Figure 4.",
    )
    with drawing():
        figure, ax = subplots(8.6, 3.8)
        draw.figure_5(result, ax)
    made.section("All realisations").figure(
        figure,
        "Tracking error on a new reference",
        "Further left is better; the dashed line is the noise that no feedforward removes. A "
        "histogram that lies on that of the perfect inverse leaves nothing to learn. Counterpart "
        "of Figure 5.",
    )
    return made

"""Axes that can be read, and tables that say with what a figure was reached."""

from __future__ import annotations

import re
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest

from ffl.diagnose.proof.prove import Proof
from ffl.diagnose.recorded.where import Map
from ffl.report.diagnosis import _proof
from ffl.report.diagnosis_figures import _signed_log, mismatch_map
from ffl.report.page import Page, drawing, subplots


@pytest.mark.parametrize(
    "values", [[31.0], [90.0, 12.0], [1000.0, -150.0], [-4e4, 120.0], [1.2e5, 2e3], [4e8]]
)
def test_bars_beyond_the_scale_have_ticks_that_place_them(values):
    figure, ax = plt.subplots()
    ax.barh(range(len(values)), values)
    _signed_log(ax, values)
    figure.canvas.draw()
    longest = max(values, key=abs)
    beside = [t for t in ax.get_xticks() if t * longest > 0]
    assert len(beside) >= 3
    assert abs(longest) / max(abs(t) for t in beside) < 10.0
    assert all(label.get_text() for label in ax.get_xticklabels())
    plt.close(figure)


def test_a_map_by_the_clock_has_room_for_its_seconds():
    """From ten o'clock on: 36,000 s, and not 3.6 beside a power of ten."""
    times, frequencies = 36000.0 + np.linspace(0.0, 170.0, 30), np.linspace(0.0, 5.0, 20)
    m = Map("dive", times, frequencies, np.full((20, 30), 3.0))
    with drawing():
        _, pair = subplots(rows=1, columns=2, sharey=True)
        for ax in pair:
            mismatch_map(ax, m, "before", 10.0)
            low, high = ax.get_xlim()
            told = [re.findall(r"\d+(?:\.\d+)?", k.get_text()) for k in ax.get_xticklabels()]
            assert 2 <= sum(low <= float(t) <= high for (t,) in told) <= 4


def test_a_few_units_are_to_scale():
    figure, ax = plt.subplots()
    _signed_log(ax, [29.0, -5.0])
    assert ax.get_xscale() == "linear"
    plt.close(figure)


@pytest.mark.parametrize("mapped", [True, False])
def test_the_table_of_the_proof_says_what_the_errors_are_with(mapped):
    proof = Proof(
        ("a.csv",), 0.1, 0.08, 0.02, 0.3, 0.25, 0.05, (-0.1, 0.0), (),
        0.03 if mapped else None, u_nrmse_with_map=0.04 if mapped else None,
    )  # fmt: skip
    page = Page("t")
    _proof(page, SimpleNamespace(proof=proof))  # type: ignore[arg-type]
    html = page.html()
    assert ("without the map" in html) == mapped
    assert ("nrmse after, with the map" in html) == mapped
    assert ("0.03" in html, "0.04" in html) == (mapped, mapped)

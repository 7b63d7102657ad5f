"""The printer paper's numbers, as regression tests."""

import numpy as np
import pytest

from ffl.campaign import printer2018


def test_example_1_errors_are_those_of_the_check():
    """0.528, 0.333, 0.037 for the 100-tap FIR, the 4th- and the 12th-order OBF."""
    example = printer2018.example_1()
    errors = [fit.relative_error for fit in example.fits]
    assert errors == pytest.approx([0.5285, 0.3333, 0.0370], abs=5e-4)
    best = example.fits[2]
    assert (
        np.abs(best.impulse - example.true_impulse).max() < 0.1 * np.abs(example.true_impulse).max()
    )


@pytest.fixture(scope="module")
def reproduction():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(printer2018, "FAST_MACHINES", 2)
        patch.setattr(printer2018, "TRIALS", 6)
        return printer2018.reproduce(fast=True)


def test_section_iv_ranks_as_in_the_paper(reproduction):
    rows = {row.key: row for row in reproduction.rows}
    assert rows["obf_below_fir"].paper == 0.45
    assert rows["obf_below_fir"].ours >= 0.45
    assert rows["repetition_below_obf"].paper == 0.23
    assert rows["repetition_below_obf"].ours >= 0.23
    assert rows["obf_below_fir_placed"].ours > 0.45
    assert rows["obf_below_fir_median"].n == 2


def test_parameters_carry_over_to_a_reference_never_learned(reproduction):
    rows = {row.key: row.ours for row in reproduction.rows}
    for name in ("obf", "obf_repeated"):
        assert rows[f"carried_{name}"] < 0.005
        assert rows[f"carried_{name}"] < 0.3 * rows["carried_fir"]


def test_the_page_holds_every_row_and_figure(reproduction):
    from ffl.report.printer2018 import page

    html = page(reproduction).html()
    assert html.count("<figure") >= 4
    for row in reproduction.rows[:4]:
        assert row.what.split(",")[0].replace("|", "|") in html.replace("&#124;", "|")


def test_rows_leave_out_what_is_not_known(reproduction):
    first = reproduction.rows[0].as_dict()
    assert {"key", "what", "paper", "ours", "unit", "n"} == set(first)
    assert all(value is not None for row in reproduction.rows for value in row.as_dict().values())

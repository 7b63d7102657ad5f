"""The circle closed, on one machine: the stall, the effects, the drop."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from ffl.campaign import load_campaign
from ffl.campaign.missing_physics import COGGING, FRICTION, draw_effects, last, story
from ffl.report.missing_physics import error_norms, table, write

CAMPAIGN = Path(__file__).parents[2] / "campaigns" / "printer_with_missing_physics.toml"


@pytest.fixture(scope="module")
def told():
    campaign = load_campaign(CAMPAIGN)
    return story(campaign, draw_effects(0, 180.0, 0.3), 0, before=7, after=5)


def test_sizes_are_drawn_from_the_ranges_of_real_printers():
    drawn = [draw_effects(seed, 180.0, 0.3) for seed in range(200)]
    levels = np.array([d[0].parameters["level"] for d in drawn]) / 180.0
    waves = np.array([d[1].parameters["amplitude"] for d in drawn]) / 180.0
    for values, (low, high) in ((levels, FRICTION), (waves, COGGING)):
        assert low <= values.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < values.max() <= high
    assert draw_effects(3, 180.0, 0.3) == drawn[3]


def test_linear_learning_stalls_far_above_its_promise(told):
    assert last(told.linear) > 50 * last(told.linear_promised)


@pytest.mark.parametrize("way", ["held", "learned"])
def test_true_effects_bring_the_error_down_and_carry_over(told, way):
    assert told.drop(way) > 0.6
    assert told.extrapolation(way) > 0.5


def test_a_wrong_diagnosis_brings_less():
    """The effects with opposite cogging and half the friction, given as found."""
    campaign = load_campaign(CAMPAIGN)
    true = draw_effects(0, 180.0, 0.3)

    def wrong(model, recordings):
        assert len(recordings) == 6
        other = draw_effects(5, 40.0, 0.3)
        return other

    told = story(campaign, true, 0, found=wrong, before=6, after=3)
    assert told.found != told.true
    assert told.drop("held") < 0.6


def test_the_report_states_every_machine(told, tmp_path):
    write([told], tmp_path, "# before", "after")
    text = (tmp_path / "missing_physics.md").read_text()
    assert f"{100 * told.drop('learned'):.0f} %" in text
    assert table([told]) in text
    assert (tmp_path / "missing_physics.png").stat().st_size > 10000
    axes = error_norms([told], Figure().subplots())
    assert axes.get_ylabel() == "2-norm of the error (m)"

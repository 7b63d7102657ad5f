"""The circle closed, on one machine: the stall, the effects, the drop."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from ffl.campaign import load_campaign
from ffl.campaign.missing_physics import COGGING, FRICTION, diagnosed, draw_effects, last, story
from ffl.report.missing_physics import error_norms, exactly_named, named, table, write
from ffl.systems import EffectSpec

CAMPAIGN = Path(__file__).parents[2] / "campaigns" / "printer_with_missing_physics.toml"


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """The campaign, forth and back once instead of three moves, and a scan of three instead of four."""
    text = CAMPAIGN.read_text()
    for old, new in (("start = 1.5", "start = 1.0"), ("start = 3.5", "start = 2.6")):
        assert old in text
        text = text.replace(old, new)
    lines = [line for line in text.splitlines() if "start = 5." not in line]
    text = "\n".join(lines).replace("duration = 8.0\n", "duration = 4.6\n", 1)
    path = tmp_path_factory.mktemp("campaign") / CAMPAIGN.name
    path.write_text(text.replace("duration = 8.0, moves", "duration = 5.2, moves"))
    return load_campaign(path)


@pytest.fixture(scope="module")
def told(campaign):
    return story(campaign, draw_effects(2, 180.0, 0.3), 2, before=8, after=4, courses=1)


def test_sizes_are_drawn_from_the_ranges_of_real_printers():
    drawn = [draw_effects(seed, 180.0, 0.3) for seed in range(200)]
    levels = np.array([d[0].parameters["level"] for d in drawn]) / 180.0
    waves = np.array([d[1].parameters["amplitude"] for d in drawn]) / 180.0
    for values, (low, high) in ((levels, FRICTION), (waves, COGGING)):
        assert low <= values.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < values.max() <= high
    assert draw_effects(3, 180.0, 0.3) == drawn[3]


@pytest.mark.slow(10)
def test_linear_learning_stalls_far_above_its_promise(told):
    assert last(told.linear) > 50 * last(told.linear_promised)


def test_names_given_the_error_drops_and_carries_over(told):
    assert told.drop > 0.95
    assert told.extrapolation > 0.9


def test_promise_and_machine_agree(told):
    assert 0.5 < last(told.after) / last(told.promised) < 2.0


def test_calibration_finds_the_numbers_given_a_fifth_off(told):
    for found, true in zip(told.augmented.effects, told.true, strict=True):
        for key, value in true.parameters.items():
            width = 0.01 if key == "phase" else 0.01 * abs(value)
            assert abs(found.parameters[key] - value) < width


@pytest.mark.slow(5)
def test_a_wrong_diagnosis_brings_less(campaign):
    """Nothing is found: the linear part alone is calibrated."""
    missing = (EffectSpec("coulomb_friction", {"level": 1.0}, {"side": "sensor"}),)

    def wrong(model, fitted, held_out):
        assert len(fitted) == len(held_out) == 1
        return replace(model, effects=missing)

    told = story(campaign, draw_effects(2, 180.0, 0.3), 2, wrong, before=6, after=3, courses=0)
    assert told.found == missing
    assert told.drop < 0.6


@pytest.mark.slow(40)
def test_friction_cable_and_cogging_are_named_from_the_scans(campaign):
    effects = draw_effects(0, 180.0, 0.3)
    told = story(campaign, effects, 0, diagnosed, before=8, after=3, courses=0)
    assert exactly_named(told)
    drawn = {e.name: e.parameters for e in effects}
    for effect in told.found:
        for key in {"level", "amplitude", "period", "stiffness"} & set(effect.parameters):
            assert effect.parameters[key] == pytest.approx(drawn[effect.name][key], rel=0.02)
    assert told.drop > 0.95


def test_the_report_states_every_machine(told, tmp_path):
    write([told], tmp_path, "# before", "after")
    text = (tmp_path / "missing_physics.md").read_text()
    assert f"{100 * told.drop:.1f} %" in text
    assert table([told]) in text
    assert named([told]) in text
    assert (tmp_path / "missing_physics.png").stat().st_size > 10000
    axes = error_norms([told], Figure().subplots())
    assert axes.get_ylabel() == "2-norm of the error (m)"

"""What two effects, or an effect and a number of the model, could both say is said once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest.evenly import balanced, beside_a_load, of_its_mass, recentred
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.line import across_the_line
from ffl.diagnose.hypothesis.amounts import as_effect
from ffl.systems import EffectSpec

GRID = np.linspace(-0.02, 0.1, 9)
WAVE = 3.0 + np.sin(2 * np.pi * GRID / 0.12)
LOAD = 4.0


def table(positive, negative) -> EffectSpec:  # type: ignore[no-untyped-def]
    levels = {"grid": GRID.tolist(), "positive": list(positive), "negative": list(negative)}
    return EffectSpec("position_dependent_friction", {"table": levels})


def test_a_table_balanced_gives_its_difference_to_a_constant_force():
    same, half = balanced({"grid": GRID, "positive": WAVE - 1.0, "negative": WAVE + 1.0})
    assert half == pytest.approx(1.0)
    np.testing.assert_allclose(same["positive"], WAVE)
    np.testing.assert_allclose(same["negative"], WAVE)


def test_a_load_beside_friction_by_position_has_a_size_of_its_own(stage, record, scenes):  # type: ignore[no-untyped-def]
    """Whatever share of it the levels by direction had taken; no fit moves what no recording tells."""
    load = EffectSpec("constant_load", {"force": LOAD})
    scene, held, model = scenes(record(replace(stage, effects=(table(WAVE, WAVE), load))))
    shared = table(WAVE - 1.5, WAVE + 1.5), replace(load, parameters={"force": LOAD - 1.5})
    judged = judge(scene, held, replace(model, effects=shared), 4)
    even = beside_a_load(held, judged)
    force = even.model.effects[1].parameters["force"]
    assert force == pytest.approx(LOAD, abs=0.05)
    levels = even.model.effects[0].parameters["table"]
    assert np.mean(levels["positive"]) == pytest.approx(np.mean(levels["negative"]))
    assert beside_a_load(held, even) is even


def test_friction_by_position_alone_keeps_its_levels_by_direction(stage, record, scenes):  # type: ignore[no-untyped-def]
    scene, held, model = scenes(record(replace(stage, effects=(table(WAVE, WAVE + 1.0),))))
    judged = judge(scene, held, model.with_effect(table(WAVE, WAVE + 1.0)), 2)
    assert beside_a_load(held, judged) is judged


def test_a_damper_beside_the_models_own_damping_is_one_number(stage, record, scenes):  # type: ignore[no-untyped-def]
    damper = EffectSpec("viscous_friction", {"coefficient": 12.0})
    scene, held, model = scenes(record(replace(stage, effects=(damper,))))
    twice = replace(model, corrections={"damping": 0.5}).with_effect(
        replace(damper, parameters={"coefficient": 9.0})
    )
    whole = as_effect(twice, "damping")
    assert whole is not None
    assert "damping" in whole.held
    assert whole.effects[0].parameters["coefficient"] == pytest.approx(12.0)  # 0.5 of 6 kg, and 9
    found = across_the_line(scene, held, judge(scene, held, twice, 4))
    assert found.model.names == ("viscous_friction",)
    at = [c.name for c in found.model.coordinates].index("coefficient")
    assert found.model.effects[0].parameters["coefficient"] == pytest.approx(12.0, abs=0.2)
    assert found.spread[at] < 0.2


@pytest.mark.parametrize(
    ("mass", "named", "away"), [(0.0, False, 0.02), (0.0, False, 0.008), (0.2, True, 0.02)]
)
def test_a_gain_by_position_is_told_from_where_the_mass_is_as_stated(
    stage, record, scenes, mass, named, away
):  # type: ignore[no-untyped-def]
    """About another centre it is 3 or 1 % off and the mass makes up for it; a payload stays one."""
    gain = {"linear_coefficient": 1.5, "quadratic_coefficient": -6.0}
    bent = EffectSpec("position_dependent_gain", {**gain, "centre": 0.02})
    there = (bent, EffectSpec("mass_change", {"change": mass})) if mass else (bent,)
    scene, held, model = scenes(record(replace(stage, effects=there)))
    there_gain = 1.0 + 1.5 * away - 6.0 * away**2
    moved = {
        "centre": 0.02 + away,
        "linear_coefficient": (1.5 - 12.0 * away) / there_gain,
        "quadratic_coefficient": -6.0 / there_gain,
    }
    wrong = (1.0 + mass) / there_gain - 1.0
    begun = replace(model, corrections={"mass": wrong}).with_effect(replace(bent, parameters=moved))
    judged = judge(scene, held, begun, 4)
    assert judged.model.corrections["mass"] == pytest.approx(wrong, abs=0.003)
    found = recentred(held, judged).model
    if named:
        assert found is judged.model
    else:
        assert found.corrections.get("mass", 0.0) == pytest.approx(0.0, abs=0.003)
        assert found.effects[0].parameters["centre"] == pytest.approx(0.02, abs=0.002)
    names = across_the_line(scene, held, judged).model.names
    assert ("mass_change" in names) == named


@pytest.mark.parametrize(
    ("mass", "true", "stated"), [(-0.9, 0.0, True), (-0.9, -0.88, False), (0.01, 0.0, False)]
)
def test_a_fraction_of_the_mass_that_is_worth_nothing_is_the_stated_one(  # type: ignore[no-untyped-def]
    stage, record, scenes, mass, true, stated
):
    friction = EffectSpec("coulomb_friction", {"level": 2.0})
    less = EffectSpec("mass_change", {"change": true})
    scene, held, model = scenes(record(replace(stage, effects=(friction, less))))
    judged = judge(scene, held, model.with_effect(friction), 12)
    fitted = replace(judged.model, corrections={**judged.model.corrections, "mass": mass})
    judged = replace(judged, fit=replace(judged.fit, model=fitted))
    found = of_its_mass(held, judged)
    assert (found is not judged) is stated
    assert ("mass" in found.model.held) is stated

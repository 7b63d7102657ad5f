"""A pair that draws force over speed, for another pair."""

from dataclasses import replace

import pytest

from ffl.diagnose.contest.curves import two_for_two
from ffl.diagnose.contest.judging import judge
from ffl.systems.plant import EffectSpec

COULOMB = EffectSpec("coulomb_friction", {"level": 2.0})
DRAG = EffectSpec("quadratic_drag", {"coefficient": 60.0})
STRIBECK = EffectSpec(
    "stribeck_friction", {"coulomb_level": 1.5, "static_level": 2.1, "stribeck_velocity": 0.05}
)
VISCOUS = EffectSpec("viscous_friction", {"coefficient": 12.0})


def standing(scenes, runs, *effects):  # type: ignore[no-untyped-def]
    scene, held, model = scenes(runs)
    for spec in effects:
        model = model.with_effect(spec)
    return scene, held, judge(scene, held, model, 10)


def test_dry_friction_and_drag_for_a_stribeck_curve_and_a_damper(stage, record, scenes):
    """Neither half may be exchanged alone."""
    runs = record(replace(stage, effects=(COULOMB, DRAG)))
    scene, held, judged = standing(scenes, runs, STRIBECK, VISCOUS)
    found = two_for_two(scene, held, judged, lambda line: None)
    assert found is not None
    assert found.model.names == ("coulomb_friction", "quadratic_drag")
    assert found.model.effects[0].parameters["level"] == pytest.approx(2.0, rel=0.02)
    assert found.model.effects[1].parameters["coefficient"] == pytest.approx(60.0, rel=0.05)


def test_what_is_right_stays_and_no_pair_is_made_of_one(stage, record, scenes):
    runs = record(replace(stage, effects=(COULOMB, VISCOUS)))
    scene, held, judged = standing(scenes, runs, COULOMB, VISCOUS)
    other = two_for_two(scene, held, judged, lambda line: None)
    assert other is None or other.score < judged.score
    scene, held, alone = standing(scenes, runs, VISCOUS)
    assert two_for_two(scene, held, alone, lambda line: None) is None


def test_drag_beside_damping_of_ones_own_is_one_effect_more(stage, record, scenes):
    """No pair for another: it must earn its place as others do."""
    runs = record(replace(stage, effects=(COULOMB, VISCOUS)))
    scene, held, judged = standing(scenes, runs, COULOMB)
    assert two_for_two(scene, held, judged, lambda line: None) is None


def test_a_stribeck_curve_and_a_load_for_levels_by_direction_and_drag(stage, record, scenes):
    """What falls with speed had been left to a negative damping that drag made up for."""
    falling = {"coulomb_level": 1.4, "static_level": 3.0, "stribeck_velocity": 0.02}
    load = EffectSpec("constant_load", {"force": -0.9})
    machine = replace(stage, effects=(EffectSpec("stribeck_friction", falling), load))
    skewed = {"level_positive": 2.5, "level_negative": 0.7}
    begun = EffectSpec("asymmetric_friction", skewed), DRAG
    scene, held, judged = standing(scenes, record(machine), *begun)
    found = two_for_two(scene, held, judged, lambda line: None)
    assert found is not None
    assert found.model.names == ("stribeck_friction", "constant_load")
    assert found.score > judged.score + 100.0
    curve, weight = (spec.parameters for spec in found.model.effects)
    assert curve == pytest.approx(falling, rel=0.05)
    assert weight["force"] == pytest.approx(-0.9, rel=0.05)


def test_a_steeper_curve_and_drag_for_a_curve_pulled_down_by_damping(stage, record, scenes):
    """The damping is the model's own, of which nothing was said: the pair is one effect more."""
    falling = {"coulomb_level": 1.6, "static_level": 2.6, "stribeck_velocity": 0.008}
    machine = replace(stage, effects=(EffectSpec("stribeck_friction", falling), DRAG))
    slow = {"coulomb_level": 1.0, "static_level": 2.4, "stribeck_velocity": 0.02}
    scene, held, judged = standing(scenes, record(machine), EffectSpec("stribeck_friction", slow))
    assert judged.model.corrections["damping"] > 0.1
    found = two_for_two(scene, held, judged, lambda line: None)
    assert found is not None
    assert found.model.names == ("stribeck_friction", "quadratic_drag")
    curve, drag = (spec.parameters for spec in found.model.effects)
    assert curve["coulomb_level"] == pytest.approx(1.6, rel=0.05)
    assert drag["coefficient"] == pytest.approx(60.0, rel=0.1)

"""A load that is larger than the friction, told apart from levels by direction."""

from dataclasses import replace

import pytest

from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.overcome import overcome
from ffl.systems.plant import EffectSpec

COULOMB = EffectSpec("coulomb_friction", {"level": 1.0})


def levels(positive, negative):  # type: ignore[no-untyped-def]
    values = {"level_positive": positive, "level_negative": negative}
    return EffectSpec("asymmetric_friction", values)


@pytest.mark.parametrize("force", [-3.0, 3.0])
def test_a_load_beyond_the_friction(stage, record, scenes, force):
    load = EffectSpec("constant_load", {"force": force})
    scene, held, model = scenes(record(replace(stage, effects=(COULOMB, load))))
    begun = levels(4.0, 0.0) if force < 0.0 else levels(0.0, 4.0)
    standing = judge(scene, held, model.with_effect(begun), 10)
    found = overcome(scene, held, standing, lambda line: None)
    assert found.model.names == ("coulomb_friction", "constant_load")
    dry, pulls = found.model.effects
    assert dry.parameters["level"] == pytest.approx(1.0, rel=0.05)
    assert pulls.parameters["force"] == pytest.approx(force, rel=0.03)


def test_levels_that_both_hold_are_left_alone(stage, record, scenes):
    load = EffectSpec("constant_load", {"force": -0.5})
    scene, held, model = scenes(record(replace(stage, effects=(COULOMB, load))))
    standing = judge(scene, held, model.with_effect(levels(1.5, 0.5)), 4)
    assert overcome(scene, held, standing, lambda line: None) is None
    one_way = judge(scene, held, model.with_effect(levels(1.0, 0.0)), 0)
    proven = replace(one_way.fit.model, proven=frozenset({"asymmetric_friction"}))
    told = replace(one_way, fit=replace(one_way.fit, model=proven))
    assert overcome(scene, held, told, lambda line: None) is None

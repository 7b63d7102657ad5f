"""What the named effects come to when all is said."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.fit import Scene
from ffl.diagnose.judging import judge
from ffl.diagnose.line import across_the_line, on_the_line, sizes
from ffl.diagnose.model import Base, Model
from ffl.diagnose.noise import Noise
from ffl.diagnose.trials import prepare
from ffl.systems import EffectSpec

NOISE = Noise(1e-7, 2e-3)


def scene_of(plant, recordings):  # type: ignore[no-untyped-def]
    base = Base.of(plant, max(float(np.ptp(r.y)) for r in recordings))
    trials = tuple(prepare(base.simulator, r, 1e-7) for r in recordings)
    return Scene(plant.loop, trials, NOISE), Model(base)


def test_friction_by_direction_beside_a_spring_is_even_friction_about_another_centre(stage, record):  # type: ignore[no-untyped-def]
    spring = EffectSpec("linear_stiffness", {"stiffness": 200.0, "centre": 0.01})
    even = EffectSpec("coulomb_friction", {"level": 3.0})
    scene, model = scene_of(stage, record(replace(stage, effects=(even, spring))))
    uneven = EffectSpec("asymmetric_friction", {"level_positive": 3.4, "level_negative": 2.6})
    moved = replace(spring, parameters={"stiffness": 200.0, "centre": 0.012})
    judged = judge(scene, None, replace(model, effects=(uneven, moved)), rounds=4)
    found = across_the_line(scene, None, judged).model
    assert found.names == ("coulomb_friction", "linear_stiffness")
    assert found.effects[0].parameters["level"] == pytest.approx(3.0, rel=0.02)
    assert found.effects[1].parameters["centre"] == pytest.approx(0.01, abs=1e-4)


def test_friction_by_direction_without_a_spring_stays(stage, record):  # type: ignore[no-untyped-def]
    uneven = EffectSpec("asymmetric_friction", {"level_positive": 3.4, "level_negative": 2.6})
    scene, model = scene_of(stage, record(replace(stage, effects=(uneven,))))
    judged = judge(scene, None, model.with_effect(uneven), rounds=4)
    assert across_the_line(scene, None, judged).model.names == ("asymmetric_friction",)


def test_a_correction_beyond_the_line_is_held_on_it(stage, record):  # type: ignore[no-untyped-def]
    """So that an effect that competes with it says what it has to say alone."""
    scene, model = scene_of(stage, record(replace(stage, effects=())))
    far = judge(scene, None, replace(model, corrections={"mass": 0.08, "damping": 0.0}), rounds=0)
    assert abs(sizes(scene, far.model)["mass"]) > 0.02
    near = on_the_line(None, far).model
    assert abs(sizes(scene, near)["mass"]) < 0.02
    assert "mass" in near.held


@pytest.mark.parametrize(("own", "named"), [(0.012, ()), (0.05, ("mass_change",))])
def test_a_mass_said_twice_is_one_number(stage, record, own, named):  # type: ignore[no-untyped-def]
    """0.3 % as an effect beside 1.2 % as a correction is 1.5 %: no effect."""
    heavy = EffectSpec("mass_change", {"change": 1.003 * (1.0 + own) - 1.0})
    scene, model = scene_of(stage, record(replace(stage, effects=(heavy,))))
    twice = replace(model, corrections={"mass": own, "damping": 0.0})
    judged = judge(scene, None, twice.with_effect(EffectSpec("mass_change", {"change": 0.003})), 0)
    assert across_the_line(scene, None, judged).model.names == named

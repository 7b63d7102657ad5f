"""Friction that falls with speed, in a loop that sticks and slips."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest import falling
from ffl.diagnose.contest import settle as settling
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.systems import Controller, EffectSpec, Move, Physics, Plant, Zpk, moves
from ffl.systems.plant import Imperfections

STEP, MASS = 1e-3, 20.0
ASKED = frozenset({"stribeck_friction"})


@pytest.fixture(scope="module")
def hunting() -> Plant:
    """20 kg under a controller whose integral winds up until it breaks loose."""
    system = Zpk(np.array([-1.0]), np.array([1.0, 1.0]), STEP**2 / (2.0 * MASS), STEP)
    controller = Zpk(np.array([0.9834, 0.985]), np.array([0.86, 1.0]), 137181.0, STEP)
    machine = Imperfections(5e-7, 1e-7, 2e-2, None)
    loop = Controller.of_error(controller)
    return Plant("hunting", system, loop, "N", "m", "made", Physics(MASS, 1.0), machine)


def seen(plant: Plant, static: float, velocity: float, seed: int) -> tuple[Scene, Model]:
    curve = {"coulomb_level": 6.0, "static_level": static, "stribeck_velocity": velocity}
    machine = SimulatedMachine(replace(plant, effects=(EffectSpec("stribeck_friction", curve),)))
    steps = [
        Move(0.3 + 1.3 * k, 0.05 * s, 0.3, 3.0, 200.0) for k, s in enumerate((1, -1, -1, 1, 1))
    ]
    reference = moves(steps, 8.0, STEP)
    recording = machine.run(reference, np.zeros_like(reference), np.random.default_rng(seed))
    base = Base.of(plant, float(np.ptp(recording.y)))
    trial = prepare(base.simulator, recording, 1e-7)
    return Scene(plant.loop, (trial,), Noise(2e-7, 2e-2)), Model(base)


@pytest.mark.parametrize(("static", "velocity"), [(9.0, 2e-3), (7.5, 1e-3)])
def test_the_curve_is_found_where_no_step_leads_from_a_level(hunting, static, velocity):  # type: ignore[no-untyped-def]
    scene, model = seen(hunting, static, velocity, 1)
    level = 0.5 * (6.0 + static)
    bristle = {"level": level, "stiffness": 2e6, "micro_damping": 0.0}
    model = model.with_effect(EffectSpec("presliding_friction", bristle))
    stands = judge(scene, None, model, 6)
    without = judge(scene, None, stands.model.without(0), 0)
    found = settling.challengers(scene, stands, 0, [], frozenset(), ASKED)
    ((_, best),) = settling._in_its_place(scene, None, stands, without, 0, found, print)
    values = {"coulomb_level": 6.0, "static_level": static, "stribeck_velocity": velocity}
    assert best.model.effects[0].parameters == pytest.approx(values, rel=0.02)
    assert best.score > stands.score + 500.0


def test_none_is_begun_where_what_stands_is_near_nor_for_others(hunting):  # type: ignore[no-untyped-def]
    scene, model = seen(hunting, 9.0, 2e-3, 1)
    level = EffectSpec("coulomb_friction", {"level": 7.0})
    stands = judge(scene, None, model.with_effect(level), 2)
    without = judge(scene, None, stands.model.without(0), 0)
    (curve,) = settling.challengers(scene, stands, 0, [], frozenset(), ASKED)
    assert len(falling.curves(scene, stands, 0, curve)) > falling.BEST
    other = replace(curve, spec=level)
    assert falling.curves(scene, stands, 0, other) == []
    assert falling.curves(replace(scene, observed=True), stands, 0, curve) == []
    values = {"coulomb_level": 6.0, "static_level": 9.0, "stribeck_velocity": 2e-3}
    right = model.with_effect(EffectSpec("stribeck_friction", values))
    assert falling.curves(scene, judge(scene, None, right, 2), 0, curve) == []
    assert without.model.names == ()


def test_nothing_leads_where_the_command_is_not_all_known(hunting):  # type: ignore[no-untyped-def]
    scene, model = seen(hunting, 9.0, 2e-3, 1)
    assert falling._led(scene, model.base) is not None
    (trial,) = scene.trials
    u = trial.u.copy()
    u[100] = np.nan
    assert falling._led(replace(scene, trials=(replace(trial, u=u),)), model.base) is None
    lost = np.arange(len(trial)) == 7
    assert falling._led(replace(scene, trials=(replace(trial, lost=lost),)), model.base) is None
    open_loop = Base.of(replace(hunting, controller=None))
    assert falling._led(scene, open_loop) is None

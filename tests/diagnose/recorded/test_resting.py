"""Machines with springs that stand still: wound up after a move, let go where a simulation begins."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.linear import carried
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.proof.prove import run_plant
from ffl.diagnose.recorded.resting import at_speed
from ffl.diagnose.recorded.starts import with_starts
from ffl.diagnose.recorded.trials import prepare, starts_at_rest
from ffl.machines import SimulatedMachine
from ffl.systems import EffectSpec, Move, moves

STEP = 0.001
NOISE = Noise(1e-6, 0.01)
EFFECTS = (
    EffectSpec("cogging", {"amplitude": 9.0, "period": 0.012, "phase": 1.0}, {"side": "motor"}),
    EffectSpec("coulomb_friction", {"level": 15.0}, {"side": "load"}),
)


@pytest.fixture(scope="module")
def plant(two_masses):
    return two_masses


@pytest.fixture(scope="module")
def recording(plant):
    steps = [Move(0.6 + 0.7 * k, 0.03 * s, 0.2, 3.0, 150.0) for k, s in enumerate((1, -1, 1))]
    reference = moves(steps, 2.8, STEP)
    machine = SimulatedMachine(replace(plant, effects=EFFECTS))
    return machine.run(reference, 0 * reference, np.random.default_rng(0))


def settled(plant, recording):
    base = Base.of(plant, 0.1)
    scene = Scene(plant.loop, (prepare(base.simulator, recording, 1e-6),), NOISE)
    model = Model(base, effects=EFFECTS)
    return with_starts(scene, model), model


def left(scene, model):
    white = scene.whiten(scene.residuals(model))
    return float(np.mean(white**2))


def test_what_came_to_rest_has_its_spring_wound_up(plant, recording):
    scene, model = settled(plant, recording[500:])  # 0.1 s before it moves on
    (trial,) = scene.trials
    assert trial.at_rest
    assert trial.loaded
    let_go = replace(scene, trials=(replace(trial, loaded=False),))
    assert left(scene, model) < 1.2
    assert left(let_go, model) > 2.0


def test_a_simulation_from_its_own_beginning_has_not(plant, recording):
    scene, model = settled(plant, recording)
    (trial,) = scene.trials
    assert trial.at_rest
    assert not trial.loaded
    wound = replace(scene, trials=(replace(trial, loaded=True),))
    assert left(scene, model) < 0.5 * left(wound, model)


def test_nothing_winds_up_where_nothing_pulls(plant, recording):
    scene, _ = settled(plant, recording[500:])
    bare = replace(scene, trials=tuple(replace(t, loaded=False) for t in scene.trials))
    assert with_starts(bare, Model(Base.of(plant, 0.1))) is bare


def test_the_plant_file_begins_with_the_speed_that_was_fitted(plant, recording):
    base = Base.of(plant, 0.1)
    trial = prepare(base.simulator, recording[650:], 1e-6)  # within the first move
    assert not trial.at_rest
    model = Model(base, corrections={"damping": 3.0, "mode_1_frequency": 0.05, "mass": 0.02})
    fitted, rerun = model.simulate(trial), run_plant(model.plant(), trial)
    assert np.abs(fitted.y - rerun.y).max() < 1e-9 * np.ptp(fitted.y)


def test_a_state_carried_to_the_same_plant_is_itself(plant):
    mechanics = Base.of(plant, 0.1).simulator.mechanics
    state = np.random.default_rng(1).standard_normal(mechanics.own)
    np.testing.assert_allclose(carried(state, mechanics, mechanics), state, rtol=1e-9)


def test_what_shakes_where_its_reference_rests_began_in_motion(plant):
    """A fan shakes it at 8 mm/s, beside a spring that would be wound up if it stood."""
    effects = (
        EffectSpec("hardening_spring", {"cubic_coefficient": 1e4, "centre": 0.01}),
        EffectSpec("periodic_disturbance", {"amplitude": 9.0, "frequency": 6.3, "phase": 0.7}),
    )
    reference = moves([Move(2.0, 0.03, 0.2, 3.0, 150.0)], 2.5, STEP)
    machine = SimulatedMachine(replace(plant, effects=effects))
    run = machine.run(reference, 0 * reference, np.random.default_rng(0))
    base = Base.of(plant, 0.1)
    model = Model(base, effects=effects)
    turns = [k for k in range(300, 700) if starts_at_rest(run[k:]) and at_speed(run.y[k:])]
    trial = prepare(base.simulator, run[turns[0] :], 1e-6)
    assert trial.at_rest
    settled = with_starts(Scene(plant.loop, (trial,), NOISE), model)
    assert not settled.trials[0].at_rest
    (left,) = settled.residuals(model)
    assert np.mean(settled.whiten([left])[:300] ** 2) < 1.5


def test_no_speed_is_seen_in_noise_nor_where_something_is_let_go():
    t, noise = np.arange(8) * STEP, np.random.default_rng(0)
    seen = [at_speed(1e-6 * noise.standard_normal(8)) for _ in range(3000)]
    assert np.mean(seen) < 1e-3
    for rate in (30.0, 100.0, 400.0, 1000.0):  # rad/s: a spring, with noise and without
        let_go = 1e-3 * (1.0 - np.cos(rate * t))
        assert not at_speed(let_go)
        assert not at_speed(let_go + 1e-6 * noise.standard_normal(8))
    assert at_speed(8e-3 * t + 0.5 * t**2 + 2e-7 * noise.standard_normal(8))
    assert not at_speed(t[:7])

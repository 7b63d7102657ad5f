"""A drive within which the loop opens is judged with the command as it was sent."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.judging import judge
from ffl.diagnose.model import Base, Model
from ffl.diagnose.noise import Noise
from ffl.diagnose.scene import Scene
from ffl.diagnose.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.systems import Controller, EffectSpec, Imperfections, Move, Physics, Plant, Zpk, moves

STEP = 0.001
NOISE = Noise(1e-6, 0.02)
DEAD = EffectSpec("dead_zone", {"half_width": 0.4})
DRAG = EffectSpec("quadratic_drag", {"coefficient": 30.0})
SLOW = EffectSpec("periodic_disturbance", {"frequency": 0.7, "amplitude": 0.01, "phase": 0.3})


@pytest.fixture(scope="module")
def stage():
    """5 kg and a lead with 15 Hz bandwidth."""
    zero, pole = np.exp(-2 * np.pi * 5.0 * STEP), np.exp(-2 * np.pi * 45.0 * STEP)
    lead = Zpk(np.array([zero]), np.array([pole]), 1.0, STEP)
    gain = 5.0 * (2 * np.pi * 15.0) ** 2 / abs(lead.response([15.0])[0])
    system = Zpk(np.array([-1.0]), np.array([1.0, 1.0]), STEP**2 / 10.0, STEP)
    controller = Controller.of_error(replace(lead, gain=gain))
    machine = Imperfections(1e-7, 1e-6, 0.02, None)
    return Plant("stage", system, controller, "N", "m", "for tests", Physics(5.0, 1.0), machine)


def judged(stage, physics, named):
    machine, rng = SimulatedMachine(replace(stage, effects=physics)), np.random.default_rng(4)
    paths = [
        moves([Move(0.3 + 0.9 * k, 0.05 * s, 0.25, 4.0, 200.0) for k, s in enumerate(way)], 3.6, STEP)
        for way in ((1, -1, 1, -1), (1, 1, -1, -1))
    ]  # fmt: skip
    seen, other = (machine.run(r, 0 * r, rng) for r in paths)
    base = Base.of(stage, float(np.ptp(other.y)))
    scenes = [Scene(stage.loop, (prepare(base.simulator, r, 1e-6),), NOISE) for r in (seen, other)]
    return judge(*scenes, replace(Model(base), effects=named), 6)


def test_within_a_dead_zone_noise_is_taken_for_nothing_else(stage):
    alone, beside = (judged(stage, (DEAD,), named) for named in ((DEAD,), (DEAD, SLOW)))
    assert beside.score < alone.score + 5.0
    found = alone.model.effects[0].parameters["half_width"]
    assert found == pytest.approx(0.4, abs=3 * alone.spread[-1])
    assert alone.spread[-1] < 0.01
    assert np.mean(alone.held_white**2) < 1.3


def test_what_is_there_beside_it_shows(stage):
    alone, beside = (judged(stage, (DEAD, DRAG), named) for named in ((DEAD,), (DEAD, DRAG)))
    assert beside.score > alone.score + 100.0


def test_the_report_runs_it_freely(stage):
    """What is judged behind the drive is another run than the free one that figures are about."""
    found = judged(stage, (DEAD,), (DEAD,))
    (trial,) = found.scene.trials
    behind, free = found.model.output(trial), found.model.simulate(trial).y
    assert np.std(trial.y - behind) < 0.5 * np.std(trial.y - free)


@pytest.mark.parametrize(
    "company",
    [
        (EffectSpec("actuator_lag", {"time_constant": 0.004}),),
        (EffectSpec("input_delay", {"delay": 0.003}),),
        (EffectSpec("position_dependent_gain", {"linear_coefficient": 2.0, "centre": 0.05}),),
    ],
)
@pytest.mark.parametrize("first", [DEAD, EffectSpec("saturation", {"limit": 6.0})])
def test_whatever_else_the_command_goes_through_follows(stage, company, first):
    """Without noise the true model leaves nothing, whichever was found first."""
    still = replace(stage, machine=Imperfections(0.0, 0.0, 0.0, None))
    machine = SimulatedMachine(replace(still, effects=(first, *company)))
    r = moves([Move(0.3, 0.05, 0.25, 4.0, 200.0)], 1.5, STEP)
    seen = machine.run(r, 0 * r, np.random.default_rng(0))
    base = Base.of(stage, 0.05)
    trial = prepare(base.simulator, seen, 1e-6)
    for effects in ((first, *company), (*company, first)):
        model = replace(Model(base), effects=effects)
        assert model.judged_on([trial])[0] is not model
        np.testing.assert_allclose(model.output(trial), seen.y, atol=1e-5)


def test_a_limit_that_the_plant_file_states_is_fed_as_well(stage):
    limited = replace(stage, effects=(EffectSpec("saturation", {"limit": 6.0}),))
    found = judged(limited, (*limited.effects, DEAD), (DEAD,))
    assert np.mean(found.held_white**2) < 1.3


def test_without_a_recorded_command_the_run_is_free(stage):
    found = judged(stage, (DEAD,), (DEAD,))
    (trial,) = found.scene.trials
    blind = replace(trial, u=np.full(len(trial), np.nan))
    np.testing.assert_array_equal(found.model.output(blind), found.model.simulate(blind).y)

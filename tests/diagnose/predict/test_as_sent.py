"""A drive within which the loop opens is judged with the command as it was sent."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest.judging import judge
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.recorded.commands import reached
from ffl.diagnose.recorded.trials import prepare
from ffl.systems import EffectSpec, Imperfections

DEAD = EffectSpec("dead_zone", {"half_width": 0.035})
LIMIT = EffectSpec("saturation", {"limit": 0.6})
DRAG = EffectSpec("quadratic_drag", {"coefficient": 30.0})
LAG = EffectSpec("actuator_lag", {"time_constant": 0.004})
SLOW = EffectSpec("periodic_disturbance", {"frequency": 0.7, "amplitude": 0.01, "phase": 0.3})


@pytest.fixture(scope="module")
def judged(stage, record, scenes):
    """A machine, its recordings judged with the effects that are named."""

    def of(physics, named, stated=()):
        seen, ahead, model = scenes(record(replace(stage, effects=physics), seed=4))
        base = Base.of(replace(stage, effects=stated), model.base.travel)
        model = replace(model, base=base)
        return judge(seen, ahead, replace(model, effects=named), 6)

    return of


def test_within_a_dead_zone_noise_is_taken_for_nothing_else(judged):
    alone, beside = (judged((DEAD,), named) for named in ((DEAD,), (DEAD, SLOW)))
    assert beside.score < alone.score + 5.0
    found = alone.model.effects[0].parameters["half_width"]
    assert found == pytest.approx(DEAD.parameters["half_width"], abs=3 * alone.spread[-1])
    assert alone.spread[-1] < 0.001
    assert np.mean(alone.held_white**2) < 1.3


def test_what_is_there_beside_it_shows(judged):
    alone, beside = (judged((DEAD, DRAG), named) for named in ((DEAD,), (DEAD, DRAG)))
    assert beside.score > alone.score + 100.0


def test_the_report_runs_it_freely(judged):
    """What is judged behind the drive is another run than the free one that figures are about."""
    found = judged((DEAD,), (DEAD,))
    (trial,) = found.scene.trials
    behind, free = found.model.output(trial), found.model.simulate(trial).y
    assert np.std(trial.y - behind) < 0.5 * np.std(trial.y - free)


@pytest.mark.parametrize(
    "company",
    [
        (EffectSpec("actuator_lag", {"time_constant": 0.004}),),
        (EffectSpec("input_delay", {"delay": 0.003}),),
        (EffectSpec("input_delay", {"delay": 0.00237}),),
        (EffectSpec("position_dependent_gain", {"linear_coefficient": 2.0, "centre": 0.05}),),
    ],
)
@pytest.mark.parametrize("first", [DEAD, LIMIT])
def test_whatever_else_the_command_goes_through_follows(stage, record, scenes, company, first):
    """Without noise the true model leaves nothing, whichever was found first."""
    still = replace(stage, machine=Imperfections(0.0, 0.0, 0.0, None), effects=(first, *company))
    seen, _, model = scenes(record(still))
    trial = seen.trials[0].head(1500)
    for effects in ((first, *company), (*company, first)):
        found = replace(model, effects=effects)
        assert found.judged_on([trial])[0] is not found
        np.testing.assert_allclose(found.output(trial), trial.y, atol=1e-5)


@pytest.mark.parametrize("company", [(), (DEAD,), (DRAG, LIMIT), (LAG,), (DEAD, LAG)])
def test_a_stated_limit_of_the_command_is_gone_through_first(stage, record, company):
    """Without noise the true model leaves nothing, led by the command as sent and in free runs, where that
    as the controller asked for it is cut as well."""
    sent = 1.2 * LIMIT.parameters["limit"]
    still = replace(stage, machine=Imperfections(0.0, 0.0, 0.0, sent))
    run = record(replace(still, effects=company))[0]
    assert np.sum(np.abs(run.u) == sent) > 20
    base = Base.of(still, 0.1, 3.0, reached(still, [run]))
    model, trial = Model(base, effects=company), prepare(base.simulator, run, 1e-7)
    behind, (fed,) = model.judged_on([trial])
    assert behind is not model
    assert behind.base.limit is None
    assert fed.asked is None
    np.testing.assert_allclose(model.output(trial), trial.y, atol=1e-5 if LAG in company else 1e-9)
    free = model.simulate(trial)
    np.testing.assert_allclose(free.y, trial.y, atol=1e-9)
    np.testing.assert_allclose(free.u, trial.u, atol=1e-6)


def test_a_limit_that_is_never_reached_changes_nothing(stage, record):
    far = replace(stage, machine=replace(stage.machine, command_limit=1e3))
    run = record(far)[0]
    assert reached(far, [run]) is None
    model = Model(Base.of(far, 0.1))
    assert prepare(model.base.simulator, run, 1e-7).asked is None
    assert model.behind is model


def test_a_limit_that_the_plant_file_states_is_fed_as_well(judged):
    found = judged((LIMIT, DEAD), (DEAD,), stated=(LIMIT,))
    assert np.mean(found.held_white**2) < 1.3


def test_without_a_recorded_command_the_run_is_free(judged):
    found = judged((DEAD,), (DEAD,))
    (trial,) = found.scene.trials
    blind = replace(trial, u=np.full(len(trial), np.nan))
    np.testing.assert_array_equal(found.model.output(blind), found.model.simulate(blind).y)

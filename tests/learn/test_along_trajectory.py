"""The update along the trajectory of a model with effects."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.random import SeedSequence

from ffl.bases import Compensation, Derivatives, Friction, SumBasis
from ffl.learn import AlongTrajectory, Constraints, LearningTask, NormOptimal, Weights, learn
from ffl.machines import SimulatedMachine
from ffl.systems import (
    Controller,
    EffectSpec,
    Move,
    Physics,
    Plant,
    Zpk,
    load_plant,
    moves,
    zero_order_hold,
)

T = 1e-3
WEIGHTS = Weights(1e9, 1e-9, 0.0)


@pytest.fixture(scope="module")
def stage():
    """EMPS' carriage with dry friction and a cogging force, its effects known."""
    effects = (
        EffectSpec("coulomb_friction", {"level": 20.0}),
        EffectSpec("cogging", {"amplitude": 8.0, "period": 0.03, "phase": 0.4}),
    )
    return replace(load_plant("emps"), effects=effects)


@pytest.fixture(scope="module")
def reference():
    return moves([Move(0.2, 0.1, 0.3, 3.0, 60.0)], 1.0, T)


@pytest.fixture(scope="module")
def basis(stage):
    return SumBasis([Derivatives(["velocity", "acceleration"], sample_time=T), Compensation(stage)])


def test_without_effects_it_is_the_closed_form(reference):
    model = load_plant("emps")
    basis = Derivatives(["velocity", "acceleration"], sample_time=T)
    error = reference - SimulatedMachine(model).simulator.run((), reference).y
    linear = NormOptimal(model, basis, reference, WEIGHTS).update(np.zeros(2), error)
    along = AlongTrajectory(model, basis, reference, WEIGHTS).update(np.zeros(2), error)
    assert along.theta == pytest.approx(linear.theta, rel=1e-6)


def test_its_plan_on_the_true_model_is_what_the_machine_does(stage, basis, reference):
    update = AlongTrajectory(stage, basis, reference, WEIGHTS)
    plan = update.plan(np.zeros(basis.n_parameters))
    promised = reference - update.output(plan.feedforward)
    run = SimulatedMachine(stage).run(reference, plan.feedforward, np.random.default_rng(0))
    assert np.linalg.norm(promised) < 0.03 * np.linalg.norm(
        reference - update.output(0 * reference)
    )
    assert run.y == pytest.approx(reference - promised, abs=1e-12)


def test_what_the_model_does_not_say_is_carried_into_the_promise(stage, basis, reference):
    """The machine has more friction than the model: after a trial, the next one's error is foretold."""
    heavier = replace(
        stage, effects=(EffectSpec("coulomb_friction", {"level": 26.0}), stage.effects[1])
    )
    machine = SimulatedMachine(heavier)
    update = AlongTrajectory(stage, basis, reference, WEIGHTS)
    theta, foretold, errors = update.plan(np.zeros(basis.n_parameters)).theta, [], []
    for _ in range(3):
        run = machine.run(reference, basis.regressors(reference) @ theta, np.random.default_rng(0))
        errors.append(reference - run.y)
        following = update.update(theta, errors[-1], run.u)
        foretold.append(update.predicted(theta, errors[-1], following.theta))
        theta = following.theta
    assert np.linalg.norm(errors[-1]) < 0.2 * np.linalg.norm(errors[0])
    assert np.linalg.norm(errors[-1] - foretold[-2]) < 0.3 * np.linalg.norm(errors[-1])


def test_auto_takes_it_where_the_model_has_effects(stage, basis, reference):
    task = LearningTask(stage, SimulatedMachine(stage), basis, reference, WEIGHTS)
    assert isinstance(task.updater(), AlongTrajectory)
    linear = replace(task, update="closed_form")
    assert isinstance(linear.updater(), NormOptimal)
    bare = replace(task, model=load_plant("emps"))
    assert isinstance(bare.updater(), NormOptimal)
    norms = [t.error_norm for t in learn(task, 3, SeedSequence(0))]
    assert norms[-1] < 0.05 * norms[0]


def test_bounds_hold(stage, basis, reference):
    update = AlongTrajectory(stage, basis, reference, WEIGHTS, Constraints(feedforward=1.0))
    plan = update.plan(np.zeros(basis.n_parameters))
    assert np.abs(plan.feedforward).max() < 1.0 + 1e-9
    free = AlongTrajectory(stage, basis, reference, WEIGHTS).plan(np.zeros(basis.n_parameters))
    assert np.abs(free.feedforward).max() > 1.0


@pytest.fixture(scope="module")
def feedback_only(stage, reference):
    """Error and command of the stage's first trial."""
    run = SimulatedMachine(stage).run(reference, 0 * reference, np.random.default_rng(0))
    return reference - run.y, run.u


def test_bounds_that_the_last_parameters_break_hold_for_the_next(stage, reference, feedback_only):
    """A mass so wrong that no feedforward at all is better: halving back to that would break them."""
    basis = Derivatives(["velocity", "acceleration"], sample_time=T)
    free = AlongTrajectory(stage, basis, reference, WEIGHTS).update(np.zeros(2), *feedback_only)
    least = 60.0 * free.theta[1]
    bounds = Constraints(parameters=np.array([[-np.inf, least], [np.inf, np.inf]]))
    bounded = AlongTrajectory(stage, basis, reference, WEIGHTS, bounds)
    update = bounded.update(np.zeros(2), *feedback_only)
    promised = reference - bounded.output(update.feedforward)
    assert np.linalg.norm(promised) > np.linalg.norm(feedback_only[0])
    assert update.theta[1] == pytest.approx(least, rel=1e-9)
    assert update.report.active == 1


def test_the_command_keeps_its_bound_on_the_machine(stage, basis, reference, feedback_only):
    free = AlongTrajectory(stage, basis, reference, WEIGHTS).update(np.zeros(5), *feedback_only)
    machine = SimulatedMachine(stage)
    peak = np.abs(machine.run(reference, free.feedforward, np.random.default_rng(0)).u).max()
    limit = 0.95 * peak
    bounded = AlongTrajectory(stage, basis, reference, WEIGHTS, Constraints(command=limit))
    update = bounded.update(np.zeros(5), *feedback_only)
    run = machine.run(reference, update.feedforward, np.random.default_rng(0))
    assert update.report.status == "settled"
    assert np.abs(run.u).max() == pytest.approx(limit, rel=1e-6)
    # A step whose bend is taken into the bound alone ended at 65,428, on the bound to 2e-9.
    assert WEIGHTS.cost(reference - run.y, update.feedforward, update.feedforward) < 44e3
    assert np.abs(run.u).max() <= limit * (1 + 1e-8)
    assert update.report.kkt_residual < 0.05
    assert update.report.active > 0


def test_the_residual_is_that_of_the_parameters_returned(
    stage, basis, reference, feedback_only, monkeypatch
):
    """After one round it is what the next one still moves, relative to the error there was."""
    monkeypatch.setattr("ffl.learn.along_trajectory.ELSEWHERE", 0)
    along = AlongTrajectory(stage, basis, reference, WEIGHTS)
    outputs, residuals = [], []
    for rounds in (1, 2):
        monkeypatch.setattr("ffl.learn.along_trajectory.ROUNDS", rounds)
        update = along.update(np.zeros(5), *feedback_only)
        outputs.append(along.output(update.feedforward))
        residuals.append(update.report.kkt_residual)
        assert update.report.status == "optimal_inaccurate"
    moved = np.linalg.norm(outputs[1] - outputs[0]) / np.linalg.norm(feedback_only[0])
    assert residuals[0] == pytest.approx(moved, rel=0.1)
    assert 1e-8 < residuals[1] < 0.2 * residuals[0]


def test_bounds_that_nothing_meets_leave_the_parameters(stage, basis, reference, feedback_only):
    bounds = Constraints(command=1.0)  # N, against 20 N of friction
    update = AlongTrajectory(stage, basis, reference, WEIGHTS, bounds).update(
        np.zeros(5), *feedback_only
    )
    assert update.report.status == "infeasible"
    assert "command" in update.report.message
    np.testing.assert_array_equal(update.theta, np.zeros(5))
    np.testing.assert_array_equal(update.feedforward, 0 * reference)


def test_it_learns_from_a_trial_without_any_command():
    """Open loop, trial 1: f = u = 0 gives a difference no scale, and dry friction no answer to one."""
    friction = (EffectSpec("coulomb_friction", {"level": 3.0}),)
    lever = zero_order_hold([], [-5 + 30j, -5 - 30j], 1.0, T)
    model = Plant("lever", lever, physics=Physics(mass=1.0), effects=friction)
    orders = ["position", "velocity", "acceleration"]
    basis = SumBasis([Derivatives(orders, sample_time=T), Friction(sample_time=T)])
    reference = moves([Move(0.1, 0.1, 0.4, 4.0, 100.0)], 0.8, T)
    task = LearningTask(model, SimulatedMachine(model), basis, reference, Weights(1.0, 1e-14, 0.0))
    norms = [trial.error_norm for trial in learn(task, 3, SeedSequence(0))]
    assert norms[-1] < 0.1 * norms[0]


@pytest.fixture(scope="module")
def bonder():
    """0.35 kg that fast moves bring to rest within its dry friction, behind a servo of 45 Hz."""
    step = 2.5e-4
    zeros, poles = np.array([0.989199223668237, 0.980843053587914]), np.array([1.0, 0.5681])
    controller = Controller.of_error(Zpk(zeros, poles, 8257.2, step))
    system = zero_order_hold([], [0.0, -11.43], 57.143, step)
    machine = Plant(
        "bonder", system, controller, "A", "m", "for tests", Physics(0.35, 20.0),
        effects=(EffectSpec("coulomb_friction", {"level": 0.9}),),
    )  # fmt: skip
    path = [Move(0.1, 0.02, 0.5, 30.0, 6000.0), Move(0.3, -0.02, 0.5, 30.0, 6000.0)]
    return machine, moves(path, 0.6, step)


def learned(bonder, *parts):
    machine, reference = bonder
    basis = SumBasis([Derivatives(sample_time=machine.sample_time), *parts])
    update = AlongTrajectory(machine, basis, reference, Weights(50.0, 1e-7, 0.0))
    none = 0.0 * reference
    error = reference - update.output(none)
    theta = update.update(np.zeros(basis.n_parameters), error).theta
    left = reference - update.output(basis.regressors(reference) @ theta)
    return theta, np.linalg.norm(left), np.linalg.norm(error)


@pytest.mark.parametrize("known", [True, False])
def test_twice_the_friction_is_no_place_to_stay(bonder, monkeypatch, known):
    """Fed forward twice, friction stops the machine short as none does: there a descent ends."""
    if not known:
        monkeypatch.setattr(Compensation, "stated", property(lambda self: np.full(1, np.nan)))
    compensation = Compensation(bonder[0])
    theta, left, begun = learned(bonder, compensation)
    assert theta[-1] == pytest.approx(0.9, rel=0.03)
    assert left < 3e-3 * begun
    _, without, _ = learned(bonder)
    assert left < 0.05 * without
    monkeypatch.setattr("ffl.learn.along_trajectory.ELSEWHERE", 0)
    theta, stuck, _ = learned(bonder, compensation)
    assert theta[-1] > 1.5
    assert stuck > without

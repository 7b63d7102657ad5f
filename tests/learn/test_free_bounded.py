"""The free signal under bounds, against the same quadratic program written out in cvxpy."""

import cvxpy as cp
import numpy as np
import pytest

from ffl.bases import FreeSignal
from ffl.errors import InputError
from ffl.learn import Constraints, Weights
from ffl.learn.free_bounded import BoundedFreeSignal
from ffl.learn.free_signal import FreeSignalUpdate, minimiser
from ffl.learn.trial_loop import LearningTask, learn
from ffl.machines import SimulatedMachine
from ffl.systems import Move, Zpk, moves
from ffl.systems.plant_file import plant_from_dict

N = 160
WEIGHTS = {
    "scalar": Weights(50.0, 1e-7, 1e-8),
    "per_sample": Weights(np.linspace(20.0, 80.0, N), 1e-7, np.full(N, 1e-8)),
}


@pytest.fixture(scope="module")
def trial(model):
    """Reference, feedforward, error and command of a short noiseless trial."""
    s = np.clip((np.arange(N) - 60) / 50, 0.0, 1.0)
    reference = 1e-3 * s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)
    feedforward = 0.1 * np.sin(np.arange(N) / 9.0)
    zero = np.zeros(N)
    y, u = model.loop.system.filter(np.column_stack([reference, feedforward, zero, zero])).T
    return reference, feedforward, reference - y, u


def lifted(system):
    """Lower-triangular Toeplitz matrix of a one-input one-output system."""
    return system.filter_columns(np.eye(N))


def test_the_recursion_keeps_its_digits_where_weights_are_decades_apart(model):
    """Bounds about to hold weigh 1e20 times the rest: as good as equations, eliminated by hand."""
    sp = model.loop.process_sensitivity
    rng = np.random.default_rng(0)
    held, wanted = np.arange(30, 90), 1e-2 * rng.standard_normal(60)
    targets = np.column_stack([1e-3 * rng.standard_normal(N), np.zeros(N), np.zeros(N)])
    targets[held, 2] = wanted
    factors = np.column_stack([np.full(N, 50.0), np.full(N, 1e-7), np.zeros(N)])
    factors[held, 2] = 1e20 * 10.0 ** rng.uniform(-6, 0, 60)
    c = np.vstack([sp.c, np.zeros((2, sp.order))])
    d = np.array([sp.d[0, 0], 1.0, 1.0])
    found = minimiser(sp.a, sp.b[:, 0], c, d, factors, targets)
    np.testing.assert_allclose(found[held], wanted, rtol=1e-13)
    open_ = np.setdiff1d(np.arange(N), held)
    j = np.vstack([np.sqrt(50.0) * lifted(sp), np.sqrt(1e-7) * np.eye(N)])
    b = np.append(np.sqrt(50.0) * targets[:, 0], np.zeros(N)) - j[:, held] @ wanted
    rest = np.linalg.lstsq(j[:, open_], b, rcond=None)[0]
    np.testing.assert_allclose(found[open_], rest, atol=1e-9 * np.abs(rest).max())


def test_many_bounds_on_an_ordinary_stage_are_solved_to_the_end():
    """300 bounds hold at once: by P instead of its square root the residuals are 8e-8 and 8e-3."""
    t = 1e-3

    def czpk(zeros, poles, gain):
        return {"form": "czpk", "zeros": zeros, "poles": poles, "gain": gain}

    mode = [[-3.333, 219.886], [-3.333, -219.886]]
    plant = czpk([[-2.0, 170.33], [-2.0, -170.33]], [0.0, 0.0, *mode], 0.333333)
    controller = czpk([-16.755], [-301.59], 75798.0)
    table = {"name": "stage", "sample_time": t, "plant": plant | {"delay": 1}}
    stage = plant_from_dict(table | {"controller": controller})
    reference = moves([Move(0.1, 0.05, 0.3, 4.0, 150.0)], 0.6, t)
    bounds = Constraints(feedforward=[-16.0, 14.5], feedforward_rate=2500.0, command=[-17.0, 16.0])
    weights = Weights(1.0, Zpk([0.5], [0.2], 1e-5, t), 1e-12)
    task = LearningTask(stage, SimulatedMachine(stage), FreeSignal(), reference, weights, bounds)
    first, *trials = learn(task, 3, np.random.SeedSequence(2))
    for trial in trials:
        assert trial.update.status == "optimal"
        assert trial.update.active > 300
        assert trial.error_norm < 0.5 * first.error_norm


@pytest.mark.parametrize("kind", list(WEIGHTS))
@pytest.mark.parametrize(
    "shares",
    [
        {"feedforward": 0.7},
        {"feedforward": 0.2},
        {"feedforward_rate": 0.4},
        {"command": 0.6},
        {"feedforward": 0.8, "feedforward_rate": 0.5, "command": 0.7},
    ],
)
def test_equals_the_written_out_quadratic_program(model, trial, shares, kind):
    reference, feedforward, error, command = trial
    weights = WEIGHTS[kind]
    t = model.sample_time
    free = FreeSignalUpdate(model, reference, weights).update(feedforward, error).feedforward
    to_command = model.loop.system.select([1], [1])
    peaks = {
        "feedforward": np.abs(free).max(),
        "feedforward_rate": np.abs(np.diff(free)).max() / t,
        "command": np.abs(command + to_command.filter(free - feedforward)).max(),
    }
    limits = {name: share * peaks[name] for name, share in shares.items()}
    found = BoundedFreeSignal(model, reference, weights, Constraints(**limits)).update(
        feedforward, error, command
    )
    assert found.report.status == "optimal"
    assert found.report.kkt_residual < 1e-8
    assert found.report.active > 0
    f = found.feedforward
    u = command + to_command.filter(f - feedforward)
    reached = {
        "feedforward": np.abs(f).max(),
        "feedforward_rate": np.abs(np.diff(f)).max() / t,
        "command": np.abs(u).max(),
    }
    for name, limit in limits.items():
        assert reached[name] <= limit * (1 + 1e-7)

    def cost(f):
        e = error - model.loop.process_sensitivity.filter(f - feedforward)
        return weights.cost(e, f, f - feedforward)

    x = cp.Variable(N)
    j = lifted(model.loop.process_sensitivity)
    roots = [np.sqrt(np.broadcast_to(w, N)) for w in
             (weights.error, weights.feedforward, weights.feedforward_change)]  # fmt: skip
    change = 1e3 * (x - feedforward)
    objective = (
        cp.sum_squares(cp.multiply(roots[0], 1e3 * error - j @ change))
        + cp.sum_squares(cp.multiply(roots[1], 1e3 * x))
        + cp.sum_squares(cp.multiply(roots[2], change))
    )
    rows = []
    if "feedforward" in limits:
        rows.append(cp.abs(x) <= limits["feedforward"])
    if "feedforward_rate" in limits:
        rows.append(cp.abs(cp.diff(x)) <= t * limits["feedforward_rate"])
    if "command" in limits:
        rows.append(cp.abs(command + lifted(to_command) @ (x - feedforward)) <= limits["command"])
    cp.Problem(cp.Minimize(objective), rows).solve(
        solver=cp.CLARABEL, tol_gap_abs=1e-12, tol_gap_rel=1e-12, tol_feas=1e-12
    )
    assert cost(f) <= cost(x.value) * (1 + 1e-7)
    np.testing.assert_allclose(f, x.value, atol=2e-4 * np.abs(f).max())


def test_bounds_that_nothing_meets_change_nothing(model, trial):
    reference, feedforward, error, command = trial
    free = FreeSignalUpdate(model, reference, WEIGHTS["scalar"]).update(feedforward, error)
    wide = Constraints(feedforward=1e6, feedforward_rate=1e12, command=1e6)
    found = BoundedFreeSignal(model, reference, WEIGHTS["scalar"], wide).update(
        feedforward, error, command
    )
    np.testing.assert_array_equal(found.feedforward, free.feedforward)
    assert found.report.active == 0


def test_bounds_that_contradict_each_other_are_said_in_words(model, trial):
    reference, feedforward, error, command = trial
    low, high = np.full(N, -1e3), np.full(N, 1e3)
    low[80:], high[:80] = 5.0, -5.0  # a step of 10 A at once ...
    tight = Constraints(feedforward=np.array([low, high]), feedforward_rate=100.0)  # ... or 0.1 A
    found = BoundedFreeSignal(model, reference, WEIGHTS["scalar"], tight).update(
        feedforward, error, command
    )
    assert found.report.status == "infeasible"
    for part in (
        "upper bound 100 on feedforward_rate at t = 0.08 s",
        "lower bound 5 on feedforward",
    ):
        assert part in found.report.message
    np.testing.assert_array_equal(found.feedforward, feedforward)


def test_a_free_signal_has_no_parameters_to_bound(model, trial):
    with pytest.raises(InputError, match="no parameters; bound feedforward"):
        BoundedFreeSignal(model, trial[0], WEIGHTS["scalar"], Constraints(parameters=1.0))
    bounded = BoundedFreeSignal(model, trial[0], WEIGHTS["scalar"], Constraints(command=1.0))
    with pytest.raises(InputError, match="trial's command u"):
        bounded.update(trial[1], trial[2])


def test_learning_a_free_signal_keeps_within_its_bounds(model, reference):
    machine = SimulatedMachine(model)
    limit = 0.35

    def trials(constraints):
        task = LearningTask(
            model, machine, FreeSignal(), reference, Weights(1e3, 1e-7), constraints
        )
        return list(learn(task, 3, np.random.SeedSequence(2)))

    free, bound = trials(Constraints()), trials(Constraints(feedforward=limit))
    assert np.abs(free[-1].feedforward).max() > 1.3 * limit
    assert np.abs(bound[-1].feedforward).max() <= limit * (1 + 1e-9)
    assert free[-1].error_norm < bound[-1].error_norm < 0.9 * bound[0].error_norm
    assert bound[-1].update.status == "optimal"

"""The update against dense oracles, its own KKT conditions, and bounds that bind."""

from itertools import pairwise

import numpy as np
import pytest

from ffl.bases import FIR, OBF, Derivatives, SumBasis
from ffl.errors import InputError
from ffl.learn import Constraints, FreeSignalUpdate, NormOptimal, Weights
from ffl.learn.convex import conflict
from ffl.learn.free_signal import minimiser
from ffl.systems import Plant, Zpk

T = 1e-3
INSIDE = [0.9039, 0.9853, 0.9854 + 0.0457j, 0.9854 - 0.0457j, 0.9988]
OUTSIDE = [1.008 + 0.0477j, 1.008 - 0.0477j, 1.078]
BASES = {
    "fir": FIR(3, 6, sample_time=T),
    "obf": OBF(INSIDE, OUTSIDE, True, 1, T),
    "obf_repeated": OBF(INSIDE, OUTSIDE, True, 2, T),
    "derivatives": Derivatives(sample_time=T),
}
SHAPE = Zpk([-0.3], [0.6], 0.4, T)


def toeplitz(impulse):
    n = len(impulse)
    return np.array([[impulse[i - k] if i >= k else 0.0 for k in range(n)] for i in range(n)])


@pytest.mark.parametrize("name", sorted(BASES))
def test_update_is_optimal_by_kkt_and_by_comparison(name, model, reference, first_trial):
    error, command = first_trial
    weights = Weights(1e5, 1e-7, 1e-8)
    problem = NormOptimal(model, BASES[name], reference, weights)
    theta = np.zeros(BASES[name].n_parameters)
    update = problem.update(theta, error, command)
    assert update.report.kkt_residual < (1e-7 if name == "fir" else 1e-8)  # FIR taps cancel
    assert update.report.status == "optimal"

    def cost(feedforward):
        predicted = error - model.loop.process_sensitivity.filter(feedforward)
        return weights.cost(predicted, feedforward, feedforward)

    best = cost(update.feedforward)
    rng = np.random.default_rng(1)
    for _ in range(5):
        step = 1e-2 * rng.standard_normal(len(theta)) * np.abs(update.theta)
        assert cost(problem.regressors @ (update.theta + step)) > best


@pytest.mark.parametrize(
    "weights",
    [
        Weights(50.0, 1e-7, 0.0),
        Weights(50.0, 1e-5, 1e-4),
        Weights(np.linspace(1, 50, 400), 1e-6, np.linspace(0, 1e-4, 400)),
        Weights(SHAPE, 1e-6, SHAPE),
        Weights(np.repeat([0.0, 50.0, 0.0], [100, 200, 100])),
    ],
    ids=["paper", "change", "vectors", "filters", "window"],
)
def test_update_equals_a_dense_solution_of_criterion_3(weights, model, reference, first_trial):
    n = 400
    r, error = reference[700 : 700 + n] - reference[700], first_trial[0][:n]
    basis = Derivatives(["velocity", "acceleration", "jerk"], T)
    problem = NormOptimal(model, basis, r, weights)
    theta = np.array([0.1, 2.0, 1e-3])
    phi = basis.regressors(r)
    sp = toeplitz(model.loop.process_sensitivity.impulse_response(n))

    def dense(weight):
        if isinstance(weight, Zpk):
            g = toeplitz(weight.state_space().impulse_response(n))
            return g.T @ g
        return np.diag(np.broadcast_to(weight, n))

    we, wf, wd = (
        dense(w) for w in (weights.error, weights.feedforward, weights.feedforward_change)
    )
    j = sp @ phi
    hessian = j.T @ we @ j + phi.T @ (wf + wd) @ phi
    gradient = j.T @ we @ (error + j @ theta) + phi.T @ wd @ phi @ theta
    expected = np.linalg.solve(hessian, gradient)
    assert problem.update(theta, error).theta == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", sorted(BASES))
def test_osqp_path_agrees_with_the_closed_form_where_nothing_binds(
    name, model, reference, first_trial
):
    error, command = first_trial
    weights, theta = Weights(1e5, 1e-7), np.zeros(BASES[name].n_parameters)
    closed = NormOptimal(model, BASES[name], reference, weights).update(theta, error, command)
    peak = np.abs(closed.feedforward).max()
    for constraints in (Constraints(), Constraints(feedforward=10 * peak)):
        osqp = NormOptimal(model, BASES[name], reference, weights, constraints, path="osqp")
        other = osqp.update(theta, error, command)
        assert np.abs(other.feedforward - closed.feedforward).max() <= 1e-8 * peak
        assert other.report.active == 0


@pytest.mark.parametrize("name", ["fir", "obf", "obf_repeated"])
def test_bounds_hold_and_the_solution_is_optimal(name, model, reference, first_trial):
    error, command = first_trial
    weights, theta = Weights(1e5, 1e-7), np.zeros(BASES[name].n_parameters)
    free = NormOptimal(model, BASES[name], reference, weights).update(theta, error, command)
    limit = 0.8 * np.abs(free.feedforward).max()
    bounded = NormOptimal(model, BASES[name], reference, weights, Constraints(feedforward=limit))
    update = bounded.update(theta, error, command)
    assert update.report.status == "optimal"
    assert update.report.kkt_residual < 1e-8
    assert update.report.active > 0
    assert np.abs(update.feedforward).max() <= limit * (1 + 1e-8)
    assert np.abs(update.feedforward).max() == pytest.approx(limit, rel=1e-8)


def test_rate_command_and_parameter_bounds(model, reference, first_trial):
    error, command = first_trial
    basis, weights, theta = BASES["obf"], Weights(1e5, 1e-7), np.zeros(9)
    free = NormOptimal(model, basis, reference, weights).update(theta, error, command)
    rate = 0.7 * np.abs(np.diff(free.feedforward)).max() / T
    to_command = model.loop.system.select([1], [1])
    peak = np.abs(command + to_command.filter(free.feedforward)).max()
    bounds = Constraints(feedforward_rate=rate, command=0.9 * peak)
    update = NormOptimal(model, basis, reference, weights, bounds).update(theta, error, command)
    assert np.abs(np.diff(update.feedforward)).max() / T <= rate * (1 + 1e-8)
    predicted = command + to_command.filter(update.feedforward)
    assert np.abs(predicted).max() <= 0.9 * peak * (1 + 1e-8)
    assert update.report.kkt_residual < 1e-8
    largest = 0.5 * np.abs(free.theta).max()
    bounds = Constraints(parameters=largest)
    update = NormOptimal(model, basis, reference, weights, bounds).update(theta, error, command)
    assert np.abs(update.theta).max() <= largest * (1 + 1e-8)
    assert update.report.kkt_residual < 1e-8


def test_per_sample_bounds_act_where_they_are(model, reference, first_trial):
    n = len(reference)
    bounds = np.full((2, n), np.inf)
    bounds[0] = -np.inf
    bounds[1, 1000:1100] = 0.1
    problem = NormOptimal(
        model, BASES["obf"], reference, Weights(1e5, 1e-7), Constraints(feedforward=bounds)
    )
    f = problem.update(np.zeros(9), *first_trial).feedforward
    assert f[1000:1100].max() <= 0.1 + 1e-9
    assert f.max() > 0.5


def test_what_unused_directions_would_bring_is_said(model, reference, first_trial):
    """FIR taps span their own differences, of which the condition number is 13 and not 1e13."""
    error, weights, basis = first_trial[0], Weights(50.0, 1e-7), BASES["fir"]
    problem = NormOptimal(model, basis, reference, weights)
    report = problem.update(np.zeros(10), error).report
    assert report.rank < 10
    taps = list(basis.regressors(reference).T)
    columns = []
    while taps:
        columns.append(taps[len(taps) // 2])
        taps = [a - b for a, b in pairwise(taps)]
    phi = np.column_stack(columns)
    response = model.loop.process_sensitivity.filter_columns(phi)
    matrix = np.vstack([np.sqrt(50.0) * response, np.sqrt(1e-7) * phi])
    scale = np.linalg.norm(matrix, axis=0)
    assert np.linalg.cond(matrix / scale) < 100
    b = np.concatenate([np.sqrt(50.0) * error, np.zeros(len(error))])
    x = np.linalg.lstsq(matrix / scale, b, rcond=None)[0]
    least = np.sum((matrix / scale @ x - b) ** 2)
    following = problem.update(np.zeros(10), error).feedforward
    predicted = error - model.loop.process_sensitivity.filter(following)
    excess = weights.cost(predicted, following, following) / least - 1.0
    assert excess > 0.01
    assert report.left_out == pytest.approx(excess, rel=1e-3)
    full = NormOptimal(model, BASES["derivatives"], reference, weights)
    report = full.update(np.zeros(4), error).report
    assert (report.rank, report.left_out) == (4, 0.0)


def test_a_column_given_twice_leaves_nothing_out(model, reference, first_trial):
    """What the second one adds is rounding, no direction."""
    problem = NormOptimal(
        model, SumBasis([BASES["derivatives"]] * 2), reference, Weights(50.0, 1e-7)
    )
    report = problem.update(np.zeros(8), first_trial[0]).report
    assert report.rank == 4
    assert report.left_out < 1e-3


def test_infeasible_bounds_say_which_and_when(model, reference, first_trial):
    problem = NormOptimal(
        model, BASES["obf"], reference, Weights(1e5, 1e-7), Constraints(command=1e-3)
    )
    theta = np.arange(9.0)
    update = problem.update(theta, *first_trial)
    assert update.report.status == "infeasible"
    assert "on command at t = " in update.report.message
    assert "widen" in update.report.message
    assert np.array_equal(update.theta, theta)


def test_a_bound_that_the_basis_cannot_meet_alone_is_named_alone(model, reference, first_trial):
    """At rest the feedforward is zero: no other bound has a part in that."""
    problem = NormOptimal(
        model,
        BASES["derivatives"],
        reference,
        Weights(1e5, 1e-7),
        Constraints(feedforward=[1.0, 2.0]),
    )
    message = problem.update(np.zeros(4), *first_trial).report.message
    assert "lower bound 1 on feedforward at t = 0 s: it is 0 there whatever they are" in message
    assert "against" not in message


def test_only_bounds_that_contradict_each_other_are_named():
    """x + y <= 1 against x >= 1 and y >= 1, scaled; three more rows have no part in it."""
    g = np.array([[1.0, 1.0], [0.0, 1.0], [-3.0, 0.0], [1.0, -1.0], [0.0, -1e3], [0.0, 0.0]])
    h = np.array([1.0, 5.0, -3.0, 9.0, -1e3, 0.0])
    assert sorted(conflict(g, h)) == [0, 2, 4]
    assert conflict(g[:4], h[:4]) == []
    assert conflict(g, np.append(h[:5], -1.0)) == [5]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Weights(0.0), "weights.error = 0 must be positive"),
        (lambda: Weights(np.zeros(5)), "weights.error = 0 must be positive at some sample"),
        (lambda: Weights(np.array([1.0, -1.0])), "weights.error = -1 must not be negative"),
        (lambda: Weights(-1.0), "weights.error = -1"),
        (lambda: Weights(1.0, -1e-7), "weights.feedforward = -1e-07 must not be negative"),
        (lambda: Weights(1.0, 0.0, np.nan), "weights.feedforward_change"),
        (lambda: Weights(Zpk([], [1.5], 1.0, T)), "causal and stable"),
        (lambda: Constraints(feedforward=-1.0).limits("feedforward", 5), "must be positive"),
        (lambda: Constraints(command=[2.0, 1.0]).limits("command", 5), "exchange"),
        (lambda: Constraints(command=np.ones(3)).limits("command", 5), "shape"),
        (lambda: Constraints(command=[np.nan, 1.0]).limits("command", 5), "NaN"),
    ],
)
def test_wrong_weights_and_bounds_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_vector_weight_of_wrong_length_is_refused(model, reference):
    with pytest.raises(InputError, match="has 7 values"):
        NormOptimal(model, BASES["fir"], reference, Weights(np.ones(7)))
    with pytest.raises(InputError, match="no bounds"):
        NormOptimal(
            model, BASES["fir"], reference, Weights(), Constraints(feedforward=1.0), "closed_form"
        )


@pytest.mark.parametrize(
    "weights",
    [
        Weights(50.0, 1e-7, 0.0),
        Weights(1e5, 1e-6, 1e-5),
        Weights(np.linspace(1, 50, 500), 1e-6, 1e-7),
        Weights(SHAPE, 1e-6, 0.0),
        Weights(np.repeat([0.0, 50.0, 0.0], [100, 300, 100]), 1e-6),
    ],
    ids=["paper", "change", "vector", "filter", "window"],
)
def test_free_signal_recursion_equals_the_dense_lifted_update(
    weights, model, reference, first_trial
):
    n = 500
    error = first_trial[0][600 : 600 + n]
    previous = np.random.default_rng(2).standard_normal(n)
    update = FreeSignalUpdate(model, reference[:n], weights).update(previous, error)
    sp = toeplitz(model.loop.process_sensitivity.impulse_response(n))

    def dense(weight):
        if isinstance(weight, Zpk):
            g = toeplitz(weight.state_space().impulse_response(n))
            return g.T @ g
        return np.diag(np.broadcast_to(weight, n))

    we, wf, wd = (
        dense(w) for w in (weights.error, weights.feedforward, weights.feedforward_change)
    )
    change = np.linalg.solve(sp.T @ we @ sp + wf + wd, sp.T @ we @ error - wf @ previous)
    assert np.abs(update.feedforward - previous - change).max() < 1e-7 * np.abs(change).max()
    assert update.report.kkt_residual < 1e-8


@pytest.mark.parametrize("pole", [0.9, 0.99, 0.9999])
def test_free_signal_is_the_exact_recursion_where_the_gain_has_not_settled(pole, monkeypatch):
    """A gain held too early is mended by solving again, or recursed to the first sample."""
    n = 3000
    slow = Plant("slow", Zpk([], [pole], 1.0 - pole, T))
    error = np.sin(np.arange(n) / 150.0)
    update = FreeSignalUpdate(slow, np.zeros(n), Weights(1.0, 1.0))
    parts = update.a, update.b, update.c, update.d, update.factors
    targets = update.targets(np.zeros(n), error)
    exact = minimiser(*parts, targets, settling=n)
    held = minimiser(*parts, targets, settling=100)
    asked = []

    def counted(*arguments):
        asked.append(arguments[-1])
        return minimiser(*arguments)

    monkeypatch.setattr("ffl.learn.free_signal.SETTLING", 100)
    monkeypatch.setattr("ffl.learn.free_signal.minimiser", counted)
    found = update.update(np.zeros(n), error)
    assert found.report.status == "optimal"
    assert found.report.kkt_residual < 1e-10
    assert len(asked) <= 5
    size = np.abs(exact).max()
    assert np.abs(found.feedforward - exact).max() < 1e-8 * size
    assert (asked == [100]) == (pole == 0.9)
    assert pole == 0.9 or np.abs(held - exact).max() > 1e-3 * size
    assert pole != 0.9999 or asked[-1] == n


def test_free_signal_needs_some_weight_on_the_signal(model, reference):
    with pytest.raises(InputError, match="above zero"):
        FreeSignalUpdate(model, reference, Weights(1.0))


def test_a_sample_of_the_free_signal_that_nothing_weighs_is_named(model, reference):
    """The last samples answer in nothing that counts: W_e ends before them, and W_f too."""
    n = len(reference)
    window = np.repeat([1.0, 0.0], [2990, n - 2990])
    update = FreeSignalUpdate(model, reference, Weights(window, 1e-7 * window))
    with pytest.raises(InputError, match=f"nothing weighs the free signal at sample {n - 1}"):
        update.update(np.zeros(n), np.ones(n))

"""The parts of a linear fit, each against another road to the same answer."""

import itertools

import numpy as np
import pytest
import scipy.signal
from matplotlib.figure import Figure

from ffl.errors import InputError
from ffl.identify.linear import Signals, best_linear, fit_linear
from ffl.identify.linear.coordinates import (
    Point,
    Structure,
    balance,
    gramian_factor,
    move,
    tangent,
)
from ffl.identify.linear.ladder import Candidate, choose
from ffl.identify.linear.noise import burg, whiteness
from ffl.identify.linear.predictors import Innovation, Simulation
from ffl.identify.linear.problem import Problem
from ffl.identify.linear.sensitivity import simulate, simulate_with_derivatives
from ffl.identify.linear.signals import Scale, as_signals
from ffl.identify.linear.subspace import long_arx, realise, regularised_fir, stabilise
from ffl.recordings import Recording
from ffl.report.linear_figures import (
    fit_overlay,
    magnitude_band,
    order_ladder,
    residual_correlations,
)
from ffl.systems import Controller, StateSpace, Zpk, closed_loop

T = 0.01
PLANT = Zpk([0.6], [0.85 + 0.35j, 0.85 - 0.35j], 0.1, T)
CONTROLLER = Controller.of_error(Zpk([0.9], [0.7], 0.4, T))


def a_point(s, rng):
    a = np.array([[0.8, 0.3, 0.0], [-0.3, 0.8, 0.0], [0.0, 0.0, 0.5]])
    b, c = 0.1 * rng.standard_normal(3), np.array([0.1, -0.08, 0.06])
    if s.integrators:
        a[2, 2], b[2] = 1.0, 1.0
    k = np.array([0.2, 0.1, 0.3]) if s.innovation else np.zeros(3)
    offset = 0.3 if s.offset != "none" else 0.0
    return Point(a, b, c, 0.1 * s.feedthrough, k, offset)


def a_predictor(kind, s):
    if kind == "innovation":
        return Innovation(s)
    if kind == "in_loop":
        return Simulation.in_loop(s, CONTROLLER, Scale(2.0, 0.5))
    return Simulation.open_loop(s)


STRUCTURES = [
    (kind, Structure(3, integrators, delay, True, kind == "innovation", offset))
    for kind, integrators, delay, offset in itertools.product(
        ("open_loop", "innovation", "in_loop"), (0, 1), (0, 2), ("none", "output", "input")
    )
]


def test_the_gramian_of_close_poles_with_large_couplings_stays_finite():
    """What `stabilise` left of a start for a drive in its loop: powers of the dense matrix overflow."""
    t = np.diag([0.78, 0.99494, 0.99503, 0.99503])
    t[0, 1:], t[1, 2:], t[2, 3] = (119.0, 72.0, 335.0), (0.42, 1.8), 0.52
    b = np.array([[0.3], [-1.0], [2.0], [0.5]])
    expected, response = np.zeros((4, 4)), b
    for _ in range(10_000):
        expected, response = expected + response @ response.T, t @ response
    q, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((4, 4)))
    found = q.T @ gramian_factor(q @ t @ q.T, q @ b)
    assert np.abs(found @ found.T - expected).max() < 1e-4 * np.abs(expected).max()


@pytest.mark.parametrize(("kind", "s"), STRUCTURES)
def test_derivatives_equal_central_differences(kind, s):
    rng = np.random.default_rng(1)
    n = 60
    piece = Signals(*rng.standard_normal((2, n)), T, r=rng.standard_normal(n))
    predictor, point = a_predictor(kind, s), balance(a_point(s, rng), s)
    directions = tangent(point, s)
    assert directions.offset.size == s.n_parameters
    inputs = predictor.inputs(piece)
    x0 = rng.standard_normal(predictor.matrix(point).shape[0] - 1)
    y, dy = simulate_with_derivatives(
        predictor.matrix(point), predictor.derivatives(point, directions), inputs, x0
    )
    np.testing.assert_allclose(y, simulate(predictor.matrix(point), inputs, x0), atol=1e-10)
    for q in range(s.n_parameters):
        step = np.zeros(s.n_parameters)
        step[q] = 1e-6
        high = simulate(predictor.matrix(move(point, directions, step)), inputs, x0)
        low = simulate(predictor.matrix(move(point, directions, -step)), inputs, x0)
        scale = max(np.abs(dy[:, q]).max(), 1e-3)
        np.testing.assert_allclose(dy[:, q], (high - low) / 2e-6, atol=1e-6 * scale)


def test_simulation_in_the_loop_equals_the_assembled_loop():
    s = Structure(3, delay=2, offset="none")
    rng = np.random.default_rng(2)
    point = a_point(s, rng)
    piece = Signals(np.zeros(50), np.zeros(50), T, *rng.standard_normal((3, 50)))
    found = simulate(
        (p := a_predictor("in_loop", s)).matrix(point),
        p.inputs(Signals(piece.u, piece.y, T, piece.r / 0.5, piece.f / 2.0, piece.d / 2.0)),
    )
    system = StateSpace(point.a, point.b[:, None] / 2.0, 0.5 * point.c[None], 0.0, T)
    line = Zpk([], [], 1.0, T, 2).state_space()
    from ffl.systems import series

    loop = closed_loop(series(line, system), CONTROLLER).system
    y = loop.filter(np.column_stack([piece.r, piece.f, piece.d, np.zeros(50)]))[:, 0]
    np.testing.assert_allclose(0.5 * found, y, atol=1e-12)


def test_balancing_and_the_orbit_leave_the_model_alone():
    s = Structure(3, innovation=True)
    rng = np.random.default_rng(3)
    point = a_point(s, rng)
    balanced = balance(point, s)
    z = np.exp(1j * np.linspace(0.1, 3.0, 7))
    np.testing.assert_allclose(balanced.system(T).at(z), point.system(T).at(z), rtol=1e-10)
    # A change of basis is invisible: to first order it has no part in the local coordinates.
    directions = tangent(balanced, s)
    x = rng.standard_normal((3, 3))
    orbit = np.block(
        [
            [x @ balanced.a - balanced.a @ x, (x @ balanced.b)[:, None]],
            [-(balanced.c @ x)[None], np.zeros((1, 1))],
        ]
    )
    inner = np.einsum("ij,ijq->q", orbit, directions.matrix) + (x @ balanced.k) @ directions.k
    np.testing.assert_allclose(inner, 0.0, atol=1e-12)


def test_subspace_start_is_near_without_noise():
    """The long ARX is not unique here (least norm is taken), so near is what can be asked."""
    rng = np.random.default_rng(4)
    u = rng.standard_normal(400)
    start = realise(long_arx((Signals(u, PLANT.filter(u), T),), Structure(2)), 2, True)
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(start.a)), np.sort_complex(PLANT.poles), atol=5e-3
    )


def test_realisation_start_from_the_regularised_fir():
    rng = np.random.default_rng(5)
    u = rng.standard_normal(600)
    y = PLANT.filter(u)
    noisy = y + 0.3 * np.std(y) * rng.standard_normal(600)
    model = regularised_fir((Signals(u, noisy, T),), Structure(2))
    truth = PLANT.impulse_response(model.from_u.size + 1)[1:]
    # Plain least squares has the taps' variance sigma^2/N each; the prior must do clearly better.
    columns = np.column_stack([np.roll(u, k) for k in range(1, truth.size + 1)])[truth.size :]
    plain = np.linalg.lstsq(columns, noisy[truth.size :], rcond=None)[0]
    assert np.linalg.norm(model.from_u - truth) < 0.7 * np.linalg.norm(plain - truth)
    start = realise(model, 2, False)
    assert np.abs(np.linalg.eigvals(start.a) - PLANT.poles[0]).min() < 0.05


def test_stabilise_moves_only_what_is_unstable():
    a = np.diag([0.5, 1.3, -0.9])
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(stabilise(a)).real), [-0.9, 0.5, 0.995])
    assert stabilise(np.diag([0.5, 0.9])) is not None


def test_burg_finds_the_noise_model_and_stays_stable():
    rng = np.random.default_rng(6)
    truth = np.real(np.poly([0.9, 0.5 + 0.6j, 0.5 - 0.6j]))
    pieces = [scipy.signal.lfilter([1.0], truth, rng.standard_normal(n)) for n in (3000, 5000)]
    coefficients, variance = burg(pieces)
    np.testing.assert_allclose(coefficients[:4], truth, atol=0.06)
    assert variance == pytest.approx(1.0, rel=0.05)
    assert np.abs(np.roots(coefficients)).max() < 1.0


def test_whiteness_test_keeps_its_level_and_sees_colour():
    rng = np.random.default_rng(7)
    p = np.array([whiteness([rng.standard_normal(400)], 0).p_value for _ in range(200)])
    assert np.mean(p < 0.05) == pytest.approx(0.05, abs=0.05)
    coloured = scipy.signal.lfilter([1.0], [1.0, -0.8], rng.standard_normal(400))
    test = whiteness([coloured], 0)
    assert test.p_value < 1e-10
    assert test.n_effective < 150


def test_held_out_samples_do_not_touch_the_fit():
    rng = np.random.default_rng(8)
    u = rng.standard_normal(200)
    y = PLANT.filter(u)
    spoiled = y.copy()
    spoiled[100:130] += 5.0
    weight = np.ones(200)
    weight[100:130] = 0.0
    s = Structure(2, offset="none")
    ss = PLANT.state_space()
    point = Point(ss.a, ss.b[:, 0], ss.c[0], 0.0, np.zeros(2), 0.0)
    problem = Problem(Simulation.open_loop(s), s, (Signals(u, spoiled, T),), weights=(weight,))
    assert problem.cost(point) < 1e-10
    assert problem.n_samples == 170
    r, z = problem.compressed(point, tangent(point, s))
    assert np.abs(z).max() < 1e-5 * np.abs(r).max()


def test_choice_takes_the_simplest_within_the_noise_of_the_comparison():
    rng = np.random.default_rng(9)
    common = 0.01 * (1 + 0.3 * rng.standard_normal(40))

    def rung(order, excess, status="converged"):
        noise = 1e-4 * order * (-1.0) ** np.arange(40)  # scatters, but has no mean
        return Candidate(Structure(order), common + excess + noise, 0.1, status)

    ladder = [rung(1, 0.5), rung(2, 1e-6), rung(3, 0.0), rung(4, -1e-5)]
    index, rungs = choose(ladder, 0.0)
    assert index == 1
    assert rungs[0].excess > 100 * rungs[0].std_error
    # The best by far, but its pole sits on the stability limit: not chosen.
    index, _ = choose([*ladder, rung(5, -0.009, "boundary")], 0.0)
    assert index == 1


def good(n=200):
    rng = np.random.default_rng(10)
    u = rng.standard_normal(n)
    return {"u": u, "y": PLANT.filter(u), "sample_time": T}


def changed(name, value, n=200):
    signals = good(n)
    signals[name] = value(signals[name]) if callable(value) else value
    return signals


def with_nan(x):
    x = x.copy()
    x[17] = np.nan
    return x


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Signals(**changed("y", with_nan)), r"y\[17\] is NaN"),
        (lambda: Signals(**changed("y", lambda y: y[:-1])), "199 samples, u has 200"),
        (lambda: Signals(**changed("y", lambda y: y[:, None])), "one value per sample"),
        (lambda: Signals(**changed("sample_time", 0.0)), "sample_time = 0.0"),
        (lambda: Signals(**changed("y", None)), "no column y"),
        (lambda: fit_linear(Signals(**changed("u", np.ones(200))), 2), "input u is constant"),
        (lambda: fit_linear(Signals(**changed("y", np.ones(200))), 2), "output y is constant"),
        (lambda: fit_linear(Signals(**good(20)), 4), "20 samples for 9 parameters"),
        (
            lambda: fit_linear(Signals(**changed("u", lambda u: np.sin(np.arange(200.0)))), 3),
            "excites only 2 directions",
        ),
        (lambda: fit_linear([Signals(**good()), Signals(**good(10))], 2), "10 samples are too few"),
        (
            lambda: fit_linear([Signals(**good()), Signals(**changed("sample_time", 0.02))], 2),
            "resample",
        ),
        (lambda: fit_linear([], 2), "no recording given"),
        (lambda: fit_linear(Signals(**good()), 0), "order >= 1"),
        (lambda: fit_linear(Signals(**good()), 2, integrators=3), "integrators <= order"),
        (lambda: fit_linear(Signals(**good()), 2, method="magic"), "method 'magic'"),
        (lambda: fit_linear(Signals(**good()), 2, noise="pink"), "noise 'pink'"),
        (lambda: fit_linear(Signals(**good()), 2, offset="side"), "offset 'side'"),
        (lambda: fit_linear(Signals(**good()), 2, method="closed_loop"), "needs the controller"),
        (
            lambda: fit_linear(Signals(**good()), 2, method="closed_loop", controller=CONTROLLER),
            "neither r nor f",
        ),
        (lambda: best_linear(Signals(**good()), ()), "orders is empty"),
        (lambda: best_linear(Signals(**good()), (-2, 3)), "order -2 is not 1 or more"),
        (lambda: as_signals([np.zeros(3)]), "give a Recording, or Signals"),
    ],
)
def test_bad_input_is_one_line(make, says):
    with pytest.raises(InputError, match=says) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_a_recording_is_read_as_it_says_it_is():
    rng = np.random.default_rng(11)
    r = rng.standard_normal(400)
    y, u = closed_loop(PLANT, CONTROLLER).system.filter(np.column_stack([r, 0 * r, 0 * r, 0 * r])).T
    t = T * np.arange(400)
    nothing = np.full(400, np.nan)
    full = Recording(t, r, 0 * r, u, y, sample_time=T, source="a.csv")
    no_u = Recording(t, r, 0 * r, nothing, y, sample_time=T, missing=frozenset("u"))
    np.testing.assert_allclose(as_signals(no_u, CONTROLLER)[0].u, u, atol=1e-9)
    with pytest.raises(InputError, match="command u is not recorded"):
        as_signals(no_u)
    open_machine = Recording(t, 0 * r, r, r, y, sample_time=T, missing=frozenset("rf"))
    (piece,) = as_signals(open_machine)
    assert piece.r is None
    assert piece.f is None
    model = fit_linear(full, 2, controller=CONTROLLER)
    assert model.sources == ("a.csv",)
    assert model.nrmse < 1e-8


def test_figures_draw_what_they_are_given():
    rng = np.random.default_rng(12)
    u = rng.standard_normal(400)
    signals = Signals(u, PLANT.filter(u) + 0.02 * rng.standard_normal(400), T)
    model = best_linear(signals, (1, 2, 3))
    axes = Figure().subplots(2, 3).ravel()
    ladder = order_ladder(axes[0], model)
    assert ladder.get_ylabel() == "NRMSE [1]"
    np.testing.assert_array_equal(ladder.lines[0].get_xdata(), [1, 2, 3])
    assert model.plot(axes[1]).get_xlabel() == "real part [1]"
    overlay = fit_overlay(axes[2], model.overlay(signals), "m")
    assert overlay.get_ylabel() == "output [m]"
    np.testing.assert_array_equal(overlay.lines[0].get_ydata(), signals.y)
    f = np.geomspace(0.1, 49, 50)
    band = magnitude_band(axes[3], f, model.response(f), model.response_std(f), "m/A")
    assert band.get_ylabel() == "|P| [m/A]"
    assert len(residual_correlations(axes[4:], model)) == 2


def test_summary_is_plain_json():
    import json

    model = fit_linear(Signals(**good()), 2)
    read = json.loads(json.dumps(model.summary(), allow_nan=False))
    assert read["order"] == 2
    assert len(read["poles"]) == 2

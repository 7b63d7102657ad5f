"""Forward linear models: known systems recovered, their intervals hold, feedback does no harm."""

import numpy as np
import pytest

from ffl.identify.linear import Signals, best_linear, estimate_delay, fit_linear
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording
from ffl.systems import Controller, StateSpace, Zpk, closed_loop, load_plant, save_plant

T = 0.01
PLANT = Zpk([0.6], [0.85 + 0.35j, 0.85 - 0.35j], 0.1, T)
FOURTH = Zpk(
    [0.5, 0.3 + 0.4j, 0.3 - 0.4j], [0.9 + 0.3j, 0.9 - 0.3j, 0.7 + 0.6j, 0.7 - 0.6j], 0.01, T
)
CONTROLLER = Controller.of_error(Zpk([0.8], [0.3], 1.0, T))


def open_loop(plant, n, rng, noise=0.0, colour=None):
    u = rng.standard_normal(n)
    y = plant.filter(u)
    e = rng.standard_normal(n)
    return Signals(u, y + noise * np.std(y) * (e if colour is None else colour.filter(e)), T)


def in_loop(plant, controller, n, rng, noise, colour=None, hold=10):
    """r in steps, a little f, sensor noise: u and y under feedback."""
    r = np.repeat(rng.standard_normal(n // hold), hold)
    f = 0.3 * rng.standard_normal(n)
    e = noise * rng.standard_normal(n)
    v = e if colour is None else colour.filter(e)
    y, u = closed_loop(plant, controller).system.filter(np.column_stack([r, f, 0 * r, v])).T
    return Signals(u, y, T, r=r, f=f)


def nearest(estimates, truth):
    return min(estimates, key=lambda e: abs(e.value - truth))


def relative_error(model, truth):
    f = np.geomspace(0.005, 0.49, 60) / T
    return np.abs(model.response(f) - truth.response(f)) / np.abs(truth.response(f))


CASES = {
    "open loop, white noise": lambda rng: (open_loop(PLANT, 300, rng, 0.3), {}),
    "open loop, coloured noise": lambda rng: (
        open_loop(PLANT, 300, rng, 0.15, Zpk([0.0], [0.9], 0.5, T)),
        {},
    ),
    "known controller, coloured noise": lambda rng: (
        in_loop(PLANT, CONTROLLER, 300, rng, 0.1, Zpk([0.3], [0.8], 1.0, T)),
        {"controller": CONTROLLER},
    ),
    "unknown controller": lambda rng: (
        in_loop(
            PLANT, CONTROLLER, 500, rng, 0.1, Zpk([0.85 + 0.3j, 0.85 - 0.3j], PLANT.poles, 1.0, T)
        ),
        {"method": "prediction_error"},
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_intervals_of_95_percent_hold_over_50_seeds(case):
    errors = []
    for seed in range(50):
        signals, options = CASES[case](np.random.default_rng(seed))
        model = fit_linear(signals, 2, **options)
        pole = nearest(model.poles, PLANT.poles[0])
        zero = nearest(model.zeros, PLANT.zeros[0])
        errors.append(
            [
                (pole.value.real - PLANT.poles[0].real) / pole.std_real,
                (pole.value.imag - PLANT.poles[0].imag) / pole.std_imag,
                (zero.value.real - PLANT.zeros[0].real) / zero.std_real,
            ]
        )
    errors = np.array(errors)
    covered = np.mean(np.abs(errors) < 1.959964, axis=0)
    # Binomial, 50 draws at 0.95: fewer than 42 covered has probability 3e-4 each.
    assert covered.min() >= 0.84, covered
    # Neither too wide: the normalised errors scatter with standard deviation one (chi-square 49).
    assert np.all((np.std(errors, axis=0) > 0.7) & (np.std(errors, axis=0) < 1.4))
    # No bias: mean of 50 within four standard errors.
    assert np.abs(errors.mean(axis=0)).max() < 4.0 / np.sqrt(50)


def test_simulating_u_to_y_under_feedback_is_biased_where_the_loop_methods_are_not():
    """The closed-loop cases above would not pass by accident: open-loop fitting does not."""
    rng = np.random.default_rng(0)
    colour = Zpk([0.0], [0.95], 1.0, T)
    signals = in_loop(PLANT, CONTROLLER, 8000, rng, 0.1, colour)
    f = np.geomspace(0.5, 40.0, 30)

    def excess(model):
        """Error of the response in its own standard errors, median over frequency."""
        return np.median(np.abs(model.response(f) - PLANT.response(f)) / model.response_std(f))

    known = fit_linear(signals, 2, controller=CONTROLLER)
    assert excess(known) < 2.0
    assert excess(fit_linear(signals, 4, method="prediction_error")) < 2.0
    assert excess(fit_linear(signals, 2, method="output_error")) > 5.0
    assert known.method == "closed_loop"


def test_feedback_in_the_data_is_noticed():
    signals = in_loop(PLANT, CONTROLLER, 600, np.random.default_rng(1), 0.05)
    assert fit_linear(signals, 2).method == "prediction_error"
    assert fit_linear(open_loop(PLANT, 600, np.random.default_rng(1)), 2).method == "output_error"


def test_without_noise_the_system_is_found_exactly():
    model = fit_linear(open_loop(FOURTH, 600, np.random.default_rng(2)), 4)
    assert relative_error(model, FOURTH).max() < 1e-10
    for pole in FOURTH.poles:
        assert abs(nearest(model.poles, pole).value - pole) < 1e-10
    assert model.system.gain == pytest.approx(FOURTH.gain, rel=1e-9)


def test_order_is_found_by_held_out_error():
    orders = [
        best_linear(
            open_loop(FOURTH, 800, np.random.default_rng(seed), 0.1), range(1, 7)
        ).structure.order
        for seed in range(3)
    ]
    assert orders == [4] * 3


def test_ladder_holds_every_order_and_its_estimation_error_falls():
    model = best_linear(open_loop(FOURTH, 800, np.random.default_rng(3), 0.1), (1, 2, 4, 6))
    assert [r.structure.order for r in model.ladder] == [1, 2, 4, 6]
    estimation = [r.estimation for r in model.ladder]
    assert all(np.diff(estimation) <= 1e-6)
    assert model.nrmse == pytest.approx(estimation[2], rel=1e-3)


@pytest.mark.parametrize("delay", [0, 1, 5])
def test_delay_is_found(delay):
    plant = Zpk([0.5], [0.9 + 0.3j, 0.9 - 0.3j], 0.01, T, delay)
    signals = open_loop(plant, 800, np.random.default_rng(4), 0.1)
    assert estimate_delay(signals) == delay
    model = best_linear(signals, (1, 2, 3))
    assert (model.structure.order, model.structure.delay) == (2, delay)
    assert model.system.delay == delay
    assert np.median(relative_error(model, plant)) < 0.03


def test_feedthrough():
    plant = Zpk([0.2, 0.4], [0.85 + 0.35j, 0.85 - 0.35j], 0.5, T)
    signals = open_loop(plant, 800, np.random.default_rng(5), 0.01)
    model = fit_linear(signals, 2, feedthrough=True)
    assert len(model.zeros) == 2
    assert np.median(relative_error(model, plant)) < 0.01


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_order_and_feedthrough_are_chosen_together(noise):
    """Without feedthrough no order explains this plant, and the smallest is as good as any."""
    plant = Zpk([1.25, 0.4], [0.7, 0.5], 0.8, T)
    rng = np.random.default_rng(5)
    u = rng.standard_normal(2000)
    y = plant.state_space().filter(u)
    signals = Signals(u, y + noise * rng.standard_normal(u.size), T)
    model = best_linear(signals, (1, 2, 3), feedthrough=None)
    assert (model.structure.order, model.structure.feedthrough) == (2, True)
    assert relative_error(model, plant).max() < max(2 * noise, 1e-10)
    assert model.remarks == ()
    shown = {(r.structure.order, r.structure.feedthrough) for r in model.ladder}
    assert shown >= {(order, direct) for order in (1, 2, 3) for direct in (False, True)}


def test_a_residual_that_still_answers_to_the_input_is_said():
    signals = open_loop(FOURTH, 800, np.random.default_rng(2), 0.02)
    (said,) = fit_linear(signals, 2).remarks
    assert "far from white" in said
    assert "answers to the input" in said
    assert fit_linear(signals, 4).remarks == ()


def test_coloured_noise_is_said_to_be_no_more_than_that():
    rng = np.random.default_rng(3)
    signals = open_loop(PLANT, 1500, rng)
    coloured = np.convolve(rng.standard_normal(1510), np.ones(10), "full")[9:1509]
    y = signals.y + 0.02 * np.std(signals.y) * coloured
    (said,) = fit_linear(Signals(signals.u, y, T), 2).remarks
    assert "the noise is coloured" in said


def test_several_recordings_not_at_rest_with_an_offset():
    rng = np.random.default_rng(6)
    whole = open_loop(PLANT, 1500, rng, 0.02)
    pieces = [whole.cut(100, 400), whole.cut(500, 900), whole.cut(1000, 1500)]
    pieces = [Signals(p.u, p.y + 3.0, T) for p in pieces]
    model = fit_linear(pieces, 2)
    assert model.offset == pytest.approx(3.0, abs=0.01)
    assert np.median(relative_error(model, PLANT)) < 0.01
    assert model.load == pytest.approx(3.0 / PLANT.at(1.0)[0].real, rel=0.02)


def test_a_decay_alone_shows_the_poles():
    """No input but a short pulse; nearly everything comes from the estimated initial state."""
    rng = np.random.default_rng(7)
    u = np.zeros(200)
    u[:4] = rng.standard_normal(4)
    y = PLANT.state_space().filter(u, [1.0, -2.0])
    model = fit_linear(Signals(u, y + 1e-5 * rng.standard_normal(200), T), 2, offset="none")
    assert abs(nearest(model.poles, PLANT.poles[0]).value - PLANT.poles[0]) < 1e-4


def test_a_plant_that_integrates_with_and_without_its_controller():
    stage = Zpk([-1.0], [1.0, 0.99], 1e-3, T)
    servo = Controller.of_error(Zpk([0.95], [0.5], 10.0, T))
    assert closed_loop(stage, servo).is_stable
    signals = in_loop(stage, servo, 3000, np.random.default_rng(8), 1e-3, hold=50)
    known = fit_linear(signals, 2, controller=servo, integrators=1)
    assert known.poles[0].value == 1.0
    assert known.poles[0].std_real == 0.0
    assert abs(known.poles[1].value - 0.99) < 4 * known.poles[1].std_real
    assert np.median(relative_error(known, stage)) < 0.01
    unknown = fit_linear(signals, 2, method="prediction_error", integrators=1)
    assert np.median(relative_error(unknown, stage)) < 0.03
    assert unknown.overlay(signals).nrmse < 0.05


def test_the_constant_load_on_a_plant_that_integrates():
    stage = Zpk([-1.0], [1.0, 0.99], 1e-3, T)
    servo = Controller.of_error(Zpk([0.95], [0.5], 10.0, T))
    rng = np.random.default_rng(9)
    r = np.repeat(rng.standard_normal(60), 50)
    inputs = np.column_stack([r, 0 * r, np.full(3000, -0.4), 1e-3 * rng.standard_normal(3000)])
    y, u = closed_loop(stage, servo).system.filter(inputs).T
    model = fit_linear(Signals(u, y, T, r=r), 2, controller=servo, integrators=1)
    assert model.load == pytest.approx(-0.4, abs=0.01)


def test_a_known_load_is_part_of_the_input():
    rng = np.random.default_rng(10)
    u, d = rng.standard_normal((2, 600))
    y = PLANT.filter(u + d) + 0.01 * rng.standard_normal(600)
    with_load = fit_linear(Signals(u, y, T, d=d), 2)
    without = fit_linear(Signals(u, y, T), 2)
    assert with_load.nrmse < 0.05 < 0.5 < without.nrmse


def test_weighting_by_the_noise_model_sharpens_the_estimate():
    """Strongly coloured noise: the weighted fit's own standard errors are smaller, and honest."""
    ratios, errors = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        signals = open_loop(PLANT, 600, rng, 0.5, Zpk([0.0], [0.98], 0.2, T))
        white = nearest(fit_linear(signals, 2).poles, PLANT.poles[0])
        weighted = nearest(fit_linear(signals, 2, noise="autoregressive").poles, PLANT.poles[0])
        ratios.append(weighted.std_real / white.std_real)
        errors.append((weighted.value.real - PLANT.poles[0].real) / weighted.std_real)
    assert np.median(ratios) < 0.7
    assert np.sqrt(np.mean(np.square(errors))) < 2.0


def test_residual_tests_accept_the_true_order_and_reject_a_lower_one():
    signals = open_loop(FOURTH, 2000, np.random.default_rng(11), 0.05)
    right, low = fit_linear(signals, 4), fit_linear(signals, 3)
    assert min(right.whiteness.p_value, right.independence.p_value) > 0.01
    assert low.independence.p_value < 1e-6
    assert right.whiteness.n_effective > 1800


def test_independence_test_keeps_its_level_under_coloured_noise():
    """The naive chi-square of cross-correlations would reject far too often here."""
    colour = Zpk([0.0], [0.95], 0.3, T)
    p = [
        fit_linear(
            open_loop(PLANT, 300, np.random.default_rng(s), 0.3, colour), 2
        ).independence.p_value
        for s in range(40)
    ]
    assert np.sum(np.array(p) < 0.05) <= 7  # binomial(40, 0.05): more than 7 has probability 1e-3


def test_the_band_of_the_frequency_response_holds_the_truth():
    f = np.array([1.0, 5.0, 10.0, 30.0])
    inside = []
    for seed in range(40):
        model = fit_linear(open_loop(PLANT, 400, np.random.default_rng(seed), 0.3), 2)
        inside.append(
            np.abs(model.response(f) - PLANT.response(f)) < 2.447747 * model.response_std(f)
        )
    assert np.mean(inside) > 0.88


def test_scaling_of_input_and_output_changes_only_the_gain():
    signals = open_loop(PLANT, 500, np.random.default_rng(12), 0.1)
    model = fit_linear(signals, 2)
    scaled = fit_linear(Signals(1e4 * signals.u, 1e-6 * signals.y, T), 2)
    for a, b in zip(model.poles, scaled.poles, strict=True):
        assert a.value == pytest.approx(b.value, rel=1e-6)
        assert a.std_real == pytest.approx(b.std_real, rel=1e-4)
    assert scaled.system.gain == pytest.approx(1e-10 * model.system.gain, rel=1e-6)
    assert scaled.noise_std == pytest.approx(1e-6 * model.noise_std, rel=1e-6)


def test_plant_file_round_trip(tmp_path):
    signals = in_loop(PLANT, CONTROLLER, 600, np.random.default_rng(13), 0.05)
    model = fit_linear(signals, 2, controller=CONTROLLER)
    path = tmp_path / "stage.toml"
    save_plant(model.plant("stage", "A", "m"), path)
    plant = load_plant(path)
    np.testing.assert_array_equal(plant.system.poles, model.system.poles)
    assert plant.loop.is_stable
    assert "closed_loop" in plant.source
    f = np.array([0.5, 5.0, 30.0])
    np.testing.assert_allclose(plant.system.response(f), model.response(f), rtol=1e-12)


def test_overlay_runs_free_from_an_estimated_start():
    whole = open_loop(PLANT, 900, np.random.default_rng(14), 0.05)
    model = fit_linear(whole.cut(0, 600), 2)
    fresh = whole.cut(600, 900)
    from_all, from_few = model.overlay(fresh), model.overlay(fresh, 20)
    assert from_all.nrmse == pytest.approx(0.05, rel=0.3)
    assert from_few.nrmse < 0.1
    assert from_all.output.shape == fresh.y.shape


def test_state_space_and_zpk_forms_agree():
    model = fit_linear(open_loop(FOURTH, 800, np.random.default_rng(15), 0.1), 4)
    f = np.geomspace(0.1, 49.0, 40)
    assert isinstance(model.system, Zpk)
    assert isinstance(model.state_space, StateSpace)
    np.testing.assert_allclose(model.system.response(f), model.state_space.response(f), rtol=1e-8)


def test_same_data_same_result():
    signals = open_loop(PLANT, 400, np.random.default_rng(16), 0.2)
    first, second = fit_linear(signals, 2), fit_linear(signals, 2)
    np.testing.assert_array_equal(first.state_space.a, second.state_space.a)


@pytest.mark.slow(5)
def test_a_hundred_thousand_samples_in_seconds():
    import time

    signals = open_loop(FOURTH, 100_000, np.random.default_rng(17), 0.05)
    start = time.process_time()
    model = fit_linear(signals, 4)
    assert time.process_time() - start < 15.0
    assert abs(nearest(model.poles, FOURTH.poles[0]).value - FOURTH.poles[0]) < 2e-4


@pytest.mark.parametrize("method", ["output_error", "prediction_error"])
def test_an_operating_point_far_from_zero_costs_no_digits(method):
    signals = open_loop(PLANT, 400, np.random.default_rng(18), 0.05)
    near = fit_linear(signals, 2, method=method)
    far = fit_linear(Signals(signals.u + 1e6, signals.y - 1e7, T), 2, method=method)
    assert nearest(far.poles, PLANT.poles[0]).value == pytest.approx(
        nearest(near.poles, PLANT.poles[0]).value, abs=1e-6
    )
    static = far.state_space.at(1.0)[0].real
    assert far.offset == pytest.approx(-1e7 - 1e6 * static, rel=1e-6)
    overlay = far.overlay(Signals(signals.u + 1e6, signals.y - 1e7, T))
    assert overlay.nrmse == pytest.approx(near.overlay(signals).nrmse, rel=1e-3)


def test_a_missing_feedthrough_is_seen_in_the_residual():
    signals = open_loop(PLANT, 400, np.random.default_rng(19), 0.01)
    direct = Signals(signals.u, signals.y + 0.5 * signals.u, T)
    assert fit_linear(direct, 2).independence.p_value < 1e-6
    assert fit_linear(direct, 2, feedthrough=True).independence.p_value > 1e-3


def test_the_constant_load_stands_for_the_offset_whatever_the_zeros():
    """Zeros that belong to no mode: a force moves the output otherwise than the command does."""
    system = Zpk(
        [3.7, 0.80 + 0.77j, 0.80 - 0.77j], [0.88 + 0.15j, 0.88 - 0.15j, 0.75, 0.7], -0.01, T
    )
    rng = np.random.default_rng(11)
    u = rng.standard_normal(1500)
    y = system.filter(u) - 0.4 + 1e-3 * rng.standard_normal(1500)
    plant = fit_linear(Signals(u, y, T), 4).plant("p", with_load=True)
    run = Simulator(plant).run(plant.effects, np.zeros(1500), u)
    assert np.abs(run.y - y)[200:].max() < 0.01


def test_a_load_is_stated_only_where_it_is_more_than_noise():
    """Over 40 recordings of one plant the offset spreads as its standard error says; without an offset
    none is stated, with one the force lies within its error."""
    told, loads = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        u = rng.standard_normal(300)
        y = PLANT.filter(u) + 0.1 * rng.standard_normal(300)
        model = fit_linear(Signals(u, y, T), 2)
        told.append(model.offset / model.offset_std)
        assert bool(model.plant("p", with_load=True).effects) == (abs(told[-1]) > 3.0)
        y = y + 0.5 * PLANT.at(1.0)[0].real
        found = fit_linear(Signals(u, y, T), 2).constant_load()
        loads.append((found[0] - 0.5) / found[1])
    assert 0.75 < np.std(told) < 1.3
    assert np.sum(np.abs(told) > 3.0) <= 1
    assert 0.75 < np.std(loads) < 1.3


def test_a_loop_that_integrates_hides_an_offset_and_none_is_stated():
    controller = Controller.of_error(Zpk([0.8], [1.0], 0.3, T))
    plant = Zpk([1.15], [0.8, 0.9 + 0.2j, 0.9 - 0.2j], -0.004, T)
    loop = closed_loop(plant, controller).system
    for seed in range(6):
        rng = np.random.default_rng(seed)
        inputs = np.zeros((1500, 4))
        inputs[:, 1] = rng.standard_normal(1500)
        inputs[:, 3] = 2e-3 * rng.standard_normal(1500)
        y, u = loop.filter(inputs).T
        f, r = inputs[:, 1], np.zeros(1500)
        model = fit_linear(Signals(u, y, T, r=r, f=f), 3, controller=controller)
        assert model.method == "closed_loop"
        assert model.offset_std > 10 * np.std(y)
        assert not model.plant("p", with_load=True).effects


def test_samples_at_the_limit_of_a_sensor_are_not_fitted():
    rng = np.random.default_rng(12)
    u = np.repeat(rng.standard_normal(80), 20)
    whole = PLANT.filter(u) + 1e-3 * rng.standard_normal(1600)
    top = np.quantile(whole, 0.75)
    clipped = Recording.from_signals(T, u=u, y=np.minimum(whole, top))
    assert np.mean(clipped.y == top) > 0.2
    model = best_linear([clipped], orders=(1, 2, 3))
    assert model.structure.order == 2
    assert np.max(relative_error(model, PLANT)) < 0.02

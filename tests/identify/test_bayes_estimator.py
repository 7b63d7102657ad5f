"""The estimators' contract, every refusal, the table."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.signal import lfilter

from ffl.errors import InputError
from ffl.identify.bayes import (
    Algorithm1Inverse,
    DirectBayesianInverse,
    naive,
    oracle,
    paper_data,
    table_one,
    two_step,
)
from ffl.identify.bayes.protocol import inverse_fit
from ffl.identify.bayes.records import reduce_record
from ffl.identify.bayes.table import METHODS
from ffl.report import bayes_figures

WHITE = np.random.default_rng(0).standard_normal(200)
NOISE = np.random.default_rng(1).standard_normal(200)


@pytest.fixture(scope="module")
def data():
    return paper_data(3)


@pytest.fixture(scope="module")
def fitted(data):
    return DirectBayesianInverse().fit(data.u[:60], data.y, rng=np.random.default_rng(1))


@pytest.fixture(scope="module")
def table():
    return table_one(range(2), fast=True)


def test_fit_learns_and_the_same_rng_learns_the_same(data, fitted):
    again = DirectBayesianInverse().fit(data.u[:60], data.y, rng=np.random.default_rng(1))
    np.testing.assert_array_equal(fitted.theta_, again.theta_)
    assert inverse_fit(fitted.theta_, 4, data.u, data.x, 60) > 88
    assert fitted.taps_.tolist() == [-4, -3, -2, -1, 0, 1]
    assert fitted.standard_errors().shape == (6,)
    assert fitted.noise_variance_ == pytest.approx(data.noise_variance, rel=0.5)


def test_a_recording_is_as_good_as_two_arrays(data, fitted):
    recording = SimpleNamespace(u=data.u[:60], y=data.y)
    found = DirectBayesianInverse().fit(recording, rng=np.random.default_rng(1))
    np.testing.assert_array_equal(found.theta_, fitted.theta_)


@pytest.mark.parametrize("factor", [1e-3, 1e4])
def test_the_answer_scales_with_the_units(data, fitted, factor):
    found = DirectBayesianInverse().fit(data.u[:60], factor * data.y, rng=np.random.default_rng(1))
    np.testing.assert_allclose(found.theta_ * factor, fitted.theta_, rtol=1e-3, atol=1e-4)


def test_constructor_arguments_are_parameters():
    estimator = DirectBayesianInverse(n_ac=3, n_draws=500)
    clone = DirectBayesianInverse(**estimator.get_params())
    assert clone.get_params() == estimator.get_params()
    assert Algorithm1Inverse(as_printed=True).get_params()["as_printed"] is True


def test_feedforward_is_the_non_causal_convolution(fitted):
    pulse = np.zeros(30)
    pulse[10] = 1.0
    command = fitted.feedforward(pulse)
    np.testing.assert_allclose(command[6:12], fitted.theta_)
    assert not command[:6].any()
    assert not command[12:].any()


def test_algorithm_1_as_an_estimator(data):
    found = Algorithm1Inverse(n_draws=3000, burn_in=800, max_iterations=3)
    found.fit(data.u[:60], data.y, rng=np.random.default_rng(0))
    assert inverse_fit(found.theta_, 4, data.u, data.x, 60) > 85
    assert found.noise_variance_ == found.hyperparameters_.noise_variance


@pytest.mark.parametrize("wrong", [{"max_iterations": 0}, {"n_draws": 900, "burn_in": 900}])
def test_algorithm_1_needs_an_iteration_and_draws(data, wrong):
    with pytest.raises(InputError, match="at least one iteration"):
        Algorithm1Inverse(**wrong).fit(data.u[:60], data.y)


def test_before_fit_nothing_is_learned():
    with pytest.raises(InputError, match="call fit first"):
        _ = DirectBayesianInverse().taps_


REFUSALS = {
    "shorter than the model": (WHITE[:12], NOISE[:12], {}, "12 samples cannot carry a model of 6"),
    "constant input": (np.ones(60), NOISE[:60], {}, "u is constant"),
    "constant output": (NOISE[:60], np.zeros(60), {}, "y is constant"),
    "unequal lengths": (WHITE, NOISE[:-1], {}, "u has 200 samples and y has 199"),
    "nan": (np.where(np.arange(200) == 7, np.nan, WHITE), NOISE, {}, r"u\[7\] is nan"),
    "two columns": (np.ones((60, 2)), NOISE[:60], {}, "must be vectors"),
    "no causal tap": (WHITE, NOISE, {"n_c": 0}, "n_c 1 or more"),
    "no draws": (WHITE, lfilter([1.0], [1.0, -0.5], WHITE) + NOISE, {"n_draws": 0}, "0 draws"),
    "no output": (WHITE, None, {}, "two arrays"),
    "nothing in common": (WHITE, NOISE, {}, "no more than chance"),
    "few samples for so many taps": (
        WHITE,
        lfilter([1.0], [1.0, -0.5], WHITE) + 0.1 * NOISE,
        {"n_ac": 40, "n_c": 40},
        "200 samples are too few .* fewer taps, or record 480",
    ),
    "output before input": (
        WHITE[:-2],
        WHITE[2:] + 0.1 * NOISE[2:],
        {"n_ac": 1, "n_c": 4},
        "chance|wrong side",
    ),
    "no noise": (WHITE, lfilter([1.0], [1.0, -0.5], WHITE), {"n_ac": 0}, "no noise"),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_bad_input_is_one_clear_line(name):
    u, y, parameters, message = REFUSALS[name]
    with pytest.raises(InputError, match=message) as caught:
        DirectBayesianInverse(**parameters).fit(u, y, rng=np.random.default_rng(0))
    assert "\n" not in str(caught.value)


def test_roots_all_on_the_wrong_side_are_refused(monkeypatch):
    from ffl.identify.bayes import maximum_likelihood as module

    guess = np.array([0.01, 0.02, 0.05, 0.1, 0.3, 1.0])  # every root outside
    monkeypatch.setattr(module, "starts", lambda record, n_ac, n_c: {"only": guess})
    with pytest.raises(InputError, match="wrong side of the unit circle"):
        module.maximum_likelihood(reduce_record(WHITE, NOISE, 50), 4, 2)


def test_too_short_for_an_unknown_start_or_for_the_forward_model(data):
    with pytest.raises(InputError, match="unknown start"):
        reduce_record(WHITE, NOISE, 150, at_rest=False)
    with pytest.raises(InputError, match="cannot carry a model of 25"):
        two_step(data.u[:40], data.y[:40], 4, 2)
    with pytest.raises(InputError, match="simulate on past the end"):
        inverse_fit(np.ones(6), 4, data.u, data.x[:60], 60)


def test_compared_methods_rank_as_in_table_1():
    fits = {"naive": [], "two_step": [], "oracle": []}
    for seed in range(15):
        d = paper_data(seed)
        u = d.u[:60]
        thetas = {
            "naive": naive(u, d.y, 4, 2).theta,
            "two_step": two_step(u, d.y, 4, 2).theta,
            "oracle": oracle(u, d.x, 4, 2, np.random.default_rng([seed, 1])).theta,
        }
        for name, theta in thetas.items():
            fits[name].append(inverse_fit(theta, 4, d.u, d.x, 60))
    assert 55 < np.median(fits["naive"]) < 68
    assert 68 < np.median(fits["two_step"]) < 86
    assert 93 < np.mean(fits["oracle"]) < 96


def test_posterior_mean_is_between_two_step_and_oracle_on_ten_data_sets():
    fits = []
    for seed in range(10):
        d = paper_data(seed)
        found = DirectBayesianInverse().fit(d.u[:60], d.y, rng=np.random.default_rng(seed))
        assert found.result_.importance_ess > 100
        fits.append(inverse_fit(found.theta_, 4, d.u, d.x, 60))
    assert np.mean(fits) > 89
    assert min(fits) > 75


def test_dropping_the_edge_rows_helps_the_naive_method():
    pairs = []
    for seed in range(15):
        d = paper_data(seed)
        pairs.append(
            [
                inverse_fit(naive(d.u[:60], d.y, 4, 2, drop_edge=edge).theta, 4, d.u, d.x, 60)
                for edge in (False, True)
            ]
        )
    assert np.mean(pairs, axis=0)[1] > np.mean(pairs, axis=0)[0] + 1


def test_table_has_every_row_in_the_form_of_the_command_line(table):
    rows = {row.key: row.as_dict() for row in table.rows}
    wanted = {*METHODS, *(f"{m}_all" for m in METHODS), "seconds_per_model_best"}
    assert wanted <= set(rows)
    assert rows["naive"]["paper"] == 60.93
    assert "paper" not in rows["best"]
    for row in rows.values():
        assert row["n"] == 2
        assert np.isfinite([row["ours"], row.get("std_error", 0.0)]).all()
    assert all("std_error" in rows[key] for key in wanted)
    assert table.seeds == (0, 1)
    assert all(len(f) == 2 for f in table.fits.values())


def test_one_data_set_is_a_table_without_standard_errors():
    rows = [row.as_dict() for row in table_one([5], fast=True).rows]
    assert all("std_error" not in row for row in rows if row["key"] in METHODS)


@pytest.mark.slow(5)
def test_workers_and_order_change_nothing(table):
    other = table_one([1, 0], fast=True, jobs=2)
    for method, fits in table.fits.items():
        np.testing.assert_array_equal(fits, other.fits[method][::-1])


def test_figures_draw_what_the_table_holds(table, fitted):
    axes = Figure().subplots(1, 2)
    bayes_figures.figure_3(table, axes)
    np.testing.assert_array_equal(axes[0].lines[0].get_ydata(), table.forward_impulse)
    np.testing.assert_array_equal(axes[1].lines[0].get_ydata(), table.inverse_impulse)
    axes = Figure().subplots(1, 2)
    bayes_figures.figure_4(table, axes)
    assert len(axes[1].get_xticklabels()) == len(METHODS)
    assert "%" in axes[0].get_ylabel()
    ax = fitted.plot(Figure().subplots())
    assert "tau" in ax.get_xlabel()

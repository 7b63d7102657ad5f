"""Evidence and posterior in factored form against the dense formulas (7) and Remark 7."""

import time
import tracemalloc

import numpy as np
import pytest

from ffl.errors import InputError
from ffl.identify.evidence import maximise_evidence, reduced, regularised
from ffl.identify.kernel2018 import draw, kernels
from ffl.identify.kernels import OBF, TC, Direct, Fixed
from ffl.identify.regression import Edges, backward_regression

LAGS = np.arange(-12, 13)


def toy(seed=0, noise=0.3, n=250):
    rng = np.random.default_rng(seed)
    y = np.convolve(rng.standard_normal(n + 24), [1.0, 0.6, 0.3], mode="same")
    theta = 2.0 * 0.7 ** np.abs(LAGS)
    r = np.convolve(y, theta, mode="valid") + noise * rng.standard_normal(n)
    return backward_regression(y, r, 12, 12, Edges("known", "known"), lead=12), theta


@pytest.mark.parametrize("kernel", [TC(2.0, 0.8, 0.7), OBF.of_poles([0.8, 0.5], [1.3], direct=2)])
def test_estimate_posterior_and_evidence_equal_the_dense_formulas(kernel):
    rows, _ = toy()
    phi, r, d, s2 = rows.matrix(), rows.target, kernel.matrix(LAGS), 0.1
    covariance = phi @ d @ phi.T + s2 * np.eye(len(r))
    for data in (rows, rows.triangle):
        solution = regularised(data, kernel.factor(LAGS), s2)
        printed = np.linalg.solve(d @ phi.T @ phi + s2 * np.eye(25), d @ phi.T @ r)  # (7)
        np.testing.assert_allclose(solution.theta, printed, atol=1e-9)
        posterior = d - d @ phi.T @ np.linalg.solve(covariance, phi @ d)
        found = maximise_evidence(data, LAGS, Fixed(kernel), s2, learn_noise=False).inverse(rows)
        np.testing.assert_allclose(found.covariance, posterior, atol=1e-10)
        log_det = np.linalg.slogdet(covariance)[1]
        misfit = r @ np.linalg.solve(covariance, r)
        expected = 0.5 * (len(r) * np.log(2 * np.pi) + log_det + misfit)
        assert solution.negative_log_evidence == pytest.approx(expected, rel=1e-10)
        smoother = phi @ np.linalg.solve(d @ phi.T @ phi + s2 * np.eye(25), d @ phi.T)
        assert solution.effective_parameters == pytest.approx(np.trace(smoother), rel=1e-8)


def test_flat_taps_are_the_limit_of_a_large_scale():
    rows, _ = toy()
    flat = regularised(rows, (TC(2.0, 0.8, 0.7) + Direct(-2, 0)).factor(LAGS), 0.1)
    large = regularised(rows, (TC(2.0, 0.8, 0.7) + Direct(-2, 0, 1e9)).factor(LAGS), 0.1)
    np.testing.assert_allclose(flat.theta, large.theta, atol=1e-6)
    # and the restricted evidence differs from the proper one by the three priors' constant
    constant = 1.5 * np.log(2 * np.pi * 1e9)
    difference = large.negative_log_evidence - flat.negative_log_evidence
    assert difference == pytest.approx(constant, abs=1e-5)


def test_factored_estimate_equals_7_and_is_20_times_faster():
    regression = draw(np.random.SeedSequence(1)).regression
    kernel = kernels()["noncausal_kernel"]
    phi, r = regression.matrix(), regression.target

    def printed():
        d = kernel.matrix(regression.lags)
        return np.linalg.solve(d @ phi.T @ phi + np.eye(601), d @ phi.T @ r)

    def ours():
        return regularised(regression, kernel.factor(regression.lags), 1.0).theta

    def seconds(function, repeats):
        times = []
        for _ in range(repeats):
            start = time.perf_counter()
            function()
            times.append(time.perf_counter() - start)
        return min(times)

    np.testing.assert_allclose(ours(), printed(), atol=1e-7 * np.abs(ours()).max())
    assert seconds(printed, 3) > 20 * seconds(ours, 10)


def test_evidence_finds_scale_decay_and_noise():
    rows, theta = toy(noise=0.3, n=3000)
    found = maximise_evidence(reduced(rows, TC()), LAGS, TC(100.0, 0.95, 0.95), 10.0)
    assert found.status == "converged"
    assert found.solution.noise_variance == pytest.approx(0.09, rel=0.1)
    assert found.log_evidence > -regularised(rows, TC().factor(LAGS), 0.09).negative_log_evidence
    np.testing.assert_allclose(found.solution.theta, theta, atol=0.05)


def test_evidence_finds_poles_and_the_band_counts_their_uncertainty():
    rows, _ = toy(noise=0.3)
    start = OBF.of_poles([0.5], [2.0], direct=1, scale=1.0)
    found = maximise_evidence(rows, LAGS, start, 1.0)
    np.testing.assert_allclose(found.kernel.poles, [0.7], atol=0.02)
    np.testing.assert_allclose(found.kernel.outside, [1 / 0.7], atol=0.04)
    with_poles = found.inverse(rows).standard_deviation
    fixed = maximise_evidence(rows, LAGS, Fixed(found.kernel), 0.09, learn_noise=False)
    assert np.all(with_poles >= 0.99 * fixed.inverse(rows).standard_deviation)
    assert with_poles.sum() > 1.2 * fixed.inverse(rows).standard_deviation.sum()


def test_credible_band_covers_what_it_says():
    """200 data sets from the prior itself: the 90 % band holds 90 % of the taps."""
    kernel, inside = TC(1.0, 0.8, 0.8), []
    prior = kernel.factor(LAGS).columns
    for seed in range(200):
        rows, _ = toy(seed)
        rng = np.random.default_rng(seed + 1000)
        theta = prior @ rng.standard_normal(prior.shape[1])
        target = rows.matrix() @ theta + 0.5 * rng.standard_normal(rows.n_rows)
        known = backward_regression(rows.output, target, 12, 12, Edges("known", "known"), lead=12)
        found = maximise_evidence(known, LAGS, Fixed(kernel), 0.25, learn_noise=False)
        band = found.inverse(known).impulse_band(0.9)
        inside.append(np.mean((theta > band.lower) & (theta < band.upper)))
    assert np.mean(inside) == pytest.approx(0.9, abs=0.015)


def test_hyperprior_holds_poles_that_the_data_do_not_see():
    rows, _ = toy(noise=0.3)
    free = OBF.of_poles([0.7, 0.2], [1 / 0.7], direct=1)
    held = OBF.of_poles([0.7, 0.2], [1 / 0.7], direct=1, pole_spread=1e-3)
    moved = maximise_evidence(rows, LAGS, held, 0.1)
    np.testing.assert_allclose(moved.kernel.coordinates[1:], free.coordinates[1:], atol=0.01)
    loose = maximise_evidence(rows, LAGS, free, 0.1)
    assert loose.log_evidence > moved.log_evidence


@pytest.mark.parametrize("variance", [0.0, -1.0, np.nan])
def test_noise_variance_must_be_positive(variance):
    rows, _ = toy()
    with pytest.raises(InputError, match="must be positive"):
        regularised(rows, TC().factor(LAGS), variance)


def test_noise_free_data_are_refused_where_the_noise_is_to_be_learned():
    rows, _ = toy(noise=0.0)
    kernel = OBF.of_poles([0.7], [1 / 0.7], direct=1, learn_poles=False)
    exact = backward_regression(
        rows.output,
        rows.matrix() @ kernel.factor(LAGS).columns.sum(axis=1),
        12,
        12,
        Edges("known", "known"),
        lead=12,
    )
    with pytest.raises(InputError, match="holds no noise"):
        maximise_evidence(exact, LAGS, kernel, 1.0)


def test_flat_taps_need_excitation():
    t = np.arange(300)
    rows = backward_regression(np.sin(0.3 * t), np.cos(0.3 * t), 12, 12)
    with pytest.raises(InputError, match="does not excite every unregularised tap"):
        regularised(rows, Direct(-5, 5).factor(LAGS), 0.1)


def test_long_records_need_no_large_matrix():
    """N = 50,000 and 601 taps: the regressor alone would take 240 MB, its square 20 GB."""
    rng = np.random.default_rng(0)
    n, poles = 50_000, [0.95 + 0.1j, 0.95 - 0.1j]
    y = rng.standard_normal(n + 600)
    kernel = OBF.of_poles(poles, [1.1], direct=2, scale=10.0)
    theta = kernel.basis(np.arange(-300, 301))[0] @ [5.0, -3.0, 1.0, 2.0, 1.0]
    target = np.convolve(y, theta, mode="valid") + rng.standard_normal(n)
    tracemalloc.start()
    rows = backward_regression(y, target, 300, 300, Edges("known", "known"), lead=300)
    found = maximise_evidence(rows, rows.lags, kernel, 1.0).inverse(rows)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 60e6
    np.testing.assert_allclose(found.theta, theta, atol=0.05)

"""Stable spline kernel and regularised least squares against their definitions."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from ffl.identify.bayes import stable_spline as module
from ffl.identify.bayes.algorithm_1 import update_kernel
from ffl.identify.bayes.prior import grid_prior
from ffl.identify.bayes.regularized import inverse_kernel, regularized_least_squares
from ffl.identify.bayes.stable_spline import stable_spline

TAPS = np.arange(-4, 2)


def by_the_book(t, s, causal, noncausal):
    """(9) and (10), scalar."""

    def b(x):
        return causal**x if x >= 0 else noncausal ** (-x)

    low, high = min(b(t), b(s)), max(b(t), b(s))
    return low**2 / 6 * (3 * high - low)


@pytest.mark.parametrize("peak", [-2, 0, 1])
def test_kernel_is_equation_9_with_a_moved_peak(peak):
    expected = [[by_the_book(t - peak, s - peak, 0.7, 0.4) for s in TAPS] for t in TAPS]
    expected = np.array(expected) + module.JITTER * np.trace(expected) / 6 * np.eye(6)
    np.testing.assert_allclose(stable_spline(TAPS, 0.7, 0.4, peak), expected, rtol=1e-12)


def test_equal_decays_are_singular_without_the_jitter_and_factor_with_it(monkeypatch):
    np.linalg.cholesky(stable_spline(TAPS, 0.5, 0.5))
    monkeypatch.setattr(module, "JITTER", 0.0)
    assert np.linalg.cond(stable_spline(TAPS, 0.5, 0.5)) > 1e15


def test_regularised_estimate_is_the_dense_posterior_and_its_evidence_a_normal_density():
    rng = np.random.default_rng(3)
    phi, y = rng.standard_normal((40, 6)), rng.standard_normal(40)
    kernel = inverse_kernel(4, 2)
    for refine in (False, True):
        fit = regularized_least_squares(phi, y, kernel, 2, refine)
        prior = fit.scale * kernel(fit.decays)
        total = phi @ prior @ phi.T + fit.noise_variance * np.eye(40)
        np.testing.assert_allclose(fit.theta, prior @ phi.T @ np.linalg.solve(total, y), atol=1e-9)
        np.testing.assert_allclose(
            fit.covariance,
            prior - prior @ phi.T @ np.linalg.solve(total, phi @ prior),
            atol=1e-8 * np.abs(prior).max(),
        )
        dense = multivariate_normal(np.zeros(40), total).logpdf(y)
        assert fit.log_evidence == pytest.approx(dense, abs=1e-6)


def test_refining_raises_the_evidence():
    rng = np.random.default_rng(4)
    phi = rng.standard_normal((60, 6))
    y = phi @ np.array([0.01, 0.1, 0.9, -1.4, 0.5, 0.0]) + 0.3 * rng.standard_normal(60)
    kernel = inverse_kernel(4, 2)
    coarse = regularized_least_squares(phi, y, kernel, 2)
    fine = regularized_least_squares(phi, y, kernel, 2, refine=True)
    assert fine.log_evidence > coarse.log_evidence


def test_m_step_recovers_the_kernel_it_is_given_and_as_printed_halves_its_scale():
    moment = 7.0 * stable_spline(TAPS, 0.6, 0.3)
    scale, decays = update_kernel(moment, TAPS, np.array([0.4, 0.5]), as_printed=False)
    assert scale == pytest.approx(7.0, rel=1e-3)
    np.testing.assert_allclose(decays, [0.6, 0.3], atol=1e-3)
    printed, _ = update_kernel(moment, TAPS, np.array([0.6, 0.3]), as_printed=True)
    assert printed == pytest.approx(3.5, rel=1e-3)


def test_integrated_prior_is_the_integral_over_scale_and_nodes():
    prior = grid_prior(2, 2, (0, -1), n_decays=2)
    thetas = np.array([[0.3, 1.0, -0.7, 0.1], [0.1, -0.4, 2.0, 0.9]])
    log_scale = np.linspace(-14, 22, 4001)
    values = []
    for theta in thetas:
        total = 0.0
        for node in prior.nodes:
            kernel = stable_spline(
                np.arange(-2, 2), node.causal_decay, node.noncausal_decay, node.peak
            )
            quadratic = theta @ np.linalg.solve(kernel, theta)
            density = np.exp(-0.5 * quadratic * np.exp(-log_scale) - 2 * log_scale)
            total += np.sum(density) / np.sqrt(np.linalg.det(kernel))
        values.append(np.log(total))
    found = prior.log_density(thetas)
    assert found[0] - found[1] == pytest.approx(values[0] - values[1], abs=1e-9)


def test_units_do_not_matter_to_the_prior():
    prior = grid_prior(4, 2, (-1, 0), n_decays=4)
    thetas = np.random.default_rng(5).standard_normal((5, 6))
    difference = prior.log_density(1000 * thetas) - prior.log_density(thetas)
    np.testing.assert_allclose(difference, -6 * np.log(1000), rtol=1e-12)
    share, quadratic = prior.responsibilities(thetas[0])
    assert share.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(
        quadratic, np.einsum("i,hij,j->h", thetas[0], prior.precision, thetas[0]), rtol=1e-7
    )

"""Diagnostics with known answers; importance sampling, chains and Laplace as three roads to one."""

import numpy as np
import pytest

from ffl.identify.bayes import posterior as posterior_module
from ffl.identify.bayes.algorithm_1 import algorithm_1, map_estimate
from ffl.identify.bayes.circle import inside_count
from ffl.identify.bayes.diagnostics import effective_sample_size, split_rhat
from ffl.identify.bayes.importance import importance_sample, mixture_log_density
from ffl.identify.bayes.lack_of_fit import lack_of_fit, remark
from ffl.identify.bayes.laplace import laplace_per_node, posterior_mode
from ffl.identify.bayes.maximum_likelihood import gauss_newton, maximum_likelihood, starts
from ffl.identify.bayes.metropolis import metropolis
from ffl.identify.bayes.posterior import direct_posterior
from ffl.identify.bayes.prior import grid_prior, peaks_around
from ffl.identify.bayes.protocol import inverse_fit, paper_data
from ffl.identify.bayes.records import reduce_record
from ffl.identify.bayes.stable_spline import stable_spline


@pytest.fixture(scope="module")
def record():
    data = paper_data(3)
    return reduce_record(data.u[:60], data.y, 60)


def test_effective_sample_size_of_white_and_of_autoregressive_chains():
    rng = np.random.default_rng(0)
    white = rng.standard_normal((4, 5000, 1))
    assert effective_sample_size(white)[0] == pytest.approx(20_000, rel=0.1)
    slow = np.zeros((4, 20_000, 1))
    for t in range(1, 20_000):
        slow[:, t] = 0.9 * slow[:, t - 1] + rng.standard_normal((4, 1))
    assert effective_sample_size(slow)[0] == pytest.approx(80_000 * 0.1 / 1.9, rel=0.15)


def test_effective_sample_size_collapses_where_chains_disagree_or_stand_still():
    rng = np.random.default_rng(1)
    apart = rng.standard_normal((2, 1000, 1)) + np.array([0.0, 20.0])[:, None, None]
    assert effective_sample_size(apart)[0] < 10
    assert effective_sample_size(np.ones((2, 100, 1)))[0] == 0.0


def test_split_rhat_sees_different_means_and_drift():
    rng = np.random.default_rng(2)
    good = rng.standard_normal((4, 2000, 2))
    assert np.all(split_rhat(good) < 1.01)
    assert split_rhat(good + np.array([0, 0, 0, 3.0])[:, None, None]).min() > 1.3
    assert split_rhat(good[:1] + np.linspace(0, 4, 2000)[:, None]).min() > 1.3


def test_the_proposal_density_is_a_normalised_mixture_of_t():
    from scipy.stats import multivariate_t

    rng = np.random.default_rng(3)
    means = rng.standard_normal((2, 3))
    factors = np.linalg.cholesky(np.stack([np.diag([1.0, 2.0, 0.5]), np.eye(3) + 0.5]))
    points = rng.standard_normal((4, 3))
    found = mixture_log_density(
        points, means, np.linalg.inv(factors), np.log(np.array([0.3, 0.7])), 5.0
    )
    expected = np.log(
        0.3 * multivariate_t(means[0], factors[0] @ factors[0].T, df=5).pdf(points)
        + 0.7 * multivariate_t(means[1], factors[1] @ factors[1].T, df=5).pdf(points)
    )
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_maximum_likelihood_is_stationary_and_no_worse_than_any_start(record):
    found = maximum_likelihood(record, 4, 2)
    assert found.inside == 3 == inside_count(found.theta, 4)
    for guess in starts(record, 4, 2).values():
        assert found.misfit <= gauss_newton(record, guess, 4)[1] * (1 + 1e-9)
    again = gauss_newton(record, found.theta, 4)
    assert again[1] == pytest.approx(found.misfit, rel=1e-6)


def test_importance_sampling_and_chains_agree(record):
    weighted = direct_posterior(record, 4, 2, np.random.default_rng(4), n_draws=6000)
    chains = direct_posterior(record, 4, 2, np.random.default_rng(5), least_ess=np.inf)
    assert weighted.status == "importance"
    assert chains.status == "chains"
    assert chains.chains.rhat.max() < 1.05
    assert np.all((chains.chains.acceptance > 0.2) & (chains.chains.acceptance < 0.4))
    width = np.sqrt(np.diag(weighted.covariance))
    assert np.abs((weighted.theta - chains.theta) / width).max() < 0.25
    np.testing.assert_allclose(np.sqrt(np.diag(chains.covariance)), width, rtol=0.25)
    assert weighted.noise_variance == pytest.approx(chains.noise_variance, rel=0.05)
    assert sum(weighted.kernel.peak.values()) == pytest.approx(1.0)


def test_importance_sampling_is_reproducible_and_its_evidence_near_laplace(record):
    start = maximum_likelihood(record, 4, 2)
    prior = grid_prior(4, 2, peaks_around(start.theta, 4), 6)
    mode = posterior_mode(record, prior, start.theta, 4)
    laplace = laplace_per_node(record, prior, mode, 4)
    one, same, other = (
        importance_sample(record, prior, laplace, 4, 3, np.random.default_rng(s)) for s in (1, 1, 2)
    )
    np.testing.assert_array_equal(one.weights, same.weights)
    assert one.weights.sum() == pytest.approx(1.0)
    assert 100 < one.effective_sample_size <= 3000
    assert abs(one.log_evidence - other.log_evidence) < 0.3
    assert one.log_evidence == pytest.approx(np.logaddexp.reduce(laplace.log_evidence), abs=1.0)


def test_no_draw_with_another_number_of_roots_inside_carries_weight(record):
    start = maximum_likelihood(record, 4, 2)
    prior = grid_prior(4, 2, peaks_around(start.theta, 4), 4)
    laplace = laplace_per_node(record, prior, start.theta, 4)
    wide = type(laplace)(laplace.means, 60 * laplace.covariances, laplace.log_evidence)
    drawn = importance_sample(record, prior, wide, 4, 3, np.random.default_rng(6))
    labels = np.array([inside_count(theta, 4) for theta in drawn.thetas])
    assert np.any(labels != 3)  # otherwise the test says nothing
    assert np.all(drawn.weights[labels != 3] == 0.0)
    assert np.any(drawn.weights[labels == 3] > 0.0)


def test_chains_on_a_fixed_kernel_match_the_narrow_laplace_approximation():
    data = paper_data(7, n_samples=2000)
    record = reduce_record(data.u[:2000], data.y, 60)
    start = maximum_likelihood(record, 4, 2)
    kernel = 50.0 * stable_spline(np.arange(-4, 2), 0.1, 0.4)
    theta, covariance, _ = map_estimate(record, start.theta, 4, kernel, 0.14)
    white = np.linalg.inv(np.linalg.cholesky(kernel))[None]
    chains = metropolis(
        record, white, np.zeros(1), 0.14, theta, covariance, 4, np.random.default_rng(8),
        n_draws=20_000, burn_in=4000, n_chains=2,
    )  # fmt: skip
    width = np.sqrt(np.diag(covariance))
    assert np.abs((chains.mean - theta) / width).max() < 0.3
    spread = np.sqrt(np.diag(chains.second_moment - np.outer(chains.mean, chains.mean)))
    np.testing.assert_allclose(spread, width, rtol=0.2)
    assert np.all((chains.acceptance > 0.25) & (chains.acceptance < 0.35))


def test_em_raises_the_evidence_and_reports_its_diagnostics(record):
    fit = algorithm_1(
        record, 4, 2, np.random.default_rng(9), n_draws=6000, burn_in=1500, max_iterations=8
    )
    assert fit.evidence[-1] > fit.evidence[0]
    assert np.all(np.diff(fit.evidence) > -0.5)  # sampling error only
    assert len(fit.hyperparameters) == len(fit.evidence)
    assert fit.rhat.shape == fit.effective_sample_size.shape == (6,)
    assert inside_count(fit.theta, 4) == 3


def test_as_printed_ends_with_a_smaller_scale_and_a_worse_evidence(record):
    corrected, printed = (
        algorithm_1(
            record, 4, 2, np.random.default_rng(10), as_printed=p, n_draws=6000, burn_in=1500,
            max_iterations=8,
        )
        for p in (False, True)
    )  # fmt: skip
    assert printed.hyperparameters[-1].scale < corrected.hyperparameters[-1].scale
    assert printed.evidence[-1] < corrected.evidence[-1]


def test_with_much_data_every_way_finds_the_truth_within_its_standard_error():
    data = paper_data(11, n_samples=20_000)
    record = reduce_record(data.u[:20_000], data.y, 100)
    found = direct_posterior(record, 4, 2, np.random.default_rng(0))
    assert inverse_fit(found.theta, 4, data.u, data.x, 20_000) > 97.5
    assert found.noise_variance == pytest.approx(data.noise_variance, rel=0.05)


def test_many_taps_take_the_mode_and_stay_far_from_the_wild_maximum_likelihood():
    data = paper_data(12, n_samples=600, n_ac=10)
    record = reduce_record(data.u[:600], data.y, 100)
    found = direct_posterior(record, 10, 8, np.random.default_rng(0), n_decays=6)
    likelihood = maximum_likelihood(record, 10, 8).theta
    assert found.status == "mode"
    fits = [inverse_fit(t, 10, data.u, data.x, 600) for t in (found.theta, likelihood)]
    assert fits[0] > 90
    assert fits[0] > fits[1]


def test_chains_that_disagree_are_called_unconverged(monkeypatch, record):
    monkeypatch.setattr(posterior_module.Chains, "rhat", property(lambda self: np.array([1.5])))
    found = direct_posterior(record, 4, 2, np.random.default_rng(5), least_ess=np.inf, n_draws=500)
    assert found.status == "unconverged"
    assert "chains disagree" in found.remarks[0]
    assert "take more taps" in found.remarks[0]


def test_too_few_taps_are_said_and_enough_taps_are_not():
    data = paper_data(13, n_samples=2000, snr_db=20.0)
    record = reduce_record(data.u[:2000], data.y, 60)
    enough = direct_posterior(record, 4, 2, np.random.default_rng(0))
    assert enough.remarks == ()
    assert enough.noise_ratio == pytest.approx(1.0, abs=0.08)
    few = direct_posterior(record, 2, 1, np.random.default_rng(0))
    assert "take more taps" in few.remarks[0]
    assert few.noise_ratio > 1.1


def test_a_small_lack_of_fit_is_said_where_it_is_beyond_doubt():
    assert remark(1.05, 1e-4, 100) is None
    assert "standard errors do not count" in remark(1.05, 1e-8, 100)
    assert "standard errors" not in remark(1.5, 1e-4, 100)
    assert remark(1.5, 0.01, 100) is None


def test_lack_of_fit_has_its_level_and_is_silent_on_short_records():
    rng = np.random.default_rng(14)
    u = rng.standard_normal(400)
    rejected = 0
    for _ in range(300):
        record = reduce_record(u, rng.standard_normal(400), 20)
        nested = np.linalg.lstsq(record.factor[:, :5], record.target, rcond=None)[0]
        _, p = lack_of_fit(record, record.misfit(np.pad(nested, (0, 15))), 5)
        rejected += p < 0.05
    assert 5 < rejected < 28  # 15 expected
    short = reduce_record(u[:60], u[:60] + rng.standard_normal(60), 60)
    assert np.isnan(lack_of_fit(short, 1.0, 30)).all()

"""Posterior mean by importance sampling from a mixture of Student t proposals, one per node."""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from ffl.identify.bayes.laplace import Laplace
from ffl.identify.bayes.prior import Prior
from ffl.identify.bayes.records import Record
from ffl.identify.bayes.roots import all_roots, misfit_of_many


@dataclass(frozen=True)
class WeightedDraws:
    """Draws of theta with normalised weights, each with its misfit."""

    thetas: np.ndarray
    weights: np.ndarray
    misfits: np.ndarray
    log_evidence: float

    @property
    def effective_sample_size(self) -> float:
        """1 / sum w^2."""
        return float(1 / np.sum(self.weights**2))

    @property
    def mean(self) -> np.ndarray:
        return self.weights @ self.thetas

    @property
    def covariance(self) -> np.ndarray:
        deviation = self.thetas - self.mean
        return deviation.T @ (deviation * self.weights[:, None])


def log_posterior(
    misfits: np.ndarray, thetas: np.ndarray, n_samples: int, prior: Prior
) -> np.ndarray:
    """-N/2 log misfit + log p(theta), -inf where the model is not finite."""
    with np.errstate(invalid="ignore", divide="ignore"):
        value = -0.5 * n_samples * np.log(misfits) + prior.log_density(thetas)
    return np.where(np.isfinite(value), value, -np.inf)


def importance_sample(
    record: Record,
    prior: Prior,
    laplace: Laplace,
    n_ac: int,
    inside: int,
    rng: np.random.Generator,
    n_draws: int = 3000,
    freedom: float = 5.0,
    at_most: int = 30,
) -> WeightedDraws:
    """Draws from sum_h w_h t_5(mean_h, covariance_h), weighted to the exact posterior.

    The proposal has the `at_most` nodes with the largest Laplace evidence. Draws with another
    number of roots inside have weight zero. Draws are spread over the nodes systematically.
    """
    kept, weight = laplace.heaviest(0.999, at_most)
    n = laplace.means.shape[1]
    roots = np.linalg.cholesky(laplace.covariances[kept])
    ticks = (rng.random() + np.arange(n_draws)) / n_draws
    label = np.minimum(np.searchsorted(np.cumsum(weight), ticks), len(kept) - 1)
    normal = rng.standard_normal((n_draws, n))
    stretch = np.sqrt(freedom / rng.chisquare(freedom, n_draws))
    thetas = laplace.means[kept][label] + stretch[:, None] * np.einsum(
        "mij,mj->mi", roots[label], normal
    )
    proposal = mixture_log_density(
        thetas, laplace.means[kept], np.linalg.inv(roots), np.log(weight), freedom
    )
    centre = laplace.means[kept[0]]
    misfits, counts = misfit_of_many(
        thetas,
        all_roots(centre),
        n - n_ac,
        record.factor,
        record.target,
        record.floor,
        record.before,
    )
    log = log_posterior(misfits, thetas, record.n_samples, prior) - proposal
    log[counts != inside] = -np.inf
    top = log.max()
    weights = np.exp(log - top)
    total = weights.sum()
    return WeightedDraws(thetas, weights / total, misfits, float(top + np.log(total / n_draws)))


@njit(cache=True)
def mixture_log_density(thetas, means, whiteners, log_weight, freedom):
    """log sum_h w_h t(theta; mean_h, (W_h'W_h)^-1, freedom)."""
    m, n = thetas.shape
    out, log = np.empty(m), np.empty(len(means))
    base = np.empty(len(means))
    for h in range(len(means)):
        base[h] = log_weight[h]
        for i in range(n):
            base[h] += np.log(whiteners[h, i, i])
        base[h] += math.lgamma(0.5 * (freedom + n)) - math.lgamma(0.5 * freedom)
        base[h] -= 0.5 * n * math.log(freedom * math.pi)
    for k in range(m):
        for h in range(len(means)):
            quadratic = 0.0
            for i in range(n):
                e = 0.0
                for j in range(i + 1):
                    e += whiteners[h, i, j] * (thetas[k, j] - means[h, j])
                quadratic += e * e
            log[h] = base[h] - 0.5 * (freedom + n) * np.log1p(quadratic / freedom)
        top = log.max()
        out[k] = top + np.log(np.sum(np.exp(log - top)))
    return out

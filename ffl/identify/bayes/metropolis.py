"""Random-walk Metropolis-Hastings on the inverse taps: section III.C, (18) to (20)."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from ffl.identify.bayes.diagnostics import effective_sample_size, split_rhat
from ffl.identify.bayes.records import Record
from ffl.identify.bayes.roots import (
    all_roots,
    forward_response,
    misfit,
    refine_roots,
    response_from_roots,
)

_KEPT = 4000  # draws stored of each chain, evenly thinned; means run over every draw


@dataclass(frozen=True)
class Chains:
    """Several chains after burn-in: moments over all draws, and thinned draws for diagnostics."""

    draws: np.ndarray  # (n_chains, n_kept, n)
    mean: np.ndarray
    second_moment: np.ndarray  # E theta theta'
    mean_misfit: float  # E ||y - U xi(theta)||^2
    acceptance: np.ndarray  # one rate a chain
    log_scale: float  # tuned logarithm of the proposal's scale

    @property
    def rhat(self) -> np.ndarray:
        return split_rhat(self.draws)

    @property
    def effective_sample_size(self) -> np.ndarray:
        """Of the thinned draws: a lower bound for the whole chain."""
        return effective_sample_size(self.draws)


def metropolis(
    record: Record,
    white: np.ndarray,
    log_weight: np.ndarray,
    noise_variance: float,
    start: np.ndarray,
    covariance: np.ndarray,
    n_ac: int,
    rng: np.random.Generator,
    n_draws: int = 100_000,
    burn_in: int = 10_000,
    n_chains: int = 1,
    log_scale: float | None = None,
) -> Chains:
    """Chains from `start` with steps N(0, s covariance), s tuned in the burn-in to accept 25 to 35 %.

    Target, with `noise_variance` > 0 and one precision factor W in `white`, shape (1, n, n): (19),
    exp(-misfit / (2 sigma^2) - ||W theta||^2 / 2). With `noise_variance` = 0: noise and scale integrated
    out, misfit^-N/2 sum_h exp(log_weight_h) ||W_h theta||^-n, the posterior of `prior.Prior`.
    A move that changes the number of roots inside is rejected. Chains start at 1 standard
    deviation from `start` where there are several, each with its own child generator.
    """
    n = len(start)
    root = np.linalg.cholesky(covariance)
    first_scale = 2 * np.log(2.38) - np.log(n) if log_scale is None else log_scale
    thin = max(1, (n_draws - burn_in) // _KEPT)
    results = []
    for child in rng.spawn(n_chains):
        theta = np.array(start, float)
        if n_chains > 1:
            theta = _dispersed(theta, root, n_ac, child)
        results.append(
            _walk(
                theta,
                all_roots(theta),
                n - n_ac,
                record.factor,
                record.target,
                record.floor,
                record.n_samples,
                record.before,
                white,
                log_weight,
                noise_variance,
                root,
                first_scale,
                n_draws,
                burn_in,
                thin,
                child,
            )
        )
    return Chains(
        np.stack([r[0] for r in results]),
        np.mean([r[1] for r in results], axis=0),
        np.mean([r[2] for r in results], axis=0),
        float(np.mean([r[3] for r in results])),
        np.array([r[4] for r in results]),
        float(np.mean([r[5] for r in results])),
    )


def _dispersed(theta, root, n_ac, rng):
    """A start near `theta` with the same number of roots inside."""

    def count(t):
        return forward_response(t, n_ac, 1)[1]

    wanted = count(theta)
    for shrink in 0.7 ** np.arange(20):
        moved = theta + shrink * (root @ rng.standard_normal(len(theta)))
        if count(moved) == wanted:
            return moved
    return theta


@njit(cache=True)
def _log_target(theta, value, samples, white, log_weight, noise_variance):
    n = len(theta)
    top, total = -np.inf, 0.0
    for h in range(len(white)):
        quadratic = 0.0
        for i in range(n):
            e = 0.0
            for j in range(i + 1):
                e += white[h, i, j] * theta[j]
            quadratic += e * e
        if noise_variance > 0:
            return -0.5 * value / noise_variance - 0.5 * quadratic
        log = log_weight[h] - 0.5 * n * np.log(quadratic)
        if log > top:
            total = total * np.exp(top - log) + 1.0
            top = log
        elif log > top - 40.0:
            total += np.exp(log - top)
    return -0.5 * samples * np.log(value) + top + np.log(total)


@njit(cache=True)
def _walk(
    theta,
    z,
    n_c,
    factor,
    target,
    floor,
    samples,
    before,
    white,
    log_weight,
    noise_variance,
    root,
    log_scale,
    n_draws,
    burn_in,
    thin,
    rng,
):
    n = len(theta)
    xi = np.empty(len(target))
    z = refine_roots(theta, z.copy())
    inside = response_from_roots(theta, z, n_c, xi, before)
    value = misfit(factor, target, floor, xi)
    log = _log_target(theta, value, samples, white, log_weight, noise_variance)
    kept = np.empty(((n_draws - burn_in) // thin, n))
    mean, second, mean_value = np.zeros(n), np.zeros((n, n)), 0.0
    accepted = 0
    trial, step = np.empty(n), np.empty(n)
    for k in range(n_draws):
        scale = np.exp(0.5 * log_scale)
        for i in range(n):
            step[i] = rng.standard_normal()
        for i in range(n):
            e = 0.0
            for j in range(i + 1):
                e += root[i, j] * step[j]
            trial[i] = theta[i] + scale * e
        z_trial = refine_roots(trial, z.copy())
        probability = 0.0
        trial_value, trial_log = 0.0, 0.0
        if response_from_roots(trial, z_trial, n_c, xi, before) == inside:
            trial_value = misfit(factor, target, floor, xi)
            trial_log = _log_target(trial, trial_value, samples, white, log_weight, noise_variance)
            if trial_log == trial_log:
                probability = np.exp(min(0.0, trial_log - log))
        if rng.random() < probability:
            theta, z, value, log = trial.copy(), z_trial, trial_value, trial_log
            if k >= burn_in:
                accepted += 1
        if k < burn_in:
            log_scale += (probability - 0.3) * 2.0 / (1.0 + k) ** 0.6
            continue
        count = k - burn_in
        mean_value += value
        for i in range(n):
            mean[i] += theta[i]
            for j in range(n):
                second[i, j] += theta[i] * theta[j]
        if count % thin == 0 and count // thin < len(kept):
            kept[count // thin] = theta
    m = n_draws - burn_in
    return kept, mean / m, second / m, mean_value / m, accepted / m, log_scale

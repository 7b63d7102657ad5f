"""Algorithm 1 of the 2025 paper: EM over the hyperparameters, Metropolis-Hastings for the E-step.

Corrected: (16) has 1/2 before log det K, as (15) demands. `as_printed` leaves it out, which
halves the scale alpha in every M-step (alpha = tr(K^-1 E theta theta') / (2 n)) and shrinks the estimate.
Other misprints change nothing in the result: Phi_u, not its transpose, in (6), and the constant
of (15) is -(N + n_theta)/2 log 2 pi.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from ffl.errors import InputError
from ffl.identify.bayes.circle import inside_count
from ffl.identify.bayes.maximum_likelihood import MaximumLikelihood, maximum_likelihood
from ffl.identify.bayes.metropolis import metropolis
from ffl.identify.bayes.records import Record
from ffl.identify.bayes.stable_spline import stable_spline
from ffl.identify.regression import upper_triangle


@dataclass(frozen=True)
class Hyperparameters:
    """rho of the paper: noise variance and the kernel's scale and decays."""

    noise_variance: float
    scale: float
    causal_decay: float
    noncausal_decay: float


@dataclass(frozen=True)
class Algorithm1Fit:
    """theta by (8) at the last hyperparameters, and the course of the iteration.

    `evidence` is the Laplace log evidence of each iterate: EM must not lower it but for sampling
    error. `rhat` and `effective_sample_size` belong to the last E-step.
    """

    theta: np.ndarray
    covariance: np.ndarray
    hyperparameters: tuple[Hyperparameters, ...]
    evidence: np.ndarray
    acceptance: np.ndarray
    rhat: np.ndarray
    effective_sample_size: np.ndarray
    status: str


def map_estimate(
    record: Record,
    theta: np.ndarray,
    n_ac: int,
    kernel: np.ndarray,
    noise_variance: float,
    max_steps: int = 40,
) -> tuple[np.ndarray, np.ndarray, float]:
    """(8) from `theta`, its root label kept: theta, Laplace covariance, Laplace log evidence."""
    inside, n = inside_count(theta, n_ac), len(theta)
    white = np.linalg.inv(np.linalg.cholesky(kernel))
    noise = np.sqrt(noise_variance)

    def residual(t, xi):
        return np.concatenate([(record.target - record.factor @ xi) / noise, -white @ t])

    xi, slope = record.jacobian(theta, n_ac)
    error, damping = residual(theta, xi), 0.0
    for _ in range(max_steps):
        stacked = np.vstack([record.factor @ slope / noise, white])
        size = np.sqrt(np.sum(stacked**2, axis=0))
        while damping < 1e8:
            rows = np.vstack([stacked, np.sqrt(damping) * np.diag(size)])
            step = np.linalg.lstsq(rows, np.concatenate([error, np.zeros(n)]), rcond=None)[0]
            trial = theta + step
            trial_error = residual(trial, record.response(trial, n_ac))
            gain = error @ error - trial_error @ trial_error
            if gain > 0 and inside_count(trial, n_ac) == inside:
                break
            damping = max(10 * damping, 1e-4)
        else:
            break
        theta, error = trial, trial_error
        damping = damping / 10 if damping > 1e-5 else 0.0
        xi, slope = record.jacobian(theta, n_ac)
        if gain < 1e-8:
            break
    triangle = upper_triangle(np.vstack([record.factor @ slope / noise, white]))
    half = np.linalg.inv(triangle)
    log_evidence = (
        -0.5 * (error @ error + record.floor / noise_variance)
        - 0.5 * record.n_samples * np.log(2 * np.pi * noise_variance)
        + np.log(np.abs(np.diag(white))).sum()
        - np.log(np.abs(np.diag(triangle))).sum()
    )
    return theta, half @ half.T, float(log_evidence)


def update_kernel(
    second_moment: np.ndarray, taps: np.ndarray, decays: np.ndarray, as_printed: bool
) -> tuple[float, np.ndarray]:
    """(16): argmin tr(K^-1 E theta theta') / 2 + c log det K, c = 1/2 (printed: 1); scale, decays.

    alpha is minimised in closed form, the logits of the two decays by L-BFGS.
    """
    n, factor = len(taps), 2.0 if as_printed else 1.0

    def parts(p):
        kernel = stable_spline(taps, *(1 / (1 + np.exp(-p))))
        root = np.linalg.cholesky(kernel)
        half = np.linalg.solve(root, second_moment)
        trace = np.trace(np.linalg.solve(root, half.T))
        return trace / (n * factor), 2 * np.log(np.diag(root)).sum()

    def cost(p):
        scale, log_det = parts(p)
        return n * np.log(scale) + log_det

    start = np.log(decays / (1 - decays))
    found = minimize(cost, start, method="L-BFGS-B", bounds=[(-5.0, 5.0)] * 2).x
    found = found if cost(found) <= cost(start) else start
    return parts(found)[0], 1 / (1 + np.exp(-found))


def algorithm_1(
    record: Record,
    n_ac: int,
    n_c: int,
    rng: np.random.Generator,
    as_printed: bool = False,
    n_draws: int = 100_000,
    burn_in: int = 10_000,
    max_iterations: int = 20,
    tolerance: float = 0.02,
    n_chains: int = 1,
    likelihood: MaximumLikelihood | None = None,
) -> Algorithm1Fit:
    """EM with Metropolis-Hastings from the maximum-likelihood point.

    The first hyperparameters are those of a grid of decays with the largest expected log prior at
    that point ((13) there), the first noise variance is misfit / (N - n). Stops (status
    "converged") when no hyperparameter moves by more than `tolerance` in its logarithm, or
    ("iterations") at `max_iterations`. Neither (8) nor a move of the chain may change the number
    of roots inside. Raises `InputError` where there is no iteration or no draw after the burn-in.
    """
    if max_iterations < 1 or n_draws < burn_in + 100:
        raise InputError(
            f"{max_iterations} iterations of {n_draws} draws with {burn_in} for burn-in: take at "
            "least one iteration, and 100 draws more than the burn-in"
        )
    taps, n = np.arange(-n_ac, n_c), n_ac + n_c
    start = likelihood or maximum_likelihood(record, n_ac, n_c)
    theta = start.theta
    variance = start.misfit / max(record.n_samples - n, 1)
    _, slope = record.jacobian(theta, n_ac)
    half = np.linalg.inv(upper_triangle(record.factor @ slope / np.sqrt(variance)))
    moment = np.outer(theta, theta) + half @ half.T
    grid = [np.array([c, a]) for c in (0.1, 0.3, 0.5, 0.7, 0.9) for a in (0.15, 0.35, 0.6, 0.8)]
    # the grid, then one descent from its best node, both on (16) with the moment at the start
    scale, decays = update_kernel(
        moment, taps, min(grid, key=lambda d: _gap(moment, taps, d)), False
    )
    course, evidence, acceptance = [], [], []
    log_scale, status = None, "iterations"
    covariance, chains = half @ half.T, None
    for _ in range(max_iterations):
        kernel = scale * stable_spline(taps, *decays)
        peak, covariance, log_evidence = map_estimate(record, theta, n_ac, kernel, variance)
        course.append(Hyperparameters(variance, scale, *map(float, decays)))
        evidence.append(log_evidence)
        white = np.linalg.inv(np.linalg.cholesky(kernel))[None]
        chains = metropolis(
            record,
            np.ascontiguousarray(white),
            np.zeros(1),
            variance,
            peak,
            covariance,
            n_ac,
            rng,
            n_draws,
            burn_in,
            n_chains,
            log_scale,
        )
        acceptance.append(chains.acceptance)
        log_scale, theta = chains.log_scale, peak
        old = np.log([variance, scale, *decays])
        scale, decays = update_kernel(chains.second_moment, taps, decays, as_printed)
        variance = chains.mean_misfit / record.n_samples
        if np.abs(np.log([variance, scale, *decays]) - old).max() < tolerance:
            status = "converged"
            break
    kernel = scale * stable_spline(taps, *decays)
    theta, covariance, log_evidence = map_estimate(record, theta, n_ac, kernel, variance)
    course.append(Hyperparameters(variance, scale, *map(float, decays)))
    evidence.append(log_evidence)
    assert chains is not None  # there is at least one iteration
    return Algorithm1Fit(
        theta,
        covariance,
        tuple(course),
        np.array(evidence),
        np.array(acceptance),
        chains.rhat,
        chains.effective_sample_size,
        status,
    )


def _gap(moment, taps, decays):
    """n log alpha + log det K0 at the best alpha: the cost of (16) up to constants."""
    kernel = stable_spline(taps, *decays)
    trace = np.trace(np.linalg.solve(kernel, moment))
    return len(taps) * np.log(trace) + np.linalg.slogdet(kernel)[1]

"""Kernel-regularised least squares with its hyperparameters by marginal likelihood: (22), (23)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from ffl.errors import InputError
from ffl.identify.bayes.stable_spline import stable_spline
from ffl.identify.regression import upper_triangle

Kernel = Callable[[np.ndarray], np.ndarray]  # decays in (0, 1) -> covariance at unit scale

DECAY_CANDIDATES = (0.3, 0.5, 0.7, 0.8, 0.9, 0.95)


@dataclass(frozen=True)
class RegularizedFit:
    """theta, its posterior covariance, and what the evidence chose."""

    theta: np.ndarray
    covariance: np.ndarray
    noise_variance: float
    scale: float
    decays: np.ndarray
    log_evidence: float


def regularized_least_squares(
    regressors: np.ndarray,
    observed: np.ndarray,
    kernel: Kernel,
    n_decays: int,
    refine: bool = False,
) -> RegularizedFit:
    """theta = argmin ||observed - regressors theta||^2 + gamma theta' K^-1 theta, gamma by evidence.

    observed ~ N(0, s^2 (I + rho Phi K Phi')), written in the triangular coordinates of Phi: the cost
    is O(N n^2) once and O(n^3) per trial of hyperparameters. s^2 is profiled out in closed form,
    rho and the decays are the best of the candidates, every decay of `DECAY_CANDIDATES` with every
    scale, as the paper chooses them (section III.B). With `refine` L-BFGS goes on from there, which on
    the paper's example is worth 1 point of fit to `naive` and 3 to `two_step`.
    """
    n_rows, n = regressors.shape
    if n_rows <= n:
        raise InputError(f"{n_rows} rows cannot carry {n} taps: record more or take fewer taps")
    triangle = upper_triangle(np.column_stack([regressors, observed]))
    factor, target, floor = triangle[:n, :n], triangle[:n, n], float(triangle[n, n] ** 2)
    size = np.sum(factor**2) / n
    if size <= 0:
        raise InputError("the regressors are all zero: the input excites nothing")

    def covariance(p):
        spread = factor @ kernel(1 / (1 + np.exp(-p[1:]))) * (np.exp(p[0]) / size)
        return spread, np.linalg.cholesky(np.eye(n) + spread @ factor.T)

    def cost(p):
        _, root = covariance(p)
        white = np.linalg.solve(root, target)
        return 0.5 * n_rows * np.log(white @ white + floor) + np.log(np.diag(root)).sum()

    logits = np.log(np.array(DECAY_CANDIDATES) / (1 - np.array(DECAY_CANDIDATES)))
    grid = np.meshgrid(np.linspace(-3, 18, 15), *[logits] * n_decays)
    found = min(np.stack([g.ravel() for g in grid], axis=1), key=cost)
    if refine:
        bounds = [(-10.0, 25.0)] + [(-6.0, 6.0)] * n_decays
        found = minimize(cost, found, method="L-BFGS-B", bounds=bounds).x
    spread, root = covariance(found)
    white = np.linalg.solve(root, target)
    variance = float((white @ white + floor) / n_rows)
    gain = np.linalg.solve(root, spread)
    prior = kernel(1 / (1 + np.exp(-found[1:]))) * (np.exp(found[0]) / size)
    constant = 0.5 * n_rows * (np.log(2 * np.pi / n_rows) + 1)
    return RegularizedFit(
        gain.T @ white,
        variance * (prior - gain.T @ gain),
        variance,
        float(variance * np.exp(found[0]) / size),
        1 / (1 + np.exp(-found[1:])),
        float(-cost(found) - constant),
    )


def inverse_kernel(n_ac: int, n_c: int, peak: int = 0) -> Kernel:
    """Non-causal stable spline on the taps -n_ac..n_c-1, decays (causal, non-causal)."""
    taps = np.arange(-n_ac, n_c)
    return lambda decays: stable_spline(taps, decays[0], decays[1], peak)


def forward_kernel(n_f: int) -> Kernel:
    """Causal stable spline on tau = 1..n_f (the paper's reference [30]), one decay."""
    taps = np.arange(1, n_f + 1)
    return lambda decays: stable_spline(taps, decays[0], 0.5)

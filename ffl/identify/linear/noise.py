"""What is left: autoregressive noise models, covariance of the estimate, residual tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.signal
import scipy.stats

from ffl.identify.linear.coordinates import Point, Tangent, tangent
from ffl.identify.linear.problem import Problem, without
from ffl.identify.regression import upper_triangle
from ffl.systems.state_space import Array


@dataclass(frozen=True)
class ResidualTest:
    """A chi-square test of the residual: small `p_value` = structure is left.

    `n_effective`: number of independent samples the residual is worth for this correlation;
    `correlation` at lags 0 .. and `bound`, its 99 % limit with that sample size.
    """

    statistic: float
    dof: int
    p_value: float
    n_effective: float
    correlation: Array
    bound: float


def burg(pieces: Sequence[Array], max_order: int = 30) -> tuple[Array, float]:
    """(1, a_1, ..., a_p) and innovation variance, pooled over pieces; order by Akaike's criterion.

    Burg's recursion keeps every order stable (S. M. Kay, Modern Spectral Estimation, 1988, 7.5).
    """
    forward = [p - p.mean() for p in pieces if p.size > 2]
    n = sum(p.size for p in forward)
    variance = sum(float(p @ p) for p in forward) / max(n, 1)
    max_order = int(min(max_order, n // 20, min(p.size for p in forward) // 3))
    backward = [p.copy() for p in forward]
    coefficients = np.ones(1)
    best, best_aic = (coefficients, variance), n * np.log(max(variance, 1e-300))
    for order in range(1, max_order + 1):
        f = [x[1:] for x in forward]
        b = [x[:-1] for x in backward]
        top = -2.0 * sum(float(x @ y) for x, y in zip(f, b, strict=True))
        bottom = sum(float(x @ x + y @ y) for x, y in zip(f, b, strict=True))
        if bottom <= 0:
            break
        reflection = top / bottom
        padded = np.append(coefficients, 0.0)
        coefficients = padded + reflection * padded[::-1]
        variance *= 1.0 - reflection**2
        forward = [x + reflection * y for x, y in zip(f, b, strict=True)]
        backward = [y + reflection * x for x, y in zip(f, b, strict=True)]
        aic = n * np.log(max(variance, 1e-300)) + 2 * order
        if aic < best_aic:
            best, best_aic = (coefficients, variance), aic
    return best


@dataclass(frozen=True)
class Uncertainty:
    """Covariance (q, q) in the local coordinates `directions` at the estimate; `as_white` is what it
    would be if the residual were white."""

    directions: Tangent
    covariance: Array
    as_white: Array
    noise_variance: float
    autoregression: Array
    residuals: tuple[Array, ...]


def uncertainty(problem: Problem, point: Point) -> Uncertainty:
    """Parameter covariance; where the residual is coloured and not whitened, the sandwich form.

    cov = R^-1 (Q' Sigma Q) R^-T with J = QR and Sigma the residual's covariance from its
    autoregressive model: H'Q by filtering Q backwards, no N x N matrix. White: sigma^2 (R'R)^-1.
    """
    directions = tangent(point, problem.structure)
    r, _ = problem.compressed(point, directions)
    _, s, vt = np.linalg.svd(r)
    keep = s > 1e-12 * s.max(initial=1e-300)
    to_step = vt[keep].T / s[keep]  # step = to_step @ (U' Q' e)
    residuals = [problem.residual(point, piece) for piece in problem.pieces]
    spent = directions.offset.size + sum(found.x0.size for found in residuals)
    n = problem.n_samples
    errors = tuple(found.error for found in residuals)
    autoregression, innovation = burg(errors)
    dof = max(n - spent, 1)
    variance = sum(float(e @ e) for e in errors) / dof
    if problem.structure.innovation or problem.autoregression.size > 1:
        middle = np.eye(int(keep.sum())) * variance
    else:
        middle = np.zeros((int(keep.sum()), int(keep.sum())))
        for piece in problem.pieces:
            dy, _ = problem.jacobian(point, directions, piece)
            q = dy[: -problem.predictor.matrix(point).shape[0] + 1] @ to_step
            coloured = scipy.signal.lfilter([1.0], autoregression, q[::-1], axis=0)
            triangle = upper_triangle(coloured)
            middle += triangle.T @ triangle
        middle *= innovation * n / dof
    covariance, as_white = to_step @ middle @ to_step.T, variance * to_step @ to_step.T
    return Uncertainty(directions, covariance, as_white, variance, autoregression, errors)


def _correlation(x: Sequence[Array], y: Sequence[Array], lags: int) -> Array:
    """Normalised correlation of x(t) with y(t - lag), lag 0 .. lags, pooled over pieces."""
    total = np.zeros(lags + 1)
    xx = sum(float(a @ a) for a in x)
    yy = sum(float(b @ b) for b in y)
    for a, b in zip(x, y, strict=True):
        size = 1 << int(np.ceil(np.log2(2 * a.size)))
        product = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
        count = min(lags + 1, a.size)
        total[:count] += product[:count]
    return total / max(np.sqrt(xx * yy), 1e-300)


def whiteness(errors: Sequence[Array], n_fitted: int, lags: int = 25) -> ResidualTest:
    """Ljung-Box test; `n_fitted` noise parameters are taken off the degrees of freedom."""
    centred = [e - e.mean() for e in errors]
    n = sum(e.size for e in centred)
    lags = int(max(min(lags, n // 10), 1))
    rho = _correlation(centred, centred, lags)
    statistic = n * (n + 2) * float(np.sum(rho[1:] ** 2 / (n - np.arange(1, lags + 1))))
    dof = max(lags - n_fitted, 1)
    n_effective = n / (1.0 + 2.0 * float(np.sum(rho[1:] ** 2)))
    bound = float(scipy.stats.norm.ppf(0.995) / np.sqrt(n_effective))
    p_value = float(scipy.stats.chi2.sf(statistic, dof))
    return ResidualTest(statistic, dof, p_value, n_effective, rho, bound)


def independence(
    problem: Problem, point: Point, noise: Uncertainty, signal: str = "u", lags: int = 25
) -> ResidualTest:
    """Does an input still explain the residual? Score test for `lags` further taps of it.

    Residual, Jacobian and delayed inputs are whitened by the residual's noise model and freed of
    what the fitted parameters and the initial state explain; the energy of the residual in what
    remains of the inputs is chi-square (T. Söderström, P. Stoica, System Identification, 1989,
    11.2; the projection makes it exact for the fitted degrees of freedom).
    """
    coloured = problem.autoregression.size == 1 and not problem.structure.innovation
    white = replace(problem, autoregression=noise.autoregression) if coloured else problem
    nd = problem.structure.delay
    shortest = min(len(p) for p in problem.pieces)
    lags = int(max(min(lags, shortest // 5 - nd), 1))
    inputs = [getattr(p, signal) if signal != "u" else p.force for p in problem.pieces]
    q = noise.directions.offset.size
    # Under feedback through an unknown controller u(t) may already answer e(t): begin at lag one.
    first = 1 if problem.structure.innovation and not problem.structure.feedthrough else 0
    stack = np.zeros((0, q + lags + 1))
    for piece, x in zip(problem.pieces, inputs, strict=True):
        dy, error = white.jacobian(point, noise.directions, piece)
        found = white.residual(point, piece)
        x = x - x.mean()
        padded = np.concatenate([np.zeros(lags + nd + 1), x])
        offset = lags + nd + 1 + x.size - problem.predictor.target(piece).size
        t = np.arange(problem.predictor.target(piece).size)
        delayed = np.column_stack(
            [padded[offset + t - (0 if signal != "u" else nd) - first - j] for j in range(lags)]
        )
        delayed = white.whiten(delayed)
        below = found.below @ (found.basis.T @ delayed[: len(found.basis)])
        delayed = np.vstack([without(found.basis, delayed), -below])
        rows = upper_triangle(np.column_stack([dy, delayed, error]))
        stack = upper_triangle(np.vstack([stack, rows]))
    inner = stack[q : q + lags, q : q + lags]
    size = np.linalg.norm(stack[:, q : q + lags], axis=0)
    u, s, _ = np.linalg.svd(inner / np.where(size > 0, size, 1.0))
    keep = s > 1e-6
    z = u[:, keep].T @ stack[q : q + lags, -1]
    n = white.n_samples
    variance = float(stack[-1, -1] ** 2) / max(n - q - lags, 1)
    statistic = float(z @ z) / variance
    dof = max(int(keep.sum()), 1)
    raw = [problem.residual(point, piece).error for piece in problem.pieces]
    own = _correlation(raw, raw, 200)
    skip = [x[x.size - e.size :] - x.mean() for x, e in zip(inputs, raw, strict=True)]
    theirs = _correlation(skip, skip, 200)
    n_effective = n / max(1.0 + 2.0 * float(np.sum(own[1:] * theirs[1:])), 1.0 / n)
    cross = _correlation(raw, skip, lags)
    bound = float(scipy.stats.norm.ppf(0.995) / np.sqrt(max(n_effective, 1.0)))
    p_value = float(scipy.stats.chi2.sf(statistic, dof))
    return ResidualTest(statistic, dof, p_value, n_effective, cross, bound)

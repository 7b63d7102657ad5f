"""Prediction-error minimisation: Levenberg-Marquardt in local coordinates.

Our own loop rather than `scipy.optimize.least_squares`: the coordinates change with every accepted
step, and an initial state per recording is eliminated exactly (Golub and Pereyra), neither of which
a routine with one fixed parameter vector can do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.linalg

from ffl.identify.linear.coordinates import Point, Tangent, balance, move, tangent
from ffl.identify.linear.problem import Problem

Status = Literal["converged", "stalled", "iteration_limit", "inadmissible_start", "boundary"]


@dataclass(frozen=True)
class Fitted:
    """A minimiser: the model, the sum of squared residuals, how the search ended."""

    point: Point
    cost: float
    status: Status
    iterations: int


def linear_step(problem: Problem, point: Point, directions: Tangent) -> Point:
    """The exact least-squares step along directions in which the output is linear."""
    r, z = problem.compressed(point, directions)
    step, *_ = scipy.linalg.lstsq(r, z, cond=1e-10)
    return move(point, directions, step)


def minimise(
    problem: Problem, start: Point, max_iterations: int = 50, tolerance: float = 1e-6
) -> Fitted:
    """Levenberg-Marquardt from `start`; each accepted step is rebalanced and given new coordinates.

    Stops as converged at rounding level, where the Gauss-Newton decrement falls below `tolerance`
    times the noise variance (1e-6: a step of a thousandth of a standard error), or where the
    relative decrease falls below 1e-12.
    """
    s = problem.structure
    point = balance(start, s)
    cost = problem.cost(point)
    if not np.isfinite(cost):
        return Fitted(point, np.inf, "inadmissible_start", 0)
    damping = 1e-4
    for iteration in range(1, max_iterations + 1):
        directions = tangent(point, s)
        r, z = problem.compressed(point, directions)
        size = np.linalg.norm(r, axis=0)
        size[size == 0] = 1.0
        u, sigma, vt = np.linalg.svd(r / size)
        inner = u.T @ z
        useful = sigma > 1e-10 * sigma[0]
        decrement = float(np.sum(inner[useful] ** 2))
        variance = cost / problem.n_samples
        if variance < 1e-26:  # rounding of an output of size one
            return Fitted(point, cost, "converged", iteration - 1)
        if decrement <= tolerance * variance or decrement <= 1e-12 * cost:
            return Fitted(point, cost, "converged", iteration - 1)
        accepted = False
        for _ in range(12):
            step = (vt.T @ (sigma * inner / (sigma**2 + damping))) / size
            trial = move(point, directions, step)
            new = problem.cost(trial)
            if new < cost:
                predicted = float(np.sum(inner**2 * (1.0 - (damping / (sigma**2 + damping)) ** 2)))
                good = (cost - new) / max(predicted, 1e-300)
                damping *= 0.1 if good > 0.75 else (1.0 if good > 0.25 else 4.0)
                gained, point, cost = (cost - new) / cost, balance(trial, s), new
                accepted = True
                break
            damping = max(damping, 1e-10) * 10.0
        if not accepted:
            return Fitted(point, cost, "stalled", iteration)
        damping = max(damping, 1e-15)
        if gained < 1e-12:
            return Fitted(point, cost, "converged", iteration)
    return Fitted(point, cost, "iteration_limit", max_iterations)

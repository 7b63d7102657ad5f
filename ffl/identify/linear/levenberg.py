"""Prediction-error minimisation: Levenberg-Marquardt in local coordinates, initial states eliminated.

Our own loop rather than `scipy.optimize.least_squares`: the coordinates change with every accepted
step, and an initial state per recording is eliminated exactly (Golub and Pereyra), neither of which
a routine with one fixed parameter vector can do.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import scipy.linalg
import scipy.signal

from ffl.identify.linear.coordinates import (
    Point,
    Structure,
    Tangent,
    balance,
    gramian_factor,
    move,
    tangent,
)
from ffl.identify.linear.predictors import Predictor
from ffl.identify.linear.sensitivity import free_response, simulate, simulate_with_derivatives
from ffl.identify.linear.signals import Signals
from ffl.systems.state_space import Array

Status = Literal["converged", "stalled", "iteration_limit", "inadmissible_start", "boundary"]


@dataclass(frozen=True)
class Fitted:
    """A minimiser: the model, the sum of squared residuals, how the search ended."""

    point: Point
    cost: float
    status: Status
    iterations: int


@dataclass(frozen=True)
class Residual:
    """Residual of one piece after its initial state, the simulated output, and that state."""

    error: Array
    output: Array
    x0: Array
    basis: Array  # orthonormal, what the initial state can explain in the first samples


def without(basis: Array, x: Array) -> Array:
    """x less its part in the orthonormal `basis`, which covers the first rows only."""
    result = np.array(x)
    head = x[: len(basis)]
    result[: len(basis)] -= basis @ (basis.T @ head)
    return result


@dataclass(frozen=True)
class Problem:
    """Sum over pieces of ||W (y - yhat)||^2, W the whitening filter `autoregression` (1, a_1, ...).

    `weights`, one array per piece, 0 or 1 per sample: samples of weight 0 are run through but not
    fitted (held out).
    """

    predictor: Predictor
    structure: Structure
    pieces: tuple[Signals, ...]
    autoregression: Array = field(default_factory=lambda: np.ones(1))

    weights: tuple[Array, ...] | None = None

    def weight(self, piece: Signals) -> Array | None:
        """Weights of the rows of the whitened residual of `piece`."""
        if self.weights is None:
            return None
        index = next(i for i, p in enumerate(self.pieces) if p is piece)
        rows = self.predictor.target(piece).size - (self.autoregression.size - 1)
        return self.weights[index][-rows:]

    def whiten(self, x: Array) -> Array:
        """The filter 1 + a_1 q^-1 + ... ; the first rows, which it cannot reach, are dropped."""
        if self.autoregression.size == 1:
            return x
        return scipy.signal.lfilter(self.autoregression, [1.0], x, axis=0)[
            self.autoregression.size - 1 :
        ]

    def residual(self, point: Point, piece: Signals) -> Residual:
        m = self.predictor.matrix(point)
        forced = simulate(m, self.predictor.inputs(piece))
        free = free_response(m, forced.size)  # only the rows that have not decayed
        error = self.whiten(self.predictor.target(piece) - forced)
        size = np.linalg.norm(free, axis=0)
        size[size == 0] = 1.0
        lost = self.autoregression.size - 1
        tail = min(forced.size - len(free), lost)
        reached = np.vstack([free / size, np.zeros((tail, free.shape[1]))])
        # QR first: the SVD that fixes the rank is then n x n. States the record does not show
        # (singular value below 1e-8 of the largest) stay zero.
        reached = self.whiten(reached)
        weight = self.weight(piece)
        if weight is not None:
            error = weight * error
            reached = weight[: len(reached), None] * reached
        q, r = np.linalg.qr(reached)
        u, s, vt = np.linalg.svd(r)
        keep = s > 1e-8 * s.max(initial=1e-300)
        basis = q @ u[:, keep]
        inner = basis.T @ error[: len(basis)]
        x0 = (vt[keep].T @ (inner / s[keep])) / size
        forced[: len(free)] += free @ x0
        return Residual(without(basis, error), forced, x0, basis)

    def output(self, point: Point, piece: Signals, x0: Array) -> Array:
        """The prediction of one piece from a given state (of the whole loop, where it is closed)."""
        return simulate(self.predictor.matrix(point), self.predictor.inputs(piece), x0)

    def likely_start(self, point: Point, piece: Signals, noise_std: float) -> Array:
        """The initial state by least squares with a weak prior: ten times what inputs of size one
        reach (discounted where poles lie on the unit circle)."""
        m = self.predictor.matrix(point)
        n = m.shape[0] - 1
        if n == 0:
            return np.zeros(0)
        inputs = self.predictor.inputs(piece)
        a, b = m[:n, :n], m[:n, n : n + inputs.shape[1]]
        rho = min(1.0, 0.9995 / max(np.abs(np.linalg.eigvals(a)).max(), 1e-12))
        factor = gramian_factor(rho * a, 10.0 * b)
        free = free_response(m, len(inputs))
        error = self.predictor.target(piece) - simulate(m, inputs)
        rows = np.vstack([free @ factor / noise_std, np.eye(n)])
        wanted = np.concatenate([error[: len(free)] / noise_std, np.zeros(n)])
        return factor @ np.linalg.lstsq(rows, wanted, rcond=None)[0]

    def cost(self, point: Point) -> float:
        """Sum of squares, infinity where the model is not admissible."""
        if not self.predictor.admissible(point):
            return np.inf
        total = 0.0
        with np.errstate(over="ignore", invalid="ignore"):
            for piece in self.pieces:
                try:
                    error = self.residual(point, piece).error
                except np.linalg.LinAlgError:
                    return np.inf
                total += float(error @ error)
        return total if np.isfinite(total) else np.inf

    def jacobian(self, point: Point, directions: Tangent, piece: Signals) -> tuple[Array, Array]:
        """(J, error): derivatives of the prediction, free of what the initial state explains."""
        found = self.residual(point, piece)
        dm = self.predictor.derivatives(point, directions)
        _, dy = simulate_with_derivatives(
            self.predictor.matrix(point), dm, self.predictor.inputs(piece), found.x0
        )
        dy = self.whiten(dy)
        weight = self.weight(piece)
        if weight is not None:
            dy *= weight[:, None]
        return without(found.basis, dy), found.error

    def compressed(self, point: Point, directions: Tangent) -> tuple[Array, Array]:
        """(R, z) with ||J s - e||^2 = ||R s - z||^2 + constant, by QR piece after piece."""
        q = directions.offset.size
        stack = np.zeros((0, q + 1))
        for piece in self.pieces:
            dy, error = self.jacobian(point, directions, piece)
            rows = np.linalg.qr(np.column_stack([dy, error]), mode="r")
            stack = np.linalg.qr(np.vstack([stack, rows]), mode="r")
        return stack[:q, :q], stack[:q, q]

    @property
    def n_samples(self) -> int:
        lost = self.autoregression.size - 1
        if self.weights is None:
            return sum(self.predictor.target(piece).size - lost for piece in self.pieces)
        return sum(int(self.weight(piece).sum()) for piece in self.pieces)  # type: ignore[union-attr]


def linear_step(problem: Problem, point: Point, directions: Tangent) -> Point:
    """The exact least-squares step along directions in which the output is linear."""
    r, z = problem.compressed(point, directions)
    step, *_ = scipy.linalg.lstsq(r, z, cond=1e-10)
    return move(point, directions, step)


def minimise(
    problem: Problem, start: Point, max_iterations: int = 50, tolerance: float = 1e-6
) -> Fitted:
    """Levenberg-Marquardt from `start`; each accepted step is rebalanced and given new coordinates.

    Stops as converged where the Gauss-Newton decrement falls below `tolerance` times the noise
    variance (1e-6: a step of a thousandth of a standard error) or the relative decrease below 1e-12.
    """
    s = problem.structure
    point = balance(start, s)
    cost = problem.cost(point)
    if not np.isfinite(cost):
        return Fitted(point, np.inf, "inadmissible_start", 0)
    damping = 1e-3
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
            damping = max(damping, 1e-8) * 10.0
        if not accepted:
            return Fitted(point, cost, "stalled", iteration)
        damping = max(damping, 1e-12)
        if gained < 1e-12:
            return Fitted(point, cost, "converged", iteration)
    return Fitted(point, cost, "iteration_limit", max_iterations)

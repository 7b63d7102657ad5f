"""The least-squares problem of a fit: residuals, their exact derivatives, initial states eliminated."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import scipy.linalg
import scipy.signal

from ffl.identify.linear.coordinates import Point, Structure, Tangent, gramian_factor
from ffl.identify.linear.predictors import Predictor
from ffl.identify.linear.sensitivity import free_response, simulate, simulate_with_derivatives
from ffl.identify.linear.signals import Signals
from ffl.identify.regression import upper_triangle
from ffl.systems.state_space import Array

RIDGE = 1e-6  # on the initial state, in units of the scaled output


@dataclass(frozen=True)
class Residual:
    """Residual of one piece after its initial state, the simulated output, and that state."""

    error: Array
    output: Array
    x0: Array
    basis: Array  # what the initial state can explain in the first samples; with
    below: Array  # the rows of the ridge it is orthonormal
    prior: Array  # residual of the ridge rows


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
    fitted (held out). `slack`: how far outside the unit circle poles may lie.
    """

    predictor: Predictor
    structure: Structure
    pieces: tuple[Signals, ...]
    autoregression: Array = field(default_factory=lambda: np.ones(1))
    weights: tuple[Array, ...] | None = None
    slack: float = 0.0

    def cut(self, length: int) -> Problem:
        """Multiple shooting: pieces of `length`, each with its own start, and room for models that
        are unstable but do not grow much within one."""
        parts = []
        for piece in self.pieces:
            count = max(len(piece) // length, 1)
            edges = np.linspace(0, len(piece), count + 1).astype(int)
            parts += [piece.cut(a, b) for a, b in pairwise(edges)]
        return replace(self, pieces=tuple(parts), slack=2.0 / length)

    def weight(self, piece: Signals) -> Array | None:
        """Weights of the rows of the whitened residual of `piece`."""
        rows = self.predictor.target(piece).size - (self.autoregression.size - 1)
        own = None if piece.shown is None else piece.shown[-rows:].astype(float)
        if self.weights is None:
            return own
        index = next(i for i, p in enumerate(self.pieces) if p is piece)
        held_out = self.weights[index][-rows:]
        return held_out if own is None else own * held_out

    def whiten(self, x: Array) -> Array:
        """The filter 1 + a_1 q^-1 + ... ; the first rows, which it cannot reach, are dropped."""
        if self.autoregression.size == 1:
            return x
        return scipy.signal.lfilter(self.autoregression, [1.0], x, axis=0)[
            self.autoregression.size - 1 :
        ]

    def residual(self, point: Point, piece: Signals, ridge: float = RIDGE) -> Residual:
        """The residual after the best initial state x0 = F w, ||Psi F w - e||^2 + ridge^2 ||w||^2.

        Psi is the free response and F F' ten times what inputs of size one reach (discounted where
        poles lie on the unit circle): states that the record does not show stay small, and smoothly
        so. A hard rank decision in place of the ridge made the cost jump and stalled the search
        (10th-order printer in its loop: 2.0e-4 instead of the noise floor 9.9e-7).
        """
        m = self.predictor.matrix(point)
        inputs = self.predictor.inputs(piece)
        output = simulate(m, inputs)
        n = m.shape[0] - 1
        error = self.whiten(self.predictor.target(piece) - output)
        weight = self.weight(piece)
        if weight is not None:
            error = weight * error
        if n == 0:
            return Residual(
                error, output, np.zeros(0), np.zeros((1, 0)), np.zeros((0, 0)), error[:0]
            )
        a, b = m[:n, :n], m[:n, n : n + inputs.shape[1]]
        rho = min(1.0, 0.9995 / max(np.abs(np.linalg.eigvals(a)).max(), 1e-12))
        factor = gramian_factor(rho * a, 10.0 * b)
        free = free_response(m, output.size)  # only the rows that have not decayed
        tail = min(output.size - len(free), self.autoregression.size - 1)
        rows = self.whiten(np.vstack([free @ factor, np.zeros((tail, n))]))
        if weight is not None:
            rows = weight[: len(rows), None] * rows
        q, r = np.linalg.qr(np.vstack([rows, ridge * np.eye(n)]))
        basis, below = q[: len(rows)], q[len(rows) :]
        inner = basis.T @ error[: len(basis)]
        w = scipy.linalg.solve_triangular(r, inner)
        x0 = factor @ w
        output[: len(free)] += free @ x0
        return Residual(without(basis, error), output, x0, basis, below, -ridge * w)

    def output(self, point: Point, piece: Signals, x0: Array) -> Array:
        """The prediction of one piece from a given state (of the whole loop, where it is closed)."""
        return simulate(self.predictor.matrix(point), self.predictor.inputs(piece), x0)

    def cost(self, point: Point) -> float:
        """Sum of squares, infinity where the model is not admissible."""
        if not self.predictor.admissible(point, self.slack):
            return np.inf
        total = 0.0
        with np.errstate(over="ignore", invalid="ignore"):
            for piece in self.pieces:
                try:
                    found = self.residual(point, piece)
                except (np.linalg.LinAlgError, ValueError):  # overflow in a wild trial
                    return np.inf
                error = np.concatenate([found.error, found.prior])
                total += float(error @ error)
        return total if np.isfinite(total) else np.inf

    def jacobian(self, point: Point, directions: Tangent, piece: Signals) -> tuple[Array, Array]:
        """(J, error): derivatives of the prediction, free of what the initial state explains.

        The last rows, as many as there are states, belong to the ridge on the initial state.
        """
        found = self.residual(point, piece)
        dm = self.predictor.derivatives(point, directions)
        _, dy = simulate_with_derivatives(
            self.predictor.matrix(point), dm, self.predictor.inputs(piece), found.x0
        )
        dy = self.whiten(dy)
        weight = self.weight(piece)
        if weight is not None:
            dy *= weight[:, None]
        rest = found.below @ (found.basis.T @ dy[: len(found.basis)])
        rows = np.vstack([without(found.basis, dy), -rest])
        return rows, np.concatenate([found.error, found.prior])

    def compressed(self, point: Point, directions: Tangent) -> tuple[Array, Array]:
        """(R, z) with ||J s - e||^2 = ||R s - z||^2 + constant, by QR piece after piece."""
        q = directions.offset.size
        stack = np.zeros((0, q + 1))
        for piece in self.pieces:
            dy, error = self.jacobian(point, directions, piece)
            rows = upper_triangle(np.column_stack([dy, error]))
            stack = upper_triangle(np.vstack([stack, rows]))
        return stack[:q, :q], stack[:q, q]

    @property
    def n_samples(self) -> int:
        lost = self.autoregression.size - 1
        if self.weights is None:
            return sum(self.predictor.target(piece).size - lost for piece in self.pieces)
        weights = [self.weight(piece) for piece in self.pieces]
        return sum(int(weight.sum()) for weight in weights if weight is not None)

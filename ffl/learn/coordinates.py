"""The update's least-squares problem in orthonormal coordinates.

18 repeated-pole functions filtered through the process sensitivity have a condition number of 2.5e9
after column scaling: normal equations lose every digit there, a pivoted QR keeps them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ffl.systems.state_space import Array

RANK_TOLERANCE = 1e-10
FINEST = 1e-14  # of the largest: below it a direction is rounding


@dataclass(frozen=True)
class Coordinates:
    """min |M theta - b| with M = Q R: x = Q^T b, theta = `back` x.

    `q` (rows, k), `back` (n, k) with k the numerical rank; columns of M are scaled to unit norm
    (`scale`) before the pivoted QR. Directions below `RANK_TOLERANCE` of the largest are left at
    zero on purpose; `rank` says how many remain, `unused` (rows, m) are those that rounding still lets
    see, and `left_out` what they would bring.
    """

    matrix: Array
    q: Array
    back: Array
    scale: Array
    unused: Array

    @property
    def rank(self) -> int:
        return self.back.shape[1]

    def coordinates(self, b: ArrayLike) -> Array:
        return self.q.T @ np.asarray(b, float)

    def theta(self, x: ArrayLike) -> Array:
        return self.back @ np.asarray(x, float)

    def left_out(self, b: ArrayLike) -> float:
        """By which share |M theta - b|^2 lies above its minimum over all directions; NaN where that
        minimum is nothing but rounding."""
        right = np.asarray(b, float)
        rest = right - self.q @ (self.q.T @ right)
        more = float(np.sum((self.unused.T @ rest) ** 2))
        least = float(np.sum(rest**2)) - more
        return more / least if least > 1e-24 * float(np.sum(right**2)) else float("nan")


def orthonormal(matrix: Array) -> Coordinates:
    """Coordinates of a tall matrix M (rows, n); cost O(rows n^2)."""
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0] = 1.0
    # Tall first without pivots (blocked, fast), then the small triangle with them.
    tall, triangle = np.linalg.qr(matrix / scale)
    small, r, pivots = scipy.linalg.qr(triangle, pivoting=True)
    diagonal = np.abs(np.diag(r))
    rank = int(np.sum(diagonal > RANK_TOLERANCE * diagonal.max(initial=0.0)))
    seen = int(np.sum(diagonal > FINEST * diagonal.max(initial=0.0)))
    back = np.zeros((matrix.shape[1], rank))
    inverse = scipy.linalg.solve_triangular(r[:rank, :rank], np.eye(rank))
    back[pivots[:rank]] = inverse
    q, unused = tall @ small[:, :rank], tall @ small[:, rank:seen]
    return Coordinates(matrix, q, back / scale[:, None], scale, unused)

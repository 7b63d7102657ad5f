"""Models as points of a manifold, and well-conditioned local coordinates around a point.

A state space of order n has n^2 directions that change nothing (changes of state basis). The local
coordinates are the orthogonal complement of these at the current point, in a balanced basis:
data-driven local coordinates, T. McKelvey, A. Helmersson, T. Ribarits, Automatica 40 (2004) 1629.
No polynomial is ever formed. Integrators, where asked for, are a fixed parallel block: P = P~ +
sum_j g_j/(z-1)^j, so their poles stay at 1 exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.linalg

from ffl.identify.regression import upper_triangle
from ffl.systems.state_space import Array, StateSpace

Port = Literal["none", "output", "input"]


@dataclass(frozen=True)
class Structure:
    """What is free: `order` states, of which `integrators` at 1; whole samples of `delay`.

    `feedthrough`: y(t) sees u(t - delay) (else the plant is strictly proper before its delay).
    `innovation`: a gain k of the one-step predictor is free. `offset`: a constant at that port.
    """

    order: int
    integrators: int = 0
    delay: int = 0
    feedthrough: bool = False
    innovation: bool = False
    offset: Port = "output"

    @property
    def n_parameters(self) -> int:
        free = 2 * self.order - self.integrators + self.feedthrough
        return free + self.order * self.innovation + (self.offset != "none")


@dataclass(frozen=True)
class Point:
    """x+ = A x + b u + k e, y = c x + d u + e, with `offset` at the structure's port."""

    a: Array
    b: Array
    c: Array
    d: float
    k: Array
    offset: float

    @property
    def matrix(self) -> Array:
        """[[A, b], [c, d]]."""
        return np.block([[self.a, self.b[:, None]], [self.c[None, :], np.array([[self.d]])]])

    def system(self, sample_time: float) -> StateSpace:
        return StateSpace(self.a, self.b[:, None], self.c[None, :], self.d, sample_time)


@dataclass(frozen=True)
class Tangent:
    """Derivatives of a point along q directions: matrix (n+1, n+1, q), k (n, q), offset (q,)."""

    matrix: Array
    k: Array
    offset: Array

    def select(self, keep: Array) -> Tangent:
        return Tangent(self.matrix[:, :, keep], self.k[:, keep], self.offset[keep])


def integrator_block(count: int) -> Array:
    return np.eye(count) + np.eye(count, k=1)


def _free_mask(s: Structure) -> tuple[Array, Array]:
    n, m = s.order, s.order - s.integrators
    matrix = np.zeros((n + 1, n + 1), bool)
    matrix[:m, :m] = True
    matrix[:m, n] = True
    matrix[n, :n] = True
    matrix[n, n] = s.feedthrough
    return matrix, np.full(n, s.innovation)


def tangent(point: Point, s: Structure) -> Tangent:
    """Orthonormal directions (in the free entries) that move the model and not only its basis."""
    n, m = s.order, s.order - s.integrators
    mask, mask_k = _free_mask(s)
    orbit = np.zeros((m * m, n + 1, n + 1))
    orbit_k = np.zeros((m * m, n))
    for i in range(m):
        for j in range(m):
            x = i * m + j  # direction X = e_i e_j': dA = XA - AX, db = Xb, dc = -cX, dk = Xk
            orbit[x, i, :m] += point.a[j, :m]
            orbit[x, :m, j] -= point.a[:m, i]
            orbit[x, i, n] = point.b[j]
            orbit[x, n, j] = -point.c[i]
            orbit_k[x, i] = point.k[j]
    flat = np.hstack([orbit[:, mask], orbit_k[:, mask_k]]).T
    size = flat.shape[0]
    if m:
        full, _ = scipy.linalg.qr(flat, mode="full")
        basis = full[:, m * m :]
    else:
        basis = np.eye(size)
    extra = int(s.offset != "none")
    q = basis.shape[1] + extra
    matrix, k, offset = np.zeros((n + 1, n + 1, q)), np.zeros((n, q)), np.zeros(q)
    n_matrix = int(mask.sum())
    matrix[mask, : q - extra] = basis[:n_matrix]
    k[mask_k, : q - extra] = basis[n_matrix:]
    if extra:
        offset[-1] = 1.0
    return Tangent(matrix, k, offset)


def linear_directions(point: Point, s: Structure, what: Literal["b", "c"]) -> Tangent:
    """Directions in which the output is linear: all of b (or c), the feedthrough, the offset."""
    n = s.order
    mask = np.zeros((n + 1, n + 1), bool)
    if what == "b":
        mask[: n - s.integrators, n] = True
    else:
        mask[n, :n] = True
    mask[n, n] = s.feedthrough
    count, extra = int(mask.sum()), int(s.offset != "none")
    matrix = np.zeros((n + 1, n + 1, count + extra))
    matrix[mask, :count] = np.eye(count)
    offset = np.zeros(count + extra)
    if extra:
        offset[-1] = 1.0
    return Tangent(matrix, np.zeros((n, count + extra)), offset)


def move(point: Point, directions: Tangent, step: Array) -> Point:
    """The point moved by `step` (q,) along the directions."""
    n = point.a.shape[0]
    matrix = point.matrix + directions.matrix @ step
    return Point(
        matrix[:n, :n],
        matrix[:n, n],
        matrix[n, :n],
        float(matrix[n, n]),
        point.k + directions.k @ step,
        point.offset + float(directions.offset @ step),
    )


def balance(point: Point, s: Structure) -> Point:
    """The same model with its free block in balanced coordinates.

    Poles on or outside the unit circle are discounted: gramians of (rho A, [b k], c) with rho just
    small enough that they exist.
    """
    m = s.order - s.integrators
    if m == 0:
        return point
    a, b, c, k = point.a[:m, :m], point.b[:m], point.c[:m], point.k[:m]
    radius = np.abs(np.linalg.eigvals(a)).max(initial=0.0)
    rho = min(1.0, 0.9995 / max(radius, 1e-12))
    inputs = np.column_stack([b, k])
    reach = gramian_factor(rho * a, inputs)
    seen = gramian_factor(rho * a.T, c[:, None])
    u, sigma, vt = np.linalg.svd(seen.T @ reach)
    if sigma[-1] <= 1e-13 * sigma[0]:  # a state nobody sees or drives: leave the basis alone
        return point
    root = 1.0 / np.sqrt(sigma)
    t, t_inverse = reach @ vt.T * root, (seen @ u * root).T
    whole_a, whole_b = point.a.copy(), point.b.copy()
    whole_c, whole_k = point.c.copy(), point.k.copy()
    whole_a[:m, :m] = t_inverse @ a @ t
    whole_b[:m], whole_k[:m], whole_c[:m] = t_inverse @ b, t_inverse @ k, c @ t
    return replace(point, a=whole_a, b=whole_b, c=whole_c, k=whole_k)


def gramian_factor(a: Array, b: Array) -> Array:
    """L (n, n) with L L' = sum_k A^k b b' A'^k, the solution of X = A X A' + b b'.

    Doubling (R. A. Smith, SIAM J. Appl. Math. 16 (1968) 198) on the factor itself, compressed by QR
    each time: nothing is squared, and 2^k terms are summed in k steps. In Schur form, where powers
    keep their zeros: of a dense A with close poles and large entries (norm 362, radius 0.995: what
    is left of an unstable start) rounding alone drives A^(2^k) to infinity.
    """
    n = a.shape[0]
    power, basis = scipy.linalg.schur(a, output="real")
    factor = _compressed(basis.T @ b, n)
    for _ in range(40):
        more = power @ factor
        factor = _compressed(np.hstack([factor, more]), n)
        if np.abs(more).max(initial=0.0) <= 1e-14 * np.abs(factor).max(initial=0.0):
            break
        power = power @ power
    return basis @ factor


def _compressed(x: Array, n: int) -> Array:
    """(n, n) with the same product with its own transpose."""
    r = upper_triangle(x.T)
    return np.vstack([r, np.zeros((n - r.shape[0], n))]).T if r.shape[0] < n else r[:n].T

"""Quadratic programs in orthonormal coordinates: the one file that names cvxpy and OSQP.

OSQP calls points solved whose dual residual is 5.6e7 times the tolerance (osqp #790), so its answer
only proposes the active set: the equations of that set are solved by QR, and where the KKT
conditions still fail, the least-distance problem is solved by non-negative least squares.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import scipy.optimize

from ffl.systems.state_space import Array

TOLERANCE = 1e-10


@dataclass(frozen=True)
class Projection:
    """x that minimises |x - c|^2 / 2 under G x <= h, with multipliers >= 0.

    `status` is "optimal" or "infeasible"; `residual` the largest violated KKT condition, relative.
    """

    x: Array
    multipliers: Array
    status: str
    residual: float


def kkt_residual(c: Array, g: Array, h: Array, x: Array, multipliers: Array) -> float:
    """Largest of stationarity, primal and dual feasibility, complementarity; rows of unit norm.

    Relative to the length of c and the size of h, in the problem's orthonormal coordinates.
    """
    length = max(float(np.linalg.norm(c)), float(np.abs(h).max(initial=0.0)), 1e-300)
    slack = g @ x - h
    parts = (
        np.linalg.norm(x - c + g.T @ multipliers) / length,
        slack.max(initial=0.0) / length,
        -multipliers.min(initial=0.0) / length,
        np.abs(multipliers * slack).max(initial=0.0) / length**2,
    )
    return float(max(parts))


def _osqp(c: Array, g: Array, h: Array) -> Array | None:
    """Multipliers that OSQP finds through cvxpy, or None where it gives up."""
    import cvxpy

    x = cvxpy.Variable(len(c))
    rows = g @ x <= h
    problem = cvxpy.Problem(cvxpy.Minimize(0.5 * cvxpy.sum_squares(x - c)), [rows])
    settings = {"eps_abs": 1e-7, "eps_rel": 1e-7, "max_iter": 10000, "polishing": True}
    with warnings.catch_warnings():  # an inaccurate solution is checked below, not trusted
        warnings.simplefilter("ignore")
        try:
            problem.solve(solver=cvxpy.OSQP, **settings)
        except cvxpy.SolverError:
            return None
    if rows.dual_value is None or not np.all(np.isfinite(rows.dual_value)):
        return None
    return np.maximum(np.asarray(rows.dual_value, float), 0.0)


def _on_active_set(c: Array, g: Array, h: Array, active: Array) -> tuple[Array, Array]:
    """Minimiser with the `active` rows as equations, by QR of their transpose, and multipliers."""
    rows = g[active]
    q, r = np.linalg.qr(rows.T)
    multipliers = np.zeros(len(h))
    step, *_ = np.linalg.lstsq(r.T, rows @ c - h[active], rcond=None)
    solved, *_ = np.linalg.lstsq(r, step, rcond=None)
    multipliers[active] = solved
    return c - q @ step, multipliers


def _least_distance(c: Array, g: Array, h: Array) -> tuple[Array, Array] | None:
    """Lawson and Hanson's LDP: exact and finite; None where the rows contradict each other."""
    d = h - g @ c
    matrix = np.vstack([-g.T, -d[None, :]])
    target = np.zeros(len(c) + 1)
    target[-1] = 1.0
    u, _ = scipy.optimize.nnls(matrix, target, maxiter=50 * max(matrix.shape))
    r = matrix @ u - target
    if np.linalg.norm(r) < 1e-9:
        return None
    y = -r[:-1] / r[-1]
    return c + y, u / -r[-1]


def project(c: Array, g: Array, h: Array) -> Projection:
    """Nearest point to `c` (k,) under `g` x <= `h` with g (m, k); rows are scaled inside."""
    if len(h) == 0:
        return Projection(c.copy(), np.zeros(0), "optimal", 0.0)
    norms = np.linalg.norm(g, axis=1)
    norms[norms == 0] = 1.0
    length = max(float(np.linalg.norm(c)), float(np.abs(h / norms).max()), 1e-300)
    rows, bounds, target = g / norms[:, None], h / norms / length, c / length
    x, multipliers, residual = target, np.zeros(len(h)), np.inf
    proposed = _osqp(target, rows, bounds)
    if proposed is not None:
        active = proposed > 1e-7 * max(1.0, float(proposed.max(initial=0.0)))
        if active.any():
            x, multipliers = _on_active_set(target, rows, bounds, active)
        residual = kkt_residual(target, rows, bounds, x, multipliers)
    if residual > TOLERANCE:
        exact = _least_distance(target, rows, bounds)
        if exact is None:
            return Projection(c.copy(), np.zeros(len(h)), "infeasible", np.inf)
        if kkt_residual(target, rows, bounds, *exact) < residual:
            x, multipliers = exact
        if np.any(multipliers > 0):  # one more solve on the exact active set: full accuracy
            sharp = _on_active_set(target, rows, bounds, multipliers > 0)
            if kkt_residual(target, rows, bounds, *sharp) < kkt_residual(
                target, rows, bounds, x, multipliers
            ):
                x, multipliers = sharp
        residual = kkt_residual(target, rows, bounds, x, multipliers)
    return Projection(x * length, multipliers * length / norms, "optimal", residual)


def conflict(g: Array, h: Array) -> list[int]:
    """Rows of G x <= h that no x meets together, and of which none can be left out; empty where all
    can be met. One row alone is 0 <= h < 0.

    Farkas: u >= 0 with G^T u = 0 and h^T u = -1 proves it, and non-negative least squares finds it on
    at most k + 1 rows; those that the proof can do without are then left out one by one.
    """
    norms = np.linalg.norm(g, axis=1)
    small = norms <= 1e-12 * norms.max(initial=0.0)
    alone = np.flatnonzero(small & (h < 0))
    if alone.size:
        return [int(alone[np.argmin(h[alone])])]
    rows = np.flatnonzero(~small)
    unit, bound = g[rows] / norms[rows, None], h[rows] / norms[rows]
    bound = bound / max(float(np.abs(bound).max(initial=0.0)), 1e-300)

    def proof(kept: Array) -> Array | None:
        matrix = np.vstack([unit[kept].T, bound[kept]])
        target = np.append(np.zeros(g.shape[1]), -1.0)
        u, away = scipy.optimize.nnls(matrix, target, maxiter=50 * max(matrix.shape))
        return kept[u > 0] if away < 1e-9 else None

    kept = proof(np.arange(len(rows)))
    if kept is None:
        return []
    for row in kept:
        fewer = proof(kept[kept != row]) if len(kept) > 1 else None
        kept = kept if fewer is None else fewer
    return [int(k) for k in rows[kept]]


def least_violation(c: Array, g: Array, h: Array) -> float:
    """Smallest s for which G x <= h + s has a point."""
    import cvxpy

    x, s = cvxpy.Variable(len(c)), cvxpy.Variable()
    aim = cvxpy.Minimize(s + 1e-9 * cvxpy.sum_squares(x - c))
    problem = cvxpy.Problem(aim, [g @ x <= h + s])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            problem.solve(solver=cvxpy.CLARABEL)
        except cvxpy.SolverError:
            return float("nan")
    return float(np.asarray(s.value))

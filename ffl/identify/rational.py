"""Variable projection: poles of the inverse from data, starting from nothing known about them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize
from numpy.typing import NDArray

from ffl.identify.kernels import OBF
from ffl.identify.regression import Rows

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Projection:
    """Least squares on the functions of one set of poles: the linear part projected out."""

    kernel: OBF
    theta: Array
    residual: Array
    squares: float
    status: str
    n_evaluations: int


def project(rows: Rows, lags: Array, start: OBF, max_evaluations: int = 60) -> Projection:
    """Poles that minimise ||target - Phi B(poles) c||^2, c eliminated (Golub and Pereyra).

    Levenberg-Marquardt within the chain's bounds; the Jacobian is the full one,
    -(P dA c + (A^+)^T dA^T residual). Cost per evaluation O(N log N p) for p functions.
    """
    n_poles = len(start.coordinates) - 1
    bounds = np.array(start.bounds[1:]).reshape(n_poles, 2)
    scale = start.coordinates[:1]
    memo: dict[bytes, tuple[Array, Array]] = {}

    def evaluate(x: Array) -> tuple[Array, Array]:
        key = x.tobytes()
        if key not in memo:
            memo.clear()
            functions, slopes = start.at(np.concatenate([scale, x])).basis(lags)
            a = rows.apply(functions)
            q, r = np.linalg.qr(a)
            c = scipy.linalg.solve_triangular(r, q.T @ rows.target)
            residual = rows.target - a @ c
            moved = rows.apply(np.tensordot(slopes, c, axes=([2], [0])).T)
            back = rows.transpose(residual)
            inner = np.tensordot(slopes, back, axes=([1], [0])).T
            jacobian = q @ (q.T @ moved) - moved
            jacobian -= q @ scipy.linalg.solve_triangular(r, inner, trans="T")
            memo[key] = residual, jacobian
        return memo[key]

    x = np.clip(start.coordinates[1:], bounds[:, 0] + 1e-9, bounds[:, 1] - 1e-9)
    status, n_evaluations = "converged", 1
    if n_poles:
        found = scipy.optimize.least_squares(
            lambda v: evaluate(v)[0],
            x,
            jac=lambda v: evaluate(v)[1],
            bounds=(bounds[:, 0], bounds[:, 1]),
            x_scale=1.0,
            max_nfev=max_evaluations,
            ftol=1e-9,
            xtol=1e-8,
            gtol=1e-10,
        )
        x, n_evaluations = found.x, int(found.nfev)
        status = "converged" if found.status > 0 else "stopped at the evaluation limit"
    residual, _ = evaluate(x)
    kernel = start.at(np.concatenate([scale, x]))
    functions, _ = kernel.basis(lags)
    c = np.linalg.lstsq(rows.apply(functions), rows.target, rcond=None)[0]
    squares = float(residual @ residual) + rows.rest
    return Projection(kernel, functions @ c, residual, squares, status, n_evaluations)

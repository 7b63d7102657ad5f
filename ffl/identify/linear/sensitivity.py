"""State space with its derivatives in many directions, filtered together."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numba import njit

from ffl.systems.state_space import Array

CHUNK = 4096


@njit(cache=True)
def _run(m, inputs, x, states, y):  # type: ignore[no-untyped-def]
    """(x+, y) = M (x, inputs); `states` keeps x(t) beside the inputs; leaves the last state in x."""
    rows, columns = m.shape
    n = rows - 1
    for t in range(inputs.shape[0]):
        s = states[t]
        s[:n] = x
        s[n:] = inputs[t]
        for i in range(rows):
            total = 0.0
            for j in range(columns):
                total += m[i, j] * s[j]
            if i < n:
                x[i] = total
            else:
                y[t] = total


@njit(cache=True)
def _output(m, inputs, x, y):  # type: ignore[no-untyped-def]
    rows, columns = m.shape
    n = rows - 1
    following = np.empty(n)
    for t in range(inputs.shape[0]):
        for i in range(rows):
            total = 0.0
            for j in range(n):
                total += m[i, j] * x[j]
            for j in range(n, columns):
                total += m[i, j] * inputs[t, j - n]
            if i < n:
                following[i] = total
            else:
                y[t] = total
        for i in range(n):
            x[i] = following[i]


@njit(cache=True, fastmath={"contract"})
def _derivatives(m, forcing, dx, dy):  # type: ignore[no-untyped-def]
    """(dx+, dy) = M_x dx + forcing(t), all directions at once; leaves the last dx in dx."""
    n, q = dx.shape
    following = np.empty((n, q))
    for t in range(forcing.shape[0]):
        for i in range(n + 1):
            row = following[i] if i < n else dy[t]
            source = forcing[t, i]
            for k in range(q):
                row[k] = source[k]
            for j in range(n):
                weight = m[i, j]
                if weight != 0.0:
                    state = dx[j]
                    for k in range(q):
                        row[k] += weight * state[k]
        for i in range(n):
            for k in range(q):
                dx[i, k] = following[i, k]


@njit(cache=True)
def _free(a, row, limit, out):  # type: ignore[no-untyped-def]
    """out[t] = c A^t until it falls below `limit`; returns the number of rows written."""
    n = a.shape[0]
    following = np.empty(n)
    for t in range(out.shape[0]):
        size = 0.0
        for j in range(n):
            out[t, j] = row[j]
            size += abs(row[j])
        if size < limit:
            return t + 1
        for j in range(n):
            total = 0.0
            for i in range(n):
                total += row[i] * a[i, j]
            following[j] = total
        for j in range(n):
            row[j] = following[j]
    return out.shape[0]


def simulate(m: Array, inputs: Array, x0: Array | None = None) -> Array:
    """Output (N,) of the system with rows (x+, y) and columns (x, inputs)."""
    n = m.shape[0] - 1
    x = np.zeros(n) if x0 is None else np.array(x0, float)
    y = np.empty(inputs.shape[0])
    _output(np.ascontiguousarray(m), inputs, x, y)
    return y


def simulate_with_derivatives(m: Array, dm: Array, inputs: Array, x0: Array) -> tuple[Array, Array]:
    """Output (N,) and its derivatives (N, q) along the q directions `dm` (rows, columns, q).

    Exact forward sensitivities (dx+, dy) = M_x dx + dM (x, inputs), O(N q n^2): the second term by
    one matrix product per chunk, the recursion in real Schur coordinates, where half of M_x is zero.
    """
    rows, columns, q = dm.shape
    n = rows - 1
    triangle, basis = scipy.linalg.schur(m[:n, :n]) if n else (m[:0, :0], np.zeros((0, 0)))
    left, right = scipy.linalg.block_diag(basis.T, 1.0), np.eye(columns)
    right[:n, :n] = basis
    m = left @ m @ right
    m[:n, :n] = triangle
    directions = np.einsum("ij,jkq,kl->liq", left, dm, right, optimize=True)
    directions = directions.reshape(columns, rows * q)
    x, dx = basis.T @ x0, np.zeros((n, q))
    y, dy = np.empty(inputs.shape[0]), np.empty((inputs.shape[0], q))
    for start in range(0, y.size, CHUNK):
        part = slice(start, min(start + CHUNK, y.size))
        states = np.empty((part.stop - start, columns))
        _run(m, inputs[part], x, states, y[part])
        forcing = (states @ directions).reshape(-1, rows, q)
        _derivatives(m, forcing, dx, dy[part])
    return y, dy


def free_response(m: Array, n_samples: int) -> Array:
    """c A^t, (L, n) with L <= n_samples: cut where it has decayed to 1e-14 of its first row."""
    n = m.shape[0] - 1
    out = np.zeros((n_samples, n))
    if not n:
        return out[:1]
    row = m[n, :n].copy()
    rows = _free(np.ascontiguousarray(m[:n, :n]), row, 1e-14 * np.abs(row).sum(), out)
    return out[:rows]

"""Discrete-time state space: the form every signal is filtered in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numba import njit
from numpy.typing import ArrayLike, NDArray

from ffl.errors import InputError

Array = NDArray[Any]  # real; numpy's own stubs widen float64 too often to say so
ComplexArray = NDArray[Any]

UNSEEN = 1e-9  # of what is seen most
CLOSE = 1e-6  # of what moves most: what moves less is not looked at as closely


@njit(cache=True)
def _run(a, b, c, d, u, x, y):  # type: ignore[no-untyped-def]
    """x(t+1) = A x(t) + B u(t), y(t) = C x(t) + D u(t); leaves the last state in x."""
    n, m, p = a.shape[0], b.shape[1], c.shape[0]
    following = np.empty(n)
    for t in range(u.shape[0]):
        for i in range(p):
            value = 0.0
            for k in range(n):
                value += c[i, k] * x[k]
            for k in range(m):
                value += d[i, k] * u[t, k]
            y[t, i] = value
        for i in range(n):
            value = 0.0
            for k in range(n):
                value += a[i, k] * x[k]
            for k in range(m):
                value += b[i, k] * u[t, k]
            following[i] = value
        for i in range(n):
            x[i] = following[i]


@njit(cache=True, fastmath=True)
def _run_columns(a, b, c, d, u, x, y):  # type: ignore[no-untyped-def]
    """One input, one output, many signals at once: u, y (N, k), x (n, k); the inner loop is SIMD."""
    n, columns = a.shape[0], u.shape[1]
    following = np.empty((n, columns))
    for t in range(u.shape[0]):
        for k in range(columns):
            y[t, k] = d * u[t, k]
        for j in range(n):
            if c[j] != 0.0:
                for k in range(columns):
                    y[t, k] += c[j] * x[j, k]
        for i in range(n):
            for k in range(columns):
                following[i, k] = b[i] * u[t, k]
            for j in range(n):
                if a[i, j] != 0.0:
                    for k in range(columns):
                        following[i, k] += a[i, j] * x[j, k]
        x[:] = following


@dataclass(frozen=True, init=False)
class StateSpace:
    """x(t+1) = A x(t) + B u(t), y(t) = C x(t) + D u(t), with `sample_time` in seconds.

    `a` (n, n), `b` (n, m), `c` (p, n), `d` (p, m); scalars and flat lists are taken where the shape
    is clear. One-dimensional signals are used where m = p = 1.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    sample_time: float

    def __init__(
        self, a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike, sample_time: float
    ) -> None:
        feedthrough = np.atleast_2d(np.asarray(d, float))
        square = np.asarray(a, float)
        n = square.shape[0] if square.ndim == 2 else int(np.sqrt(square.size))
        p, m = feedthrough.shape
        for name, given, shape in (
            ("a", a, (n, n)),
            ("b", b, (n, m)),
            ("c", c, (p, n)),
            ("d", d, (p, m)),
        ):
            value = np.asarray(given, float)
            if value.size != shape[0] * shape[1]:
                raise InputError(
                    f"state space: {name} has shape {value.shape}, expected {shape}; "
                    "give A (n, n), B (n, m), C (p, n), D (p, m)"
                )
            if not np.all(np.isfinite(value)):
                raise InputError(f"state space: {name} holds NaN or infinity; give finite numbers")
            object.__setattr__(self, name, np.ascontiguousarray(value.reshape(shape)))
        if not sample_time > 0:
            raise InputError(f"sample_time = {sample_time} must be positive (seconds)")
        object.__setattr__(self, "sample_time", float(sample_time))

    @property
    def order(self) -> int:
        return self.a.shape[0]

    @property
    def poles(self) -> ComplexArray:
        """Eigenvalues of A."""
        return np.linalg.eigvals(self.a).astype(complex)

    @property
    def zeros(self) -> ComplexArray:
        """Transmission zeros: finite generalised eigenvalues of the Rosenbrock pencil (SISO)."""
        n = self.order
        pencil = np.block([[self.a, self.b], [self.c, self.d]])
        mass = np.zeros_like(pencil)
        mass[:n, :n] = np.eye(n)
        # Balancing rows and columns keeps a gain of 1e-6 from looking like a zero at infinity.
        scale = np.abs(self.c).max(initial=0.0) or np.abs(self.d).max(initial=0.0) or 1.0
        pencil[n:, :] /= scale
        alpha, beta = scipy.linalg.eigvals(pencil, mass, homogeneous_eigvals=True)
        finite = np.abs(beta) > 1e-9 * np.abs(alpha)
        return (alpha[finite] / beta[finite]).astype(complex)

    @property
    def is_stable(self) -> bool:
        return bool(self.order == 0 or np.abs(self.poles).max() < 1.0)

    def filter(self, u: ArrayLike, x0: ArrayLike | None = None) -> Array:
        """Output for input `u` of shape (N,) or (N, m), from state `x0` (zero: initial rest).

        Returns shape (N,) for one output, else (N, p). Cost O(N n^2).
        """
        u2 = np.ascontiguousarray(u, dtype=float)
        if u2.ndim == 1:
            u2 = u2[:, None]
        if u2.shape[1] != self.b.shape[1]:
            raise InputError(
                f"filter: input has {u2.shape[1]} columns, the system {self.b.shape[1]} inputs"
            )
        x = np.zeros(self.order) if x0 is None else np.array(x0, dtype=float)
        y = np.empty((u2.shape[0], self.c.shape[0]))
        _run(self.a, self.b, self.c, self.d, u2, x, y)
        return y[:, 0] if y.shape[1] == 1 else y

    def filter_columns(self, columns: ArrayLike) -> Array:
        """Each column of (N, k) filtered from rest by a one-input one-output system.

        All columns advance together, which is several times faster than one after the other.
        """
        u = np.ascontiguousarray(columns, dtype=float)
        y = np.empty_like(u)
        x = np.zeros((self.order, u.shape[1]))
        _run_columns(self.a, self.b[:, 0], self.c[0], self.d[0, 0], u, x, y)
        return y

    def response(self, frequencies_hz: ArrayLike) -> ComplexArray:
        """H(exp(i 2 pi f T)); shape (F,) for one input and one output, else (F, p, m)."""
        z = np.exp(2j * np.pi * np.asarray(frequencies_hz, float) * self.sample_time)
        return self.at(z)

    def at(self, z: ArrayLike) -> ComplexArray:
        """C (zI - A)^-1 B + D at the complex points `z`."""
        points = np.atleast_1d(np.asarray(z, complex))
        eye = np.eye(self.order)
        inner = np.linalg.solve(
            points[:, None, None] * eye - self.a,
            np.broadcast_to(self.b, (points.size, *self.b.shape)),
        )
        value = self.c @ inner + self.d
        return value[:, 0, 0] if self.d.shape == (1, 1) else value

    def impulse_response(self, n: int) -> Array:
        """First `n` Markov parameters D, CB, CAB, ... of a single-input system."""
        u = np.zeros(n)
        u[:1] = 1.0
        return self.filter(u)

    def free_response(self, n: int) -> Array:
        """O = [C; C A; C A^2; ...] (n, order) of the first output, until it has decayed to rounding; zero
        after that: what it answers to a state alone."""
        radius = float(np.abs(self.poles).max(initial=0.0))
        decay = n if radius >= 1.0 else int(np.ceil(np.log(1e-16) / np.log(max(radius, 1e-3))))
        rows = np.zeros((n, self.order))
        row = self.c[0].copy()
        for k in range(min(n, decay)):
            rows[k] = row
            row = row @ self.a
        return rows

    def select(self, outputs: slice | list[int], inputs: slice | list[int]) -> StateSpace:
        """The sub-system from some inputs to some outputs."""
        d = self.d[outputs][:, inputs]
        return StateSpace(self.a, self.b[:, inputs], self.c[outputs], d, self.sample_time)


def series(first: StateSpace, second: StateSpace) -> StateSpace:
    """second(first(u)), block lower triangular."""
    if abs(first.sample_time - second.sample_time) > 1e-9 * first.sample_time:
        raise InputError(
            f"series: sample times {first.sample_time} and {second.sample_time} differ; resample one"
        )
    a = np.block([[first.a, np.zeros((first.order, second.order))], [second.b @ first.c, second.a]])
    return StateSpace(
        a,
        np.vstack([first.b, second.b @ first.d]),
        np.hstack([second.d @ first.c, second.c]),
        second.d @ first.d,
        first.sample_time,
    )


def without_unseen(a: Array, b: Array, c: Array, pole: float) -> tuple[Array, Array, Array]:
    """(A, B, C) less the states with this real `pole` that no output sees: with A v = pole v and C v = 0
    all is told by what is normal to v."""
    if not len(a):
        return a, b, c
    moves, seen = (np.asarray(x, float) for x in (a - pole * np.eye(len(a)), c))
    sizes = np.linalg.norm(moves, axis=1, keepdims=True)
    moves = moves / np.maximum(sizes, max(CLOSE * sizes.max(), 1e-300))
    seen = seen / max(np.linalg.norm(seen), 1e-300)
    hidden = scipy.linalg.null_space(np.vstack([moves, seen]), rcond=UNSEEN)
    if not hidden.shape[1]:
        return a, b, c
    rest = scipy.linalg.null_space(hidden.T)
    return without_unseen(rest.T @ a @ rest, rest.T @ b, c @ rest, pole)

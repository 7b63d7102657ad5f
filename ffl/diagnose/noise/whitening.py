"""Exact whitening of y's residual: the innovations of a Kalman filter for closed-loop noise.

The residual y - yhat of a right model is the loop's answer to force and sensor noise. A Kalman
filter of that answer turns it into white noise of unit variance, from the first sample on (the
covariance starts at what the noise leaves in a running loop plus what is not known of the start);
the log of its scales completes the Gaussian likelihood. Samples that a sensor at its limit lost say
nothing: the filter foretells them, learns nothing from them and is that much less sure after.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from ffl.diagnose.noise.noise import Noise
from ffl.systems.loop import Loop
from ffl.systems.state_space import Array

SETTLED = 1e-7  # relative change of the gain at which it is taken as steady
MOST_STEPS = 5000


@njit(cache=True, nogil=True, error_model="numpy")
def _lower(m):  # type: ignore[no-untyped-def]
    """m (rows, columns) made lower triangular from the right, by Householder reflections of its columns."""
    rows, columns = m.shape
    for i in range(rows):
        square = 0.0
        for j in range(i, columns):
            square += m[i, j] * m[i, j]
        if square == m[i, i] * m[i, i]:
            continue
        end = -np.sqrt(square) if m[i, i] > 0.0 else np.sqrt(square)
        first = m[i, i] - end
        for q in range(i + 1, rows):
            dot = first * m[q, i]
            for j in range(i + 1, columns):
                dot += m[i, j] * m[q, j]
            dot /= end * first
            m[q, i] += dot * first
            for j in range(i + 1, columns):
                m[q, j] += dot * m[i, j]
        m[i, i] = end
        m[i, i + 1 :] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _riccati(a, c, inward, outward, root, steps, lost):  # type: ignore[no-untyped-def]
    """Gains (m, n) and scales (m,) until steady, of x+ = A x + F w, e = c x + h w, w white, of variance 1;
    inward F (n, k), outward h (k,), root (n, n) S with S S' the covariance at the start. With samples
    `lost` (m,) one for each of them: no gain there, and a scale beyond all bounds.

    The array form, S alone and never S S': what states that nearly run together leave of a covariance
    by differences is lost to rounding (a mode at 1/26 of the sampling rate behind an observer was).

        [h  c S; F  A S] Q = [scale  0; gain scale  S+]        (Kailath, Sayed, Hassibi 2000, 12.3)
    """
    n, k = inward.shape
    m = np.empty((n + 1, k + n))
    gains = np.empty((steps, n))
    scales = np.empty(steps)
    used, steady = 0, False
    for t in range(steps):
        used = t + 1
        blind = len(lost) > 0 and lost[t]
        if steady and not blind:
            gains[t], scales[t] = gains[t - 1], scales[t - 1]
            continue
        for j in range(k):
            m[0, j] = outward[j]
            for i in range(n):
                m[i + 1, j] = inward[i, j]
        for j in range(n):
            total = 0.0
            for q in range(n):
                total += c[q] * root[q, j]
            m[0, k + j] = total
        for i in range(n):
            m[i + 1, k:] = 0.0
            for q in range(n):
                if a[i, q] != 0.0:
                    for j in range(n):
                        m[i + 1, k + j] += a[i, q] * root[q, j]
        if blind:
            gains[t], scales[t], steady = 0.0, np.inf, False
            ahead = m[1:].copy()
            _lower(ahead)
            root[:] = ahead[:, :n]
            continue
        _lower(m)
        scales[t] = abs(m[0, 0])
        gains[t] = m[1:, 0] / m[0, 0]
        root[:] = m[1:, 1 : n + 1]
        if t > 0:
            change = np.abs(gains[t] - gains[t - 1]).max()
            steady = (
                change <= SETTLED * np.abs(gains[t]).max()
                and abs(scales[t] - scales[t - 1]) <= SETTLED * scales[t]
            )
            if steady and len(lost) == 0:
                break
    return gains[:used], scales[:used]


@njit(cache=True, nogil=True, error_model="numpy")
def _innovations(a, c, gains, scales, x):  # type: ignore[no-untyped-def]
    """Scaled innovations of every column of x (N, k)."""
    n, samples, k = a.shape[0], x.shape[0], x.shape[1]
    out = np.empty((samples, k))
    state, following = np.zeros((n, k)), np.empty((n, k))
    last = len(scales) - 1
    nu = np.empty(k)
    for t in range(samples):
        m = min(t, last)
        for j in range(k):
            nu[j] = x[t, j]
        for i in range(n):
            ci = c[i]
            if ci != 0.0:
                for j in range(k):
                    nu[j] -= ci * state[i, j]
        inverse = 1.0 / scales[m]
        for j in range(k):
            out[t, j] = nu[j] * inverse
        for i in range(n):
            g = gains[m, i]
            for j in range(k):
                following[i, j] = g * nu[j]
            for q in range(n):
                aiq = a[i, q]
                if aiq != 0.0:
                    for j in range(k):
                        following[i, j] += aiq * state[q, j]
        for i in range(n):
            for j in range(k):
                state[i, j] = following[i, j]
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _innovations_of_one(a, c, gains, scales, x):  # type: ignore[no-untyped-def]
    """`_innovations` of one signal x (N,)."""
    n, samples = a.shape[0], x.shape[0]
    out = np.empty(samples)
    state, following = np.zeros(n), np.empty(n)
    last = len(scales) - 1
    for t in range(samples):
        m = min(t, last)
        nu = x[t]
        for i in range(n):
            nu -= c[i] * state[i]
        out[t] = nu / scales[m]
        for i in range(n):
            value = gains[m, i] * nu
            for q in range(n):
                value += a[i, q] * state[q]
            following[i] = value
        for i in range(n):
            state[i] = following[i]
    return out


def _stationary(a: Array, inward: Array) -> Array:
    """S (n, n), S S' the sum of A^k F F' A'^k, by doubling: no linear system of n^2 unknowns, so scales do
    not matter."""
    root, power = _compact(inward), a
    for _ in range(40):
        more = power @ root
        size = np.sum(root**2, axis=1)
        root = _compact(np.hstack([root, more]))
        power = power @ power
        if np.all(np.sum(more**2, axis=1) <= 1e-13 * size):
            break
    return root


def _compact(root: Array) -> Array:
    """(n, n) of the same covariance as root (n, k)."""
    n, k = root.shape
    wide = np.hstack([root, np.zeros((n, max(n - k, 0)))])
    _lower(wide)
    return wide[:, :n]


def _root(covariance: Array) -> Array:
    """S with S S' = covariance, of whatever scales and whatever rank."""
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    return unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


@dataclass(frozen=True)
class Whitener:
    """Turns a residual of y into white noise of unit variance where the model is right."""

    a: Array
    c: Array
    gains: Array
    scales: Array
    usual: Whitener | None = None  # where samples were lost: the same had none been

    @classmethod
    def of(
        cls,
        loop: Loop,
        noise: Noise,
        start: Array | None = None,
        steps: int = MOST_STEPS,
        lost: Array | None = None,
    ) -> Whitener:
        """`start` (n, n): covariance of what is not known of the loop's state at the start; `lost` (N,):
        which samples of a recording its sensor could not show."""
        system, step = loop.system, loop.system.sample_time
        n = system.order
        force, sensor = system.b[:, 2], system.b[:, 3]
        through = system.d[0, 2]
        ar = np.exp(-2 * np.pi * np.array([noise.sensor_corner, noise.force_corner]) * step)
        sizes = np.array([noise.sensor_coloured, noise.force_coloured])
        a = np.zeros((n + 2, n + 2))
        a[:n, :n] = system.a
        a[:n, n], a[:n, n + 1] = sensor, force
        a[n, n], a[n + 1, n + 1] = ar
        c = np.concatenate([system.c[0], [1.0, through]])
        inward, outward = np.zeros((n + 2, 4)), np.zeros(4)
        inward[:n, 0], outward[0] = noise.force * force, noise.force * through
        inward[:n, 1], outward[1] = noise.sensor * sensor, noise.sensor
        inward[[n, n + 1], [2, 3]] = sizes * np.sqrt(1.0 - ar**2)
        # Output units may be 1e-6 of a metre: scale so that the recursion works near one.
        size = float(np.linalg.norm(outward))
        root = _stationary(a, inward / size)
        if start is not None:
            doubt = np.zeros((n + 2, n))
            doubt[:n] = _root(start) / size
            root = _compact(np.hstack([root, doubt]))
        parts = a, c, inward / size, outward / size
        # Copies have one layout; of a second the recursion would be compiled anew.
        gains, scales = _riccati(*parts, root.copy(), steps, np.zeros(0, bool))
        usual = cls(a, c, gains, scales * size)
        if lost is None:
            return usual
        gains, scales = _riccati(*parts, root.copy(), len(lost), lost)
        return cls(a, c, gains, scales * size, usual)

    def __call__(self, columns: Array) -> Array:
        """Whitened `columns`, (N,) or (N, k), of one recording."""
        table = np.ascontiguousarray(columns, float)
        if table.ndim == 1:
            return _innovations_of_one(self.a, self.c, self.gains, self.scales, table)
        return _innovations(self.a, self.c, self.gains, self.scales, table)

    @property
    def steady(self) -> Whitener:
        """As it is long after the start, whose doubt then hides nothing, nothing lost."""
        whole = self.usual or self
        return replace(whole, gains=whole.gains[-1:], scales=whole.scales[-1:])

    def log_scale(self, n: int) -> float:
        """Sum of the logarithms of the first `n` scales: the likelihood's determinant."""
        m = len(self.scales)
        seen = np.isfinite(self.scales)  # what is lost says nothing
        logs = np.log(np.where(seen, self.scales, 1.0))
        return float(logs[:n].sum() + max(0, n - m) * logs[-1])

    def impulse(self, n: int) -> Array:
        """First `n` samples of the steady filter's impulse response."""
        x = np.zeros((n, 1))
        x[0] = 1.0
        return self.steady(x)[:, 0]

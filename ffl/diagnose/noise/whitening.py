"""Exact whitening of y's residual: the innovations of a Kalman filter for closed-loop noise.

The residual y - yhat of a right model is the loop's answer to force and sensor noise. A Kalman
filter of that answer turns it into white noise of unit variance, from the first sample on (the
covariance starts at what the noise leaves in a running loop plus what is not known of the start);
the log of its scales completes the Gaussian likelihood.
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
def _riccati(a, c, q, s, r, p, steps):  # type: ignore[no-untyped-def]
    """Gains (m, n) and scales (m,) until steady; x+ = A x + w, e = C x + v, cov (w, v) = (q, s; r)."""
    n = a.shape[0]
    gains = np.empty((steps, n))
    scales = np.empty(steps)
    used = 0
    for t in range(steps):
        pc = p @ c
        variance = c @ pc + r
        gain = (a @ pc + s) / variance
        gains[t] = gain
        scales[t] = np.sqrt(variance)
        used = t + 1
        if t > 0:
            change = np.abs(gain - gains[t - 1]).max()
            if (
                change <= SETTLED * np.abs(gain).max()
                and abs(scales[t] - scales[t - 1]) <= SETTLED * scales[t]
            ):
                break
        p = a @ p @ a.T + q - np.outer(gain, gain) * variance
        p = 0.5 * (p + p.T)
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


def _stationary(a: Array, q: Array) -> Array:
    """Sum of A^k Q A'^k by doubling: no linear system of n^2 unknowns, so scales do not matter."""
    p, power = q, a
    for _ in range(40):
        change = power @ p @ power.T
        p = p + change
        power = power @ power
        if np.all(np.abs(change) <= 1e-13 * np.sqrt(np.outer(np.diag(p), np.diag(p)))):
            break
    return p


@dataclass(frozen=True)
class Whitener:
    """Turns a residual of y into white noise of unit variance where the model is right."""

    a: Array
    c: Array
    gains: Array
    scales: Array

    @classmethod
    def of(cls, loop: Loop, noise: Noise, start: Array | None = None, steps: int = MOST_STEPS):
        """`start` (n, n): covariance of what is not known of the loop's state at the start."""
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
        g_force, g_sensor = np.append(force, [0.0, 0.0]), np.append(sensor, [0.0, 0.0])
        q = noise.force**2 * np.outer(g_force, g_force)
        q += noise.sensor**2 * np.outer(g_sensor, g_sensor)
        q[n, n] += sizes[0] ** 2 * (1 - ar[0] ** 2)
        q[n + 1, n + 1] += sizes[1] ** 2 * (1 - ar[1] ** 2)
        s = noise.sensor**2 * g_sensor + noise.force**2 * through * g_force
        r = noise.sensor**2 + (noise.force * through) ** 2
        p = _stationary(a, q)
        if start is not None:
            p[:n, :n] += start
        # Output units may be 1e-6 of a metre: scale so that the recursion works near one.
        gains, scales = _riccati(a, c, q / r, s / r, 1.0, p / r, steps)
        return cls(a, c, gains, scales * np.sqrt(r))

    def __call__(self, columns: Array) -> Array:
        """Whitened `columns`, (N,) or (N, k), of one recording."""
        table = np.ascontiguousarray(columns, float)
        if table.ndim == 1:
            return _innovations_of_one(self.a, self.c, self.gains, self.scales, table)
        return _innovations(self.a, self.c, self.gains, self.scales, table)

    @property
    def steady(self) -> Whitener:
        """As it is long after the start, whose doubt then hides nothing."""
        return replace(self, gains=self.gains[-1:], scales=self.scales[-1:])

    def log_scale(self, n: int) -> float:
        """Sum of the logarithms of the first `n` scales: the likelihood's determinant."""
        m = len(self.scales)
        logs = np.log(self.scales)
        return float(logs[:n].sum() + max(0, n - m) * logs[-1])

    def impulse(self, n: int) -> Array:
        """First `n` samples of the steady filter's impulse response."""
        x = np.zeros((n, 1))
        x[0] = 1.0
        last = len(self.scales) - 1
        return _innovations(self.a, self.c, self.gains[last:], self.scales[last:], x)[:, 0]

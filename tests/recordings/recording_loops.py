"""A made-up tracking loop, sound and with sticking."""

from __future__ import annotations

import numpy as np

from ffl.recordings import Recording


def move(n: int, span: float = 0.1) -> np.ndarray:
    """There and back, at rest at both ends, jerk-limited."""
    s = np.clip(np.linspace(-0.3, 1.3, n // 2), 0, 1)
    up = span * s**3 * (10 - 15 * s + 6 * s**2)
    return np.concatenate([up, up[::-1], np.zeros(n - 2 * (n // 2))])


def loop(
    rng: np.random.Generator,
    n: int = 4000,
    step: float = 1e-6,
    noise: float = 2e-6,
    friction: float = 0.0,
    limit: float = np.inf,
    feedforward: bool = True,
    reference: np.ndarray | None = None,
) -> Recording:
    """Mass 2 under a PD controller with acceleration feedforward; quantised encoder.

    Friction is Coulomb's, sticking exactly at zero velocity, as a real machine does; `limit` cuts
    the command off before it is sent and recorded.
    """
    sample_time = 1e-3
    r = move(n) if reference is None else reference
    f = 2.0 * np.gradient(np.gradient(r, sample_time), sample_time) * feedforward
    y, u = np.empty(n), np.empty(n)
    x = v = 0.0
    kicks = noise * rng.standard_normal(n)
    last = kicks[0]
    for k in range(n):
        y[k] = step * np.round((x + kicks[k]) / step) if step else x + kicks[k]
        u[k] = 1800.0 * (r[k] - y[k]) - 60.0 * (y[k] - last) / sample_time + f[k]
        u[k] = np.clip(u[k], -limit, limit)
        last = y[k]
        free = v + sample_time * (u[k] - 4.0 * v) / 2.0
        hold = sample_time * friction / 2.0
        v = np.sign(free) * max(abs(free) - hold, 0.0)
        x += sample_time * v
    return Recording.from_signals(sample_time, y=y, u=u, r=r, f=f, t=sample_time * np.arange(n))

"""References of the challenge: point-to-point moves, scanning, multisine."""

from __future__ import annotations

import numpy as np

KINDS = ("moves", "scanning", "multisine")


def _smooth(x: np.ndarray, n: int) -> np.ndarray:
    """Moving average over n samples, without moving the start before 0."""
    kernel = np.ones(n) / n
    return np.convolve(x, kernel)[: len(x)]


def _stroke(distance: float, speed: float, acceleration: float, step: float) -> np.ndarray:
    """Position samples of one trapezoidal-velocity stroke."""
    d = abs(distance)
    ramp = min(speed / acceleration, np.sqrt(d / acceleration))
    top = acceleration * ramp
    total = d / top + ramp
    t = np.arange(1, int(np.ceil(total / step)) + 1) * step
    t = np.minimum(t, total)
    up = 0.5 * acceleration * np.minimum(t, ramp) ** 2
    even = top * np.clip(t - ramp, 0, total - 2 * ramp)
    down = np.clip(t - (total - ramp), 0, ramp)
    return np.sign(distance) * (up + even + top * down - 0.5 * acceleration * down**2)


def path(
    kind: str,
    n: int,
    sample_time: float,
    stroke: float,
    speed: float,
    acceleration: float,
    hold: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """A path of n samples that rests at 0 for `hold` seconds and stays within the stroke."""
    if kind == "multisine":
        return _multisine(n, sample_time, stroke, speed, acceleration, hold, rng)
    out = [np.zeros(int(hold / sample_time))]
    length, at, side = len(out[0]), 0.0, 1.0
    scan = stroke * rng.uniform(0.5, 0.95)
    while length < n:
        if kind == "scanning":
            # Back and forth over one range at a different constant speed each way.
            target = scan if side > 0 else 0.0
            pace, pause = speed * rng.uniform(0.25, 1.0), rng.uniform(0.02, 0.08)
            side = -side
        else:
            # Back turns as likely as going on, so that reversals happen at many places.
            target = stroke * rng.uniform(0.0, 1.0)
            while abs(target - at) < 0.08 * stroke:
                target = stroke * rng.uniform(0.0, 1.0)
            pace, pause = speed * rng.uniform(0.5, 1.0), rng.uniform(0.05, 0.4)
        part = at + _stroke(target - at, pace, acceleration, sample_time)
        part = np.concatenate([part, np.full(int(pause / sample_time), target)])
        at = target
        out.append(part)
        length += len(part)
    jerk = max(2, round(rng.uniform(0.02, 0.06) / sample_time))
    return _smooth(np.concatenate(out)[:n], jerk)


def _multisine(
    n: int,
    sample_time: float,
    stroke: float,
    speed: float,
    acceleration: float,
    hold: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """Random-phase sines whose range, speed and acceleration stay within what was asked."""
    t = np.arange(n) * sample_time
    low = 1.0 / (n * sample_time)
    f = low * np.arange(2, int(rng.uniform(3.0, 8.0) / low))
    size = 1.0 / (1.0 + (f / rng.uniform(0.6, 1.5)) ** 2)
    phase = rng.uniform(0, 2 * np.pi, len(f))
    x = size @ np.sin(2 * np.pi * np.outer(f, t) + phase[:, None])
    start = int(hold / sample_time)
    fade = int(0.4 / sample_time)
    window = np.zeros(n)
    window[start:] = 1.0
    window[start : start + fade] = np.sin(0.5 * np.pi * np.arange(fade) / fade) ** 2
    x = x * window
    v = np.gradient(x, sample_time)
    a = np.gradient(v, sample_time)
    return x * min(
        0.5 * stroke / np.abs(x).max(), speed / np.abs(v).max(), acceleration / np.abs(a).max()
    )


def injection(
    n: int, sample_time: float, top: float, hold: float, rng: np.random.Generator
) -> np.ndarray:
    """A multisine of unit RMS up to `top` Hz, switched on after the hold."""
    low = 1.0 / (n * sample_time)
    f = low * np.arange(max(2, int(0.5 / low)), int(top / low), 3)
    t = np.arange(n) * sample_time
    x = np.sin(2 * np.pi * np.outer(f, t) + rng.uniform(0, 2 * np.pi, (len(f), 1))).sum(axis=0)
    x *= np.sqrt(2.0 / len(f))
    start = int(hold / sample_time)
    x[:start] = 0.0
    return x

"""Where maps live: the ranges of a motion's signals, grids over them, and what lies between their knots."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ffl.diagnose.maps.histories import Ranges
from ffl.effects import Motion
from ffl.systems.state_space import Array

MOMENTS = 25  # knots of a map of the time: slower than what moves
RARE = 0.001  # of the samples, that one side of the accelerations may lie beyond their grid


def ranges_of(motions: Sequence[Motion]) -> dict[str, tuple[float, float]]:
    """Least and greatest of each signal over the recordings; 'step' and 'time' for histories."""
    out = {}
    for name in ("x", "v", "a", "u"):
        joined = np.concatenate([getattr(m, name) for m in motions])
        rare = RARE if name == "a" else 0.0  # a knock or a kink is no range
        low, high = np.quantile(joined, [rare, 1.0 - rare])
        out[name] = (float(low), float(high))
    for name in motions[0].others:
        joined = np.concatenate([m.others[name] for m in motions])
        out[name] = (float(joined.min()), float(joined.max()))
    step = motions[0].sample_time
    out["step"] = (step, max(len(m.t) for m in motions) * step)
    return out


def even(name: str, k: int) -> Callable[[Ranges], Array]:
    return lambda ranges: np.linspace(*ranges[name], k)


def top_speed(ranges: Ranges) -> float:
    return max(abs(v) for v in ranges["v"]) or 1e-300


def warped(v: Array, ranges: Ranges) -> Array:
    return np.arcsinh(v / (0.02 * top_speed(ranges)))


def velocities(ranges: Ranges) -> Array:
    edge = np.arcsinh(50.0)
    return 0.02 * top_speed(ranges) * np.sinh(np.linspace(-edge, edge, 41))


def accelerations(ranges: Ranges) -> Array:
    top = max(abs(a) for a in ranges["a"]) or 1e-300
    return np.linspace(-top, top, 17)


def speeds(ranges: Ranges) -> Array:
    return np.linspace(0.0, top_speed(ranges), 15)


def moments(ranges: Ranges) -> Array:
    return np.linspace(0.0, ranges["step"][1], MOMENTS)


def hats(x: Array, grid: Array) -> Array:
    """(N, k): linear interpolation weights of x on the grid, going on straight beyond its ends by a
    quarter of its extent at most."""
    k = len(grid)
    at = np.clip(np.searchsorted(grid, x, side="right") - 1, 0, k - 2)
    reach = 0.25 * (grid[-1] - grid[0])
    inside = np.clip(x, grid[0] - reach, grid[-1] + reach)
    share = (inside - grid[at]) / np.maximum(grid[at + 1] - grid[at], 1e-300)
    out = np.zeros((len(x), k))
    rows = np.arange(len(x))
    out[rows, at] = 1.0 - share
    out[rows, at + 1] += share
    return out


def interpolated(x: Array, grid: Array, values: Array) -> Array:
    """hats(x, grid) @ values."""
    reach = 0.25 * (grid[-1] - grid[0])
    x = np.clip(x, grid[0] - reach, grid[-1] + reach)
    first, last = (
        np.diff(values[part]) / np.diff(grid[part]) for part in (slice(2), slice(-2, None))
    )
    beyond = np.minimum(x - grid[0], 0.0) * first[0] + np.maximum(x - grid[-1], 0.0) * last[0]
    return np.interp(x, grid, values) + beyond

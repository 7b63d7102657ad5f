"""Margins of a loop gain: where it crosses the unit circle and the negative real axis, to rounding."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ffl.systems.state_space import Array, ComplexArray

HALVINGS = 60  # of a grid interval, down to rounding
RANGE = 1e9  # beyond it, or below its inverse, |L| is that of a pole or zero on the unit circle

Response = Callable[[Array], ComplexArray]


@dataclass(frozen=True)
class Margins:
    """How far L = P C_y may change before the loop loses its stability; frequencies in Hz.

    `gain`: factor (> 1) by which it may grow, inf where any, at `gain_frequency`. `gain_reduction`:
    factor (< 1) to which it may fall, 0 where it may vanish, at `gain_reduction_frequency`. `phase`:
    the smallest |180 deg + arg L| over all frequencies of |L| = 1, and `crossover` the one where it
    is. `modulus`: 1/max|S|.
    """

    gain: float
    phase: float
    modulus: float
    crossover: float
    gain_frequency: float = 0.0
    gain_reduction: float = 0.0
    gain_reduction_frequency: float = 0.0


def margins_of(loop: Response, frequencies: Array, ends: tuple[Array, ComplexArray]) -> Margins:
    """Margins of `loop`, L at frequencies in Hz, found on the grid `frequencies` and refined by halving
    between its points; `ends` are frequencies where L is real, and L there."""
    f, gain = frequencies, loop(frequencies)
    crossings = _roots(loop, f, gain, lambda g: np.log(np.abs(g)))
    phases = np.degrees(np.abs(np.angle(-loop(crossings))))
    real = _roots(loop, f, gain, lambda g: g.imag)
    at = np.concatenate([real, ends[0]])
    values = np.concatenate([loop(real), ends[1]]).real
    kept = (values < 0) & (np.abs(values) < RANGE) & (np.abs(values) > 1 / RANGE)
    at, factors = at[kept], -1.0 / values[kept]
    up, down = factors > 1, factors < 1
    worst = int(np.argmin(phases)) if phases.size else 0
    return Margins(
        float(factors[up].min(initial=np.inf)),
        float(phases.min(initial=np.inf)),
        _least(lambda x: np.abs(1.0 + loop(x)), f, np.abs(1.0 + gain)),
        float(crossings[worst]) if phases.size else 0.0,
        float(at[up][np.argmin(factors[up])]) if up.any() else 0.0,
        float(factors[down].max(initial=0.0)),
        float(at[down][np.argmax(factors[down])]) if down.any() else 0.0,
    )


def _roots(
    loop: Response, f: Array, gain: ComplexArray, of: Callable[[ComplexArray], Array]
) -> Array:
    """Where `of`(L) changes its sign: all intervals of the grid are halved at a time."""
    sign = np.sign(of(gain))
    first = np.flatnonzero(np.diff(sign))
    low, high, below = f[first], f[first + 1], sign[first]
    for _ in range(HALVINGS if first.size else 0):
        middle = 0.5 * (low + high)
        same = np.sign(of(loop(middle))) == below
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return 0.5 * (low + high)


def _least(of: Callable[[Array], Array], f: Array, values: Array) -> float:
    """The minimum near the grid's, on ever finer grids."""
    k = int(np.argmin(values))
    low, high, least = f[max(k - 1, 0)], f[min(k + 1, len(f) - 1)], float(values[k])
    for _ in range(6):
        fine = np.linspace(low, high, 41)
        found = of(fine)
        k = int(np.argmin(found))
        low, high, least = fine[max(k - 1, 0)], fine[min(k + 1, 40)], min(least, float(found[k]))
    return least

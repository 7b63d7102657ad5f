"""The signs that a sensor of |y| has lost, as the machine's own motion tells them.

Noise that shakes a machine changes its sign with the output, and no filter whitens what is left of |y|. But
a machine with mass does not turn back within a sample. Of all paths s_k = +1 or -1 the least

    sum over k of e_k^2,   e = A(z) s y - B(z) u,   B/A the linear model,

is its output before the sensor: by dynamic programming over the signs of the last n samples, n the order of
A, so that no path is left out. What force noise does to such a path is white, as large where it passes zero
as elsewhere; a wrong sign leaps by twice what a sample moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.signal
from numba import njit

from ffl.recordings import Recording
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array
from ffl.systems.zpk import as_zpk

MOST = 6  # poles: twice as many sums of squares are kept with each, and polynomials stay exact
BELOW = 0.03  # of the range: how far a folded output may fall below zero, or a drive by rounding
NEAR = 0.05  # of the range: how near to zero it must come
TOUCHES = 3
FALLS = 0.5  # of the sum of squares of e: what signs leave at most
LEAPS = 8.0  # times the RMS of e: a path that leaps so far was not read


def looks_folded(plant: Plant, recordings: Sequence[Recording]) -> bool:
    """Open loop, a drive of both signs, and every output turns back at zero again and again."""
    return _may_be_folded(plant, recordings) and min(map(_touches, recordings)) >= TOUCHES


def _may_be_folded(plant: Plant, recordings: Sequence[Recording]) -> bool:
    """Open loop, a drive of both signs, and an output of one."""
    if plant.controller is not None or not all(np.all(np.isfinite(r.u)) for r in recordings):
        return False
    if any(r.y.min() < -BELOW * float(r.y.max()) for r in recordings):
        return False
    return any(r.u.min() < -BELOW * np.abs(r.u).max() < 0.0 < r.u.max() for r in recordings)


def _touches(r: Recording) -> int:
    """How often the output comes near to zero."""
    return int(np.count_nonzero(np.diff((r.y < NEAR * float(r.y.max())).astype(int)) == 1))


def unfolded(plant: Plant, recordings: Sequence[Recording]) -> list[Recording] | None:
    """`recordings` with the signs of their y; None where they cannot be folded, where those of one cannot
    be read, or do not explain most of what the linear model cannot without."""
    if not _may_be_folded(plant, recordings) or not 1 <= len(plant.system.poles) <= MOST:
        return None
    if sum(map(_touches, recordings)) < TOUCHES:
        return None
    out, with_signs, without = [], 0.0, 0.0
    for r in recordings:
        bottom, driven = _equation(plant, r.u if r.d is None else r.u + r.d)
        signs = _best(np.asarray(r.y, float), bottom, driven)
        left, whole = _left(bottom, driven, signs * r.y), _left(bottom, driven, r.y)
        if np.abs(left).max() > LEAPS * np.sqrt(np.mean(left**2)):
            return None
        with_signs, without = with_signs + float(left @ left), without + float(whole @ whole)
        out.append(replace(r, y=signs * r.y))
    return out if with_signs < FALLS * without else None


def _equation(plant: Plant, u: Array) -> tuple[Array, Array]:
    """(A (n + 1,), B(z) u (N,)) of the plant; its order is low, and its polynomials exact."""
    system = as_zpk(plant.system)
    bottom = np.real(np.poly(system.poles))
    top = system.gain * np.real(np.atleast_1d(np.poly(system.zeros)))
    top = np.append(np.zeros(len(bottom) - len(top)), top)
    return bottom, scipy.signal.lfilter(top, [1.0], u)


def _left(bottom: Array, driven: Array, y: Array) -> Array:
    """e of the output y (N,), from the first sample with all of its past, (N - n,)."""
    return (scipy.signal.lfilter(bottom, [1.0], y) - driven)[len(bottom) - 1 :]


@njit(error_model="numpy")
def _best(y, bottom, driven):  # type: ignore[no-untyped-def]
    """Signs (N,) of the path with the least sum of squares; bit j of a state is the sign j samples ago."""
    n, order = len(y), len(bottom) - 1
    states = 1 << order
    cost, new = np.zeros(states), np.zeros(states)
    forgotten = np.zeros((n, states), np.uint8)  # sign of the sample that left the state
    for k in range(order, n):
        for after in range(states):
            now = y[k] if after & 1 else -y[k]
            shared = now - driven[k]
            for j in range(1, order):
                shared += bottom[j] * (y[k - j] if (after >> j) & 1 else -y[k - j])
            last = bottom[order] * y[k - order]
            below, above = cost[after >> 1], cost[(after >> 1) | (states >> 1)]
            below += (shared - last) ** 2
            above += (shared + last) ** 2
            forgotten[k, after] = 1 if above < below else 0
            new[after] = min(below, above)
        least = new.min()
        for i in range(states):
            cost[i] = new[i] - least
    signs = np.ones(n)
    at = int(np.argmin(cost))
    for k in range(n - 1, order - 1, -1):
        signs[k] = 1.0 if at & 1 else -1.0
        at = (at >> 1) | (int(forgotten[k, at]) << (order - 1))
    for k in range(order - 1, -1, -1):
        signs[k] = 1.0 if at & 1 else -1.0
        at >>= 1
    return signs

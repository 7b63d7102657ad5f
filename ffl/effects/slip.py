"""Dry friction of many contacts that give way one after the other: the Maxwell slip (Iwan) model.

Elastic elements in parallel, each of which slides at a force of its own (Iwan 1966; Lampaert,
Al-Bender, Swevers 2003, "generalised Maxwell slip" at a constant level). Unlike one bristle they
remember where the motion turned back: a reversal starts again at the full stiffness (Masing's rule,
one bristle shows twice of it from its limit) and a closed loop returns to where it began.

Loaded from rest the contact follows level (1 - exp(-stiffness x/level)), as one bristle does, by a
polygon: element i carries the share w_i of the stiffness and slides at u_i level/stiffness, where
w_i, u_i are the mass and the mean of the exponential density within bin i, and the bins are such that
the polygon stays within 0.5 % of the level. Sum w_i = sum w_i u_i = 1: stiffness at rest and level in
sliding are exact.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ffl.effects.law import COMMIT, GX, GX_SLOPE, STEP, X0, X1
from ffl.effects.solve import set_curve
from ffl.systems.state_space import Array

ELEMENTS = 10


def _elements() -> tuple[Array, Array]:
    """(w, u): bins end where exp(-x/2) falls by equal steps, for an equal error in each."""
    ends = np.linspace(1.0, 0.0, ELEMENTS + 1) ** 2  # exp(-x)
    weights = ends[:-1] - ends[1:]
    lengths = -np.log(np.where(ends > 0, ends, 1.0))
    moments = (1.0 + lengths) * ends
    return weights, (moments[:-1] - moments[1:]) / weights


WEIGHTS, YIELDS = _elements()


@njit(error_model="numpy")
def _stretched(s, move, plus, minus):  # type: ignore[no-untyped-def]
    """Mean deflection after the displacement `move` and the share of the stiffness that still
    sticks; `plus`, `minus`: mean deflection in sliding in either direction."""
    mean, sticking = 0.0, 0.0
    for i in range(ELEMENTS):
        z, high, low = s[i] + move, YIELDS[i] * plus, -YIELDS[i] * minus
        if z >= high:
            z = high
        elif z <= low:
            z = low
        else:
            sticking += WEIGHTS[i]
        mean += WEIGHTS[i] * z
    return mean, sticking


@njit(error_model="numpy")
def set_slip(io, s, plus, minus, stiffness, damping):  # type: ignore[no-untyped-def]
    """F = -(stiffness z + damping dz/dt), z the mean deflection of the elements; dz_i/dt = v as long
    as |z_i| is below its limit or shrinks, else 0.

    s: deflections, mean deflection at the end (iterate). The elements follow the displacement exactly;
    the mean at the end is the root of a monotone polygon (Newton within a bracket), the damping that
    of the mean rate.
    """
    up, down = plus / stiffness, minus / stiffness
    if io[COMMIT] != 0.0:
        move = io[X1] - io[X0]
        for i in range(ELEMENTS):
            s[i] = min(max(s[i] + move, -YIELDS[i] * down), YIELDS[i] * up)
        return
    start = 0.0
    for i in range(ELEMENTS):
        start += WEIGHTS[i] * s[i]
    rate = damping / io[STEP]
    # Displacement = free - g z: the end without this force, and what z there takes off it.
    free = io[X1] - io[X0] - start * (0.5 * stiffness * (io[GX] - io[GX_SLOPE]) - rate * io[GX])
    g = 0.5 * stiffness * (io[GX] + io[GX_SLOPE]) + rate * io[GX]
    low, high = -down, up
    z = min(max(s[ELEMENTS], low), high)
    for _ in range(60):
        wanted, sticking = _stretched(s, free - g * z, up, down)
        error = z - wanted
        if error > 0.0:
            high = z
        else:
            low = z
        following = z - error / (1.0 + max(g, 0.0) * sticking)
        if abs(following - z) <= 1e-13 * (up + down):
            z = following
            break
        z = following if low < following < high else 0.5 * (low + high)
    s[ELEMENTS] = z
    set_curve(io, -stiffness * start, -stiffness * z, -rate * (z - start))


def carried(travel: float, displacement: float) -> Array:
    """Deflections after a `travel` in one direction from an unloaded contact, (ELEMENTS,)."""
    limits = YIELDS * displacement
    return np.clip(travel, -limits, limits)


@njit(cache=True, error_model="numpy")
def _path(x, displacement, s, z):  # type: ignore[no-untyped-def]
    for k in range(1, len(x)):
        mean = 0.0
        for i in range(ELEMENTS):
            limit = YIELDS[i] * displacement
            s[i] = min(max(s[i] + x[k] - x[k - 1], -limit), limit)
            mean += WEIGHTS[i] * s[i]
        z[k] = mean / displacement


def slip(x: Array, displacement: float) -> Array:
    """Force over level along the positions `x` from an unloaded contact; `displacement` is
    level/stiffness."""
    z = np.zeros(len(x))
    _path(np.ascontiguousarray(x, float), displacement, np.zeros(ELEMENTS), z)
    return z

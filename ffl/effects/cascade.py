"""Tanks in a row, ovens and the like: a plant of one or two real lags as stages with levels.

Two lags in a row, each with gain 1, are in the units of y

    dx1/dt = a1 (w - q1),    dx2/dt = a2 (q1 - q2),    y = x2,    q1 = x1, q2 = x2,

with w the inflow that the command makes, levels x1, x2 and flows q1, q2; standing still, all four are
equal. The plant says which rates there are, not which of them belongs to the upper stage. That stage
is named by its lag, "slow" or "fast", and so are the points:

slow, fast               the flow from the upper stage into the lower one: what flows beyond x1
                         leaves the upper stage, and a share of it (1 where none is given) arrives;
                         its position is x1
after_slow, after_fast   the flow out of the lower stage, whose upper stage is the slow or the fast
                         lag; its position is x2. With one lag alone, after_slow is its outflow.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ffl.effects.point import Point
from ffl.errors import InputError
from ffl.systems.state_space import Array

if TYPE_CHECKING:
    from ffl.effects.mechanics import Mechanics

BETWEEN, OUT = ("slow", "fast"), ("after_slow", "after_fast")
SLOWEST = 3e-4  # per sample: a slower lag is as good as an integrator
REAL = 1e-6  # of a rate: imaginary part that is rounding (a double pole)


def lags(mechanics: Mechanics) -> Array:
    """The rates (1/s) of a plant that is one real lag or two and nothing else, slowest first; empty
    for any other plant: one that integrates, that resonates, whose output is a speed, with a part
    that follows at once or with more states."""
    m = mechanics.origin or mechanics
    if m.place is not None or m.fast.order or m.d != 0.0 or m.order not in (1, 2):
        return np.zeros(0)
    rates = -np.linalg.eigvals(m.a)
    if np.abs(rates.imag).max() > REAL * np.abs(rates).max():
        return np.zeros(0)
    real = np.sort(rates.real)
    return real if real[0] * m.sample_time > SLOWEST else np.zeros(0)


def stage_point(mechanics: Mechanics, side: str, share: float | None = None) -> Point:
    """The point `side` of the cascade (see above), or `InputError` where the plant is none."""
    rates = lags(mechanics)
    between = side in BETWEEN
    if len(rates) < 1 + between or (len(rates) == 1 and side == "after_fast"):
        raise InputError(
            f"side = '{side}' asks for a plant of {'two real lags' if between else 'real lags'} in a "
            "row; this one is another"
        )
    a, c, order = mechanics.a, mechanics.c, mechanics.order
    if order == 1:
        return Point(-rates[0] / c, c, c @ a)
    first, second = rates if side.endswith("slow") else rates[::-1]
    upper = (c @ a + second * c) / second
    into = np.linalg.inv(np.vstack([upper, c]))  # columns: a unit more of x1, of x2
    if between:
        force = -first * into[:, 0] + (1.0 if share is None else share) * second * into[:, 1]
        return Point(force, upper, upper @ a)
    return Point(-second * into[:, 1], c, c @ a)

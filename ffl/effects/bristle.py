"""Dry friction whose contact gives way elastically before it slides, with a level of its own in either
direction: the bristle of LuGre (Canudas de Wit et al. 1995) without the Stribeck effect."""

from __future__ import annotations

import numpy as np
from numba import njit

from ffl.effects.law import COMMIT, FIRST, V0, X0, X1
from ffl.effects.paths import bouc_wen_step
from ffl.effects.solve import end_motion, set_line


@njit(error_model="numpy")
def _stretched(z0, move, plus, minus):  # type: ignore[no-untyped-def]
    """z after the displacement `move` and dz/dmove; `plus`, `minus`: its limits in either direction.

    Exact for a velocity that keeps its sign.
    """
    limit = plus if move >= 0.0 else -minus
    decay = np.exp(-abs(move / limit))
    return limit + (z0 - limit) * decay, (1.0 - z0 / limit) * decay


@njit(error_model="numpy")
def set_bristle(io, s, plus, minus, stiffness, damping):  # type: ignore[no-untyped-def]
    """F = -(stiffness z + damping dz/dt), dz/dt = v - |v| z stiffness/level(direction).

    s: z, force at the start, force at the end (iterate). The end force is the root of a monotone
    function of one unknown (Newton within a bracket).
    """
    up, down = plus / stiffness, minus / stiffness
    if io[COMMIT] != 0.0:
        s[0], _ = _stretched(s[0], io[X1] - io[X0], up, down)
        return
    z0, v0 = s[0], io[V0]
    if io[FIRST] != 0.0:
        s[1] = -(stiffness * z0 + damping * v0 * (1.0 - z0 / (up if v0 >= 0.0 else -down)))
    xa, gx, va, gv = end_motion(io, s[1], 0.0)
    scale = max(plus, minus)
    most = 2.0 * (scale + damping * (abs(va) + abs(v0)) + abs(s[1]))
    low, high, force = -most, most, min(max(s[2], -most), most)
    for _ in range(60):
        move, v1 = xa + gx * force - io[X0], va + gv * force
        z1, slope = _stretched(z0, move, up, down)
        limit = up if v1 >= 0.0 else -down
        share = 1.0 - z1 / limit
        wanted = -(stiffness * z1 + damping * v1 * share)
        rate = -(stiffness - damping * v1 / limit) * slope * gx - damping * share * gv
        error = force - wanted
        if error > 0.0:
            high = force
        else:
            low = force
        following = force - error / (1.0 - min(rate, 0.0))
        if abs(following - force) <= 1e-12 * scale:
            force = following
            break
        force = following if low < following < high else 0.5 * (low + high)
    s[2] = force
    set_line(io, s[1], force)


def carried(travel: float, displacement: float) -> float:
    """Deflection after a `travel` in one direction from an unloaded contact; `displacement` is
    level/stiffness."""
    return float(displacement * bouc_wen_step(0.0, travel, displacement, 1.0, 1.0))

"""LuGre friction: the contact gives way elastically before it slides."""

from __future__ import annotations

import numpy as np
from numba import njit

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import COMMIT, FIRST, V0, X0, X1
from ffl.effects.paths import bouc_wen
from ffl.effects.solve import end_motion, set_line
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


@njit(error_model="numpy")
def _bristle(p, z0, move):  # type: ignore[no-untyped-def]
    """z after the displacement `move`, exact for a velocity that keeps its sign, and dz/dmove."""
    limit = p[0] / p[1]
    side = 1.0 if move >= 0.0 else -1.0
    decay = np.exp(-abs(move) / limit)
    return side * limit + (z0 - side * limit) * decay, (1.0 - side * z0 / limit) * decay


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: level, stiffness, micro_damping; s: z, force at the start, force at the end (iterate).

    The end force is the root of a monotone function of one unknown (Newton within a bracket).
    """
    if io[COMMIT] != 0.0:
        s[0], _ = _bristle(p, s[0], io[X1] - io[X0])
        return
    z0, v0 = s[0], io[V0]
    if io[FIRST] != 0.0:
        s[1] = -(p[1] * z0 + p[2] * (v0 - abs(v0) * z0 * p[1] / p[0]))
    xa, gx, va, gv = end_motion(io, s[1], 0.0)
    most = 2.0 * (p[0] + p[2] * (abs(va) + abs(v0)) + abs(s[1]))
    low, high, force = -most, most, min(max(s[2], -most), most)
    for _ in range(60):
        move, v1 = xa + gx * force - io[X0], va + gv * force
        z1, slope = _bristle(p, z0, move)
        share = 1.0 - (1.0 if v1 >= 0.0 else -1.0) * z1 * p[1] / p[0]
        wanted = -(p[1] * z1 + p[2] * v1 * share)
        rate = -(p[1] - p[2] * abs(v1) * p[1] / p[0]) * slope * gx - p[2] * share * gv
        error = force - wanted
        if error > 0.0:
            high = force
        else:
            low = force
        following = force - error / (1.0 - min(rate, 0.0))
        if abs(following - force) <= 1e-12 * p[0]:
            force = following
            break
        force = following if low < following < high else 0.5 * (low + high)
    s[2] = force
    set_line(io, s[1], force)


class PreslidingFriction(Effect):
    """F = -(stiffness z + micro_damping dz/dt), dz/dt = v - |v| z stiffness/level (LuGre without
    Stribeck; Canudas de Wit et al. 1995, equations (1) to (3) with g constant)."""

    name = "presliding_friction"
    parameters = (
        Parameter("level", "F", lower=1e-12),
        Parameter("stiffness", "F/x", lower=1e-12, linear=False),
        Parameter("micro_damping", "F s/x", linear=False, default=0.0),
    )
    depends_on = ("direction", "history", "position")
    siblings = ("coulomb_friction", "hysteresis", "stribeck_friction")
    law = staticmethod(_law)
    remembers = True

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0, 0.0, 0.0]

    def stiffness(self, packed):  # type: ignore[no-untyped-def]
        return packed[1]

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        return [{"displacement": float(d)} for d in motion.span * np.geomspace(1e-5, 2.5e-2, 8)]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        """-z stiffness/level along the path; `displacement` is level/stiffness."""
        return np.column_stack([-bouc_wen(motion.x, nonlinear["displacement"], 1.0, 1.0)])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        level = max(float(coefficients[0]), 1e-12)
        return {
            "level": level,
            "stiffness": level / nonlinear["displacement"],
            "micro_damping": 0.0,
        }

    def nonlinear_of(self, values: Parameters) -> dict[str, float]:
        return {"displacement": values["level"] / values["stiffness"]}

    def says(self, values: Parameters, plant: Plant) -> str:
        give = values["level"] / values["stiffness"]
        return (
            f"Friction of {self.quantity(values, 'level', plant)} gives way elastically over about "
            f"{give:.3g} {plant.output_unit} before it slides (presliding)."
        )

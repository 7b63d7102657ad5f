"""Friction that grows in proportion to speed at first and with its logarithm above.

Belts, rubber, polymers and boundary films slide by shear that heat and stress activate together
(Prandtl 1928, Eyring 1936): a jump over a barrier is easier with the stress by as much as it is harder
against it, so that v = velocity sinh(F/level). Turned round, that is the law below. Each factor e of
speed adds `level`; at standstill nothing holds.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import GV, GX, STEP, V0, X0
from ffl.effects.solve import bulge_of, end_motion, set_curve
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

SHARES = np.geomspace(0.01, 0.5, 6)  # of the largest speed: where proportion ends


@njit(error_model="numpy")
def _force(p, v):  # type: ignore[no-untyped-def]
    """(F, dF/dv)."""
    return -p[0] * np.arcsinh(v / p[1]), -p[0] / np.sqrt(p[1] * p[1] + v * v)


@njit(error_model="numpy")
def _end_velocity(p, va, gv):  # type: ignore[no-untyped-def]
    """v1 = va + gv F(v1) by Newton's way from the side of zero: concave in |v|, it does not overshoot."""
    v1 = va / (1.0 + gv * p[0] / p[1])
    for _ in range(50):
        force, slope = _force(p, v1)
        step = (va + gv * force - v1) / (1.0 - gv * slope)
        v1 += step
        if abs(step) <= 1e-14 * abs(v1):
            break
    return v1


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: level, velocity. Newton's way on the bulge of the force between the ends, too: friction this
    steep near standstill makes mere repetition run away."""
    start, _ = _force(p, io[V0])
    end, bulge = start, 0.0
    for _ in range(20):
        xa, gx, va, gv = end_motion(io, start, bulge)
        v1 = _end_velocity(p, va, gv)
        end, end_slope = _force(p, v1)
        half = 1.5 * (xa + gx * end - io[X0]) / io[STEP] - 0.25 * (io[V0] + v1)
        middle, middle_slope = _force(p, half)
        v1_by = io[GV] / (1.0 - gv * end_slope)  # dv1/dbulge, and so on
        end_by = end_slope * v1_by
        half_by = 1.5 * (io[GX] + gx * end_by) / io[STEP] - 0.25 * v1_by
        by = (2.0 * middle_slope * half_by - end_by) / 3.0
        more = (bulge_of(start, middle, end) - bulge) / (1.0 - by)
        bulge += more
        if abs(more) <= 1e-12 * (abs(start) + abs(end)):
            break
    set_curve(io, start, end, bulge)


class LogarithmicFriction(Effect):
    """F = -level arsinh(v/velocity): -(level/velocity) v well below `velocity`, -level sign(v)
    log(2|v|/velocity) well above, between viscous and dry friction."""

    name = "logarithmic_friction"
    parameters = (
        Parameter("level", "F"),
        Parameter("velocity", "x/s", lower=1e-12, linear=False),
    )
    depends_on = ("velocity",)
    siblings = ("coulomb_friction", "viscous_friction", "stribeck_friction")
    ladder = ("velocity", np.geomspace(0.02, 1.0, 7))
    law = staticmethod(_law)

    def rung(self, values: Parameters, name: str, value: float) -> dict[str, Any]:
        """With the force at the proposed velocity as it is: along a motion without friction, too fast,
        the first order proposes too high a one."""
        level = values["level"] * np.arcsinh(1.0) / np.arcsinh(values["velocity"] / value)
        return {"level": float(level), "velocity": value}

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        top = float(np.abs(motion.v).max(initial=0.0))
        return [{"velocity": float(v)} for v in top * SHARES]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        return np.column_stack([-np.arcsinh(motion.v / nonlinear["velocity"])])

    def says(self, values: Parameters, plant: Plant) -> str:
        level = self.quantity(values, "level", plant)
        return (
            f"Friction grows in proportion to speed up to about "
            f"{self.quantity(values, 'velocity', plant)} and by {level} for each factor e above, as that "
            "of belts, rubber and thin films does."
        )

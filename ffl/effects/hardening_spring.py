"""A cubic spring: stiffer the further it is pulled."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import X0
from ffl.effects.solve import end_motion, set_line
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: cubic_coefficient, centre; s: end force (iterate)."""
    away = io[X0] - p[1]
    start = -p[0] * away * away * away
    xa, gx, _, _ = end_motion(io, start)
    force = s[0]
    for _ in range(12):
        away = xa + gx * force - p[1]
        error = force + p[0] * away * away * away
        following = force - error / (1.0 + 3.0 * p[0] * away * away * gx)
        done = abs(following - force) <= 1e-13 * abs(force)
        force = following
        if done:
            break
    s[0] = force
    set_line(io, start, force)


class HardeningSpring(Effect):
    """F = -cubic_coefficient (x - centre)^3."""

    name = "hardening_spring"
    parameters = (
        Parameter("cubic_coefficient", "F/x^3"),
        Parameter("centre", "x", lower=-np.inf, linear=False, default=0.0),
    )
    depends_on = ("position",)
    siblings = ("linear_stiffness", "position_dependent_gain", "sensor_nonlinearity")
    law = staticmethod(_law)
    needs_mass = False

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0]

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        centres = motion.middle + motion.span * np.array([0.0, -0.5, -0.25, 0.25, 0.5])
        return [{"centre": float(c)} for c in np.unique(np.append(centres, 0.0))]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        return np.column_stack([-((motion.x - nonlinear["centre"]) ** 3)])

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"A spring hardens with the cube of the way from "
            f"{self.quantity(values, 'centre', plant)}: "
            f"{self.quantity(values, 'cubic_coefficient', plant)}."
        )

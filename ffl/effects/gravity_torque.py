"""The torque of an arm or of an unbalanced wheel that its own weight pulls down."""

from __future__ import annotations

import math

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import X0
from ffl.effects.solve import bulge_of, end_motion, middle_motion, set_curve
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array

LEAST_TRAVEL = (
    0.5  # rad: over less the pull is that of a spring or a load, to a hundredth of itself
)


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: amplitude, centre; s: end force and bulge (iterates)."""
    start = -p[0] * math.sin(io[X0] - p[1])
    force, bulge = s[0], s[1]
    for _ in range(16):
        xa, gx, va, gv = end_motion(io, start, bulge)
        away = xa + gx * force - p[1]
        error = force + p[0] * math.sin(away)
        change = -error / (1.0 + p[0] * math.cos(away) * gx)
        force += change
        half, _ = middle_motion(io, xa + gx * force, va + gv * force)
        more = bulge_of(start, -p[0] * math.sin(half - p[1]), force) - bulge
        bulge += more
        if abs(change) + abs(more) <= 1e-12 * (abs(start) + abs(force)):
            break
    s[0], s[1] = force, bulge
    set_curve(io, start, force, bulge)


class GravityTorque(Effect):
    """F = -amplitude sin(x - centre), x in rad; `amplitude` is weight times lever (m g l), `centre` the
    angle at which the arm hangs. (A spring has F = -k x at any angle, cogging a period of its own.)"""

    name = "gravity_torque"
    component = "environment"
    parameters = (
        Parameter("amplitude", "F"),
        Parameter("centre", "rad", lower=-np.inf, default=0.0),
    )
    depends_on = ("position",)
    siblings = ("linear_stiffness", "hardening_spring", "constant_load", "cogging")
    law = staticmethod(_law)
    needs_mass = False
    of_angles = True

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0, 0.0]

    def stiffness(self, packed):  # type: ignore[no-untyped-def]
        return float(packed[0])

    def credible(self, spec: EffectSpec, duration: float, travel: float) -> bool:
        return travel > LEAST_TRAVEL

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        """-sin x and cos x: coefficients amplitude cos(centre) and amplitude sin(centre)."""
        return np.column_stack([-np.sin(motion.x), np.cos(motion.x)])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        along, across = (float(c) for c in coefficients)
        return {"amplitude": math.hypot(along, across), "centre": math.atan2(across, along)}

    def coefficients_of(self, values: Parameters) -> Array:
        centre = values["centre"]
        return values["amplitude"] * np.array([math.cos(centre), math.sin(centre)])

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"Gravity turns the axis towards {self.quantity(values, 'centre', plant)}, by "
            f"{self.quantity(values, 'amplitude', plant)} times the sine of the angle from there."
        )

"""The torque of an arm or of an unbalanced wheel that its own weight pulls down."""

from __future__ import annotations

import math

import numpy as np

from ffl.effects.base import Effect, Extent, Motion, Parameter, Parameters, Setting
from ffl.effects.cogging import Cogging
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array

# rad: over less the pull is that of a spring or a load, to a hundredth of itself.
LEAST_TRAVEL = 0.5


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
    law = staticmethod(Cogging.law)
    initial_state = Cogging.initial_state
    stiffness = Cogging.stiffness
    needs_mass = False
    of_angles = True

    def pack(self, values: Parameters, setting: Setting) -> list[float]:
        """As a cogging that repeats every turn: one harmonic of wave number 1, (cos, sin) of its phase."""
        amplitude, centre = super().pack(values, setting)
        return [1.0, 1.0, -amplitude * math.cos(centre), amplitude * math.sin(centre)]

    def credible(self, spec: EffectSpec, extent: Extent) -> bool:
        return extent.travel > LEAST_TRAVEL

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

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
TURN = 2.0 * math.pi


class GravityTorque(Effect):
    """F = -amplitude sin(2 pi (x - centre)/turn); `amplitude` is weight times lever (m g l), `centre` the
    angle at which the arm hangs, `turn` a full turn, 2 pi where x is in rad, 360 in degrees: known, not
    fitted. (A spring has F = -k x at any angle, cogging a period of its own.)"""

    name = "gravity_torque"
    component = "environment"
    parameters = (
        Parameter("amplitude", "F"),
        Parameter("centre", "x", lower=-np.inf, default=0.0),
        Parameter("turn", "x", lower=1e-12, linear=False, default=TURN, known=True),
    )
    depends_on = ("position",)
    siblings = ("linear_stiffness", "hardening_spring", "constant_load", "cogging")
    law = staticmethod(Cogging.law)
    initial_state = Cogging.initial_state
    stiffness = Cogging.stiffness
    needs_mass = False
    of_angles = True

    def pack(self, values: Parameters, setting: Setting) -> list[float]:
        """As a cogging that repeats every turn: one harmonic, (cos, sin) of its phase."""
        amplitude, centre, turn = super().pack(values, setting)
        angle = TURN * centre / turn
        return [TURN / turn, 1.0, -amplitude * math.cos(angle), amplitude * math.sin(angle)]

    def credible(self, spec: EffectSpec, extent: Extent) -> bool:
        turn = float(spec.parameters.get("turn", TURN))
        return TURN * extent.travel / turn > LEAST_TRAVEL

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        return [{"turn": motion.turn}]

    def regressors(self, motion: Motion, turn: float = TURN, **nonlinear: float) -> Array:
        """-sin and cos of the angle: coefficients amplitude cos(centre) and amplitude sin(centre)."""
        angle = TURN * motion.x / turn
        return np.column_stack([-np.sin(angle), np.cos(angle)])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        along, across = (float(c) for c in coefficients)
        turn = float(nonlinear.get("turn", TURN))
        centre = math.atan2(across, along) * turn / TURN
        return {"amplitude": math.hypot(along, across), "centre": centre, "turn": turn}

    def coefficients_of(self, values: Parameters) -> Array:
        centre = TURN * values["centre"] / values["turn"]
        return values["amplitude"] * np.array([math.cos(centre), math.sin(centre)])

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"Gravity turns the axis towards {self.quantity(values, 'centre', plant)}, by "
            f"{self.quantity(values, 'amplitude', plant)} times the sine of the angle from there."
        )

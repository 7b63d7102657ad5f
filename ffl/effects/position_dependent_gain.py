"""A motor whose force per command depends on position."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import MEAN, SLOPE, STEP, V0, X0
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

WEAKEST = 0.1  # of the force per command, that is made good


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: linear_coefficient, quadratic_coefficient, centre. The gain follows the motion at the
    velocity of the start."""
    away = io[X0] - p[2]
    start = 1.0 + p[0] * away + p[1] * away * away
    away += 0.5 * io[STEP] * io[V0]
    half = 1.0 + p[0] * away + p[1] * away * away
    away += 0.5 * io[STEP] * io[V0]
    end = 1.0 + p[0] * away + p[1] * away * away
    mean, slope = (start + 4.0 * half + end) / 6.0, 0.5 * (end - start)
    u, u_slope = io[MEAN], io[SLOPE]
    io[MEAN] = mean * u + slope * u_slope / 3.0
    io[SLOPE] = mean * u_slope + slope * u


class PositionDependentGain(Effect):
    """Force times (1 + linear (x - centre) + quadratic (x - centre)^2)."""

    name = "position_dependent_gain"
    component = "actuator"
    port = "command"
    default_side = "motor"
    parameters = (
        Parameter("linear_coefficient", "1/x", lower=-np.inf, default=0.0),
        Parameter("quadratic_coefficient", "1/x^2", lower=-np.inf, default=0.0),
        Parameter("centre", "x", lower=-np.inf, linear=False, default=0.0),
    )
    depends_on = ("position", "command")
    siblings = ("hardening_spring", "mass_change", "cogging")
    law = staticmethod(_law)

    def order(self, values: Parameters) -> int:
        """Last: it is the motor's, which turns what arrives of a command, late, cut or lagging, into force.
        (With a lag of 7 ms behind it, as the two had been found, a delay was 60 of log-likelihood
        ahead.)"""
        return 1

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        return [{"centre": motion.middle}]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        away = motion.x - nonlinear["centre"]
        return np.column_stack([away * motion.u, away**2 * motion.u])

    def compensated_along(self, values: Parameters) -> dict[str, Any]:
        return dict(values)

    def compensation(self, motion: Motion, **nonlinear: float) -> Array | None:
        """-(x - c) u/k and -(x - c)^2 u/k: weighted with the coefficients, (1/k - 1) u, with
        k = 1 + linear (x - c) + quadratic (x - c)^2 by those coefficients."""
        columns = self.regressors(motion, **nonlinear)
        away = motion.x - nonlinear["centre"]
        gain = 1.0 + nonlinear["linear_coefficient"] * away
        gain += nonlinear["quadratic_coefficient"] * away**2
        # Where the motor has no force left, none can be asked for.
        return -columns / np.maximum(gain, WEAKEST)[:, None]

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            "The force per command depends on position: 1 + "
            f"({values['linear_coefficient']:.3g})(x - c) + "
            f"({values['quadratic_coefficient']:.3g})(x - c)^2 with c = "
            f"{self.quantity(values, 'centre', plant)}, where it is taken for 1: what it is there "
            "goes into mass, damping and all forces alike."
        )

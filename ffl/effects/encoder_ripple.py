"""A scale error of the encoder that repeats along the position."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import MEAN, X0
from ffl.effects.periods import sine_pair, wave_numbers
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: amplitude, period, phase."""
    io[MEAN] += p[0] * np.sin(2.0 * np.pi * io[X0] / p[1] + p[2])


class EncoderRipple(Effect):
    """y + amplitude sin(2 pi x/period + phase)."""

    name = "encoder_ripple"
    component = "sensor"
    port = "output"
    sides = ("sensor",)
    parameters = (
        Parameter("amplitude", "x"),
        Parameter("period", "x", lower=1e-12, linear=False),
        Parameter("phase", "rad", lower=-np.inf, default=0.0),
    )
    depends_on = ("position",)
    siblings = ("cogging", "periodic_disturbance", "sensor_nonlinearity")
    scan = "position"
    law = staticmethod(_law)

    def shown(self, values: Parameters, position: float) -> float:
        angle = 2.0 * np.pi * position / values["period"] + values["phase"]
        return position + float(values["amplitude"] * np.sin(angle))

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        return [{"period": 1.0 / k} for k in wave_numbers(motion)]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        angle = 2 * np.pi * motion.x / nonlinear["period"]
        return np.column_stack([np.sin(angle), np.cos(angle)])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return {**nonlinear, **sine_pair(coefficients)}

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"The sensor's scale has a ripple of {self.quantity(values, 'amplitude', plant)} that "
            f"repeats every {self.quantity(values, 'period', plant)}."
        )

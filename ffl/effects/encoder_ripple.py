"""A scale error of the encoder that repeats along the position."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffl.effects.base import Parameter, Parameters
from ffl.effects.law import MEAN, X0
from ffl.effects.periods import Repeating, harmonics, series
from ffl.systems.plant import Plant


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: as `series` has them."""
    error, _ = series(p, io[X0])
    io[MEAN] += error


class EncoderRipple(Repeating):
    """y + sum_i amplitude_i sin(2 pi i x/period + phase_i): offsets of the sine and cosine tracks make
    the first, unequal gains and the bend of the arctangent the second."""

    name = "encoder_ripple"
    component = "sensor"
    port = "output"
    sides = ("sensor",)
    parameters = (
        Parameter("amplitude", "y"),
        Parameter("period", "x", lower=1e-12, linear=False),
        Parameter("phase", "rad", lower=-np.inf, default=0.0),
    )
    siblings = ("cogging", "periodic_disturbance", "sensor_nonlinearity")
    law = staticmethod(_law)

    def shown(self, values: Parameters, position: Any) -> Any:
        angle = 2.0 * np.pi * position / values["period"]
        pairs = enumerate(harmonics(values), 1)
        return position + sum(a * np.sin(k * angle + phi) for k, (a, phi) in pairs)

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"The sensor's scale has a ripple of {self.quantity(values, 'amplitude', plant)} that "
            f"repeats every {self.quantity(values, 'period', plant)}{self.more(values)}."
        )

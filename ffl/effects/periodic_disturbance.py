"""A force that is a sine of time, such as a fan or the mains."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import FIRST, STEP, TIME
from ffl.effects.periods import sine_pair
from ffl.effects.solve import bulge_of, set_curve
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: amplitude, frequency, phase."""
    if io[FIRST] == 0.0:
        return
    start = 2.0 * np.pi * p[1] * io[TIME] + p[2]
    turn = np.pi * p[1] * io[STEP]
    first, last = p[0] * np.sin(start), p[0] * np.sin(start + 2.0 * turn)
    set_curve(io, first, last, bulge_of(first, p[0] * np.sin(start + turn), last))


class PeriodicDisturbance(Effect):
    """F = amplitude sin(2 pi frequency t + phase), t from the recording's clock."""

    name = "periodic_disturbance"
    component = "environment"
    parameters = (
        Parameter("amplitude", "F"),
        Parameter("frequency", "Hz", linear=False),
        Parameter("phase", "rad", lower=-np.inf, default=0.0),
    )
    depends_on = ("time",)
    siblings = ("cogging", "encoder_ripple", "drift", "flexible_mode")
    scan = "time"
    law = staticmethod(_law)
    needs_mass = False

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        n = len(motion.t)
        frequencies = np.arange(2, int(0.8 * n) + 1) / (2.0 * n * motion.sample_time)
        return [{"frequency": float(f)} for f in frequencies]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        angle = 2 * np.pi * nonlinear["frequency"] * motion.t
        return np.column_stack([np.sin(angle), np.cos(angle)])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return {**nonlinear, **sine_pair(coefficients)}

    def coefficients_of(self, values: Parameters) -> Array:
        amplitude, phase = float(values["amplitude"]), float(values["phase"])
        return amplitude * np.array([np.cos(phase), np.sin(phase)])

    def compensation(self, motion: Motion, **nonlinear: float) -> Array | None:
        return None  # its phase is not that of the reference

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"A force of {self.quantity(values, 'amplitude', plant)} oscillates at "
            f"{self.quantity(values, 'frequency', plant)}, whatever the machine does."
        )

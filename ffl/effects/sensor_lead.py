"""A sensor that is read after the sample, or a plant file that states a little too much delay or lag."""

from __future__ import annotations

from typing import Any

from ffl.effects.base import Effect, Motion, Parameter, Parameters, Setting
from ffl.effects.law import MEAN, V0
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: lead."""
    io[MEAN] += p[0] * io[V0]


class SensorLead(Effect):
    """y(t + `lead`), to first order y + lead dy/dt: y is ahead of the model by a part of a sample.

    The counterpart of `input_delay`. The diagnosis looks for it up to a tenth of a sample, where either is
    a correction of the model: what answers a command earlier than that is a matter of the time base.
    """

    name = "sensor_lead"
    component = "sensor"
    port = "output"
    sides = ("sensor",)
    parameters = (Parameter("lead", "s"),)
    depends_on = ("velocity",)
    siblings = ("flexible_mode", "viscous_friction")
    law = staticmethod(_law)

    def pack(self, values: Parameters, setting: Setting) -> list[float]:
        self.require(
            setting.mechanics.place is None,
            "needs a plant whose output is a position; here it is a speed: state less delay instead",
        )
        return [values["lead"]]

    def regressors(self, motion: Motion, **nonlinear: Any) -> Array:
        return motion.v[:, None]

    def says(self, values: Parameters, plant: Plant) -> str:
        samples = values["lead"] / plant.sample_time
        return f"The sensor is ahead of the model by {values['lead'] * 1e3:.4g} ms ({samples:.3g} samples)."

"""The last tank overflows: its level stops at the rim."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters, Part, Setting
from ffl.effects.cascade import OUT
from ffl.effects.overflow import law
from ffl.systems.plant import Plant

DEPTHS = (0.01, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3)  # of the range of levels, from its top


class Spill(Effect):
    """The level of the last stage cannot pass `height` (on the scale of the sensor); what would lift
    it further is lost. A sensor that clips there shows the same top and another way down.

    `side`: after which lag as the upper stage (see `ffl.effects.cascade`).
    """

    name = "spill"
    port = "flow"
    sides = OUT
    default_side = OUT[0]
    parameters = (Parameter("height", "x", lower=-np.inf, linear=False),)
    depends_on = ("position", "command")
    siblings = ("overflow", "outflow", "saturation", "sensor_bend", "sensor_nonlinearity")
    fixed_amount = True
    needs_mass = False
    ladder = ("height", np.linspace(0.9, 1.1, 7))
    law = staticmethod(law)

    def parts(self, values: Parameters, setting: Setting) -> list[Part]:
        return [Part(self.side_in(setting), None, law, [values["height"]])]

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        return [{"height": float(motion.x.max() - d * motion.span)} for d in DEPTHS]

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return dict(nonlinear)

    def says(self, values: Parameters, plant: Plant) -> str:
        return f"The last stage overflows: its level stops at {self.quantity(values, 'height', plant)}."

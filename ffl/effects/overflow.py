"""An upper tank that overflows into the lower one."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters, Part, Setting
from ffl.effects.cascade import BETWEEN
from ffl.effects.law import GX, GX_SLOPE, MEAN, SLOPE, X0, X1
from ffl.systems.plant import Plant

HEIGHTS = (0.5, 0.6, 0.7, 0.8, 0.87, 0.93, 0.97)  # shares of samples below it


def law(p, s, io):  # type: ignore[no-untyped-def]
    """p: height. The flow that keeps the level there, from where in the step it is reached."""
    x0, free = io[X0], io[X1]
    if free <= p[0]:
        io[MEAN], io[SLOPE] = 0.0, 0.0
        return
    before = (p[0] - x0) / (free - x0) if x0 < p[0] else 0.0
    mean = (p[0] - free) / (io[GX] + 3.0 * before * io[GX_SLOPE])
    io[MEAN], io[SLOPE] = mean, 3.0 * before * mean


class Overflow(Effect):
    """The level of the upper stage cannot pass `height`; a `share` of what would lift it further
    arrives in the lower stage, the rest is lost.

    `height` is on the scale of the sensor, as levels at rest have it (see `ffl.effects.cascade`).
    `side`: the lag that is the upper stage.
    """

    name = "overflow"
    port = "flow"
    sides = BETWEEN
    default_side = BETWEEN[0]
    parameters = (
        Parameter("height", "x", lower=-np.inf, linear=False),
        Parameter("share", "", upper=1.0, default=1.0),
    )
    depends_on = ("position", "command")
    siblings = ("spill", "outflow", "saturation")
    fixed_amount = True
    needs_mass = False
    stages = 2
    ladder = ("height", np.linspace(0.85, 1.15, 7))
    law = staticmethod(law)

    def parts(self, values: Parameters, setting: Setting) -> list[Part]:
        return [Part(self.side_in(setting), values["share"], law, [values["height"]])]

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        heights = np.unique(np.quantile(motion.x, HEIGHTS))
        return [{"height": float(h), "share": s} for h in heights for s in (0.3, 0.8)]

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return dict(nonlinear)

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"The upper stage overflows at {self.quantity(values, 'height', plant)} (on the scale of "
            f"the sensor, as at rest); {values['share']:.0%} of that reaches the lower one."
        )

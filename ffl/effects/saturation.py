"""An amplifier that cannot give more than a limit."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import MEAN, SLOPE
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

NEAR = (0.001, 0.003, 0.01, 0.03)  # share of the largest command by which a limit may lie below it


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: limit."""
    if abs(io[MEAN]) > p[0]:
        io[MEAN] = p[0] if io[MEAN] > 0.0 else -p[0]
        io[SLOPE] = 0.0


class Saturation(Effect):
    """u clipped at +-limit."""

    name = "saturation"
    component = "actuator"
    port = "command"
    default_side = "motor"
    parameters = (Parameter("limit", "u", lower=1e-12, linear=False),)
    depends_on = ("command",)
    ladder = ("limit", np.linspace(0.8, 1.2, 15))
    siblings = ("dead_zone", "position_dependent_gain")
    fixed_amount = True
    law = staticmethod(_law)

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        size = np.abs(motion.u)
        moving = size[size > 1e-6 * size.max(initial=0.0)]
        if not len(moving):
            return []
        levels = np.quantile(moving, [0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999])
        # A command that is held at its largest has all upper quantiles there.
        below = moving.max() * (1.0 - np.array(NEAR))
        return [{"limit": float(level)} for level in np.unique([*levels, *below])]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        limit = nonlinear["limit"]
        return np.column_stack([np.clip(motion.u, -limit, limit) - motion.u])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return dict(nonlinear)

    def says(self, values: Parameters, plant: Plant) -> str:
        return f"The actuator gives no more than {self.quantity(values, 'limit', plant)}."

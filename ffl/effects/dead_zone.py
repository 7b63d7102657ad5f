"""A command that does nothing until it is large enough."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import MEAN, SLOPE
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: half_width."""
    if abs(io[MEAN]) <= p[0]:
        io[MEAN], io[SLOPE] = 0.0, 0.0
    else:
        io[MEAN] -= p[0] if io[MEAN] > 0.0 else -p[0]


class DeadZone(Effect):
    """u moved towards 0 by half_width, 0 within it."""

    name = "dead_zone"
    component = "actuator"
    port = "command"
    default_side = "motor"
    parameters = (Parameter("half_width", "u"),)
    depends_on = ("command",)
    ladder = ("half_width", np.geomspace(0.3, 3.0, 6))
    siblings = ("saturation", "coulomb_friction", "backlash")
    law = staticmethod(_law)

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        size = np.abs(motion.u)
        moving = size[size > 1e-6 * size.max(initial=0.0)]
        if not len(moving):
            return []
        levels = np.quantile(moving, [0.02, 0.05, 0.1, 0.2, 0.3, 0.5])
        return [{"shape": float(level)} for level in np.unique(levels)]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        """What is lost, per half width, in the shape it has at the half width `shape`."""
        shape = nonlinear["shape"]
        return np.column_stack([-np.clip(motion.u, -shape, shape) / shape])

    def nonlinear_of(self, values: Parameters) -> dict[str, float]:
        return {"shape": max(float(values["half_width"]), 1e-300)}

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return {"half_width": max(float(coefficients[0]), 0.0)}

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"Commands below {self.quantity(values, 'half_width', plant)} have no effect, larger "
            "ones lose that much (dead zone)."
        )

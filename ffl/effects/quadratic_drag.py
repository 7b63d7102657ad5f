"""Drag that grows with the square of the velocity."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import V0
from ffl.effects.solve import end_motion, set_line
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: coefficient. The end force solves a quadratic equation in closed form."""
    start = -p[0] * io[V0] * abs(io[V0])
    _, _, va, gv = end_motion(io, start)
    # v1 = va - gv c v1 |v1|, so v1 has the sign of va.
    k = gv * p[0]
    v1 = 2.0 * va / (1.0 + np.sqrt(1.0 + 4.0 * k * abs(va)))
    set_line(io, start, -p[0] * v1 * abs(v1))


class QuadraticDrag(Effect):
    """F = -coefficient v |v|."""

    name = "quadratic_drag"
    parameters = (Parameter("coefficient", "F s^2/x^2"),)
    depends_on = ("velocity",)
    siblings = ("viscous_friction", "coulomb_friction")
    law = staticmethod(_law)

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        return np.column_stack([-motion.v * np.abs(motion.v)])

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"Drag of {self.quantity(values, 'coefficient', plant)} grows with the square of the "
            "velocity."
        )

"""Drag that grows with the square of the velocity."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import V0
from ffl.effects.solve import bulge_of, end_motion, middle_motion, set_curve
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: coefficient. The end force solves a quadratic equation in closed form; the bulge of the
    force between is found by repetition."""
    start, end, bulge = -p[0] * io[V0] * abs(io[V0]), 0.0, 0.0
    for _ in range(8):
        xa, gx, va, gv = end_motion(io, start, bulge)
        # v1 = va - gv c v1 |v1|, so v1 has the sign of va.
        v1 = 2.0 * va / (1.0 + np.sqrt(1.0 + 4.0 * gv * p[0] * abs(va)))
        end = -p[0] * v1 * abs(v1)
        _, half = middle_motion(io, xa + gx * end, v1)
        more = bulge_of(start, -p[0] * half * abs(half), end) - bulge
        bulge += more
        if abs(more) <= 1e-12 * (abs(start) + abs(end)):
            break
    set_curve(io, start, end, bulge)


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

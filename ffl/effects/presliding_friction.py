"""LuGre friction: the contact gives way elastically before it slides."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.bristle import set_bristle
from ffl.effects.modal import is_speed
from ffl.effects.paths import bouc_wen
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: level, stiffness, micro_damping; s: z, force at the start, force at the end (iterate)."""
    set_bristle(io, s, p[0], p[0], p[1], p[2])


class PreslidingFriction(Effect):
    """F = -(stiffness z + micro_damping dz/dt), dz/dt = v - |v| z stiffness/level (LuGre without
    Stribeck; Canudas de Wit et al. 1995, equations (1) to (3) with g constant)."""

    name = "presliding_friction"
    parameters = (
        Parameter("level", "F", lower=1e-12),
        Parameter("stiffness", "F/x", lower=1e-12, linear=False),
        Parameter("micro_damping", "F s/x", linear=False, default=0.0),
    )
    depends_on = ("direction", "history", "position")
    ladder = ("stiffness", np.geomspace(0.05, 20.0, 7))
    siblings = ("coulomb_friction", "hysteresis", "stribeck_friction")
    law = staticmethod(_law)
    remembers = True

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0, 0.0, 0.0]

    def stiffness(self, packed):  # type: ignore[no-untyped-def]
        return packed[1]

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        return [{"displacement": float(d)} for d in motion.span * np.geomspace(1e-5, 2.5e-2, 8)]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        """-z stiffness/level along the path; `displacement` is level/stiffness."""
        return np.column_stack([-bouc_wen(motion.x, nonlinear["displacement"], 1.0, 1.0)])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        level = max(float(coefficients[0]), 1e-12)
        return {
            "level": level,
            "stiffness": level / nonlinear["displacement"],
            "micro_damping": 0.0,
        }

    def nonlinear_of(self, values: Parameters) -> dict[str, float]:
        return {"displacement": values["level"] / values["stiffness"]}

    def says(self, values: Parameters, plant: Plant) -> str:
        give = values["level"] / values["stiffness"]
        place = "" if is_speed(plant.output_unit) else plant.output_unit
        return (
            f"Friction of {self.quantity(values, 'level', plant)} gives way elastically over about "
            f"{give:.3g} {place} before it slides (presliding)."
        )

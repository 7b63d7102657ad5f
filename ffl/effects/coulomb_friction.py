"""Coulomb friction: a constant force against the motion, sticking at standstill."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import COMMIT
from ffl.effects.solve import set_friction
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: level; s: at rest at the start, at rest at the end of the step being solved."""
    if io[COMMIT] != 0.0:
        s[0] = s[1]
        return
    level = p[0]
    rests = set_friction(
        io, s[0] != 0.0, (level, level, level), (level, level, level), level, level
    )
    s[1] = 1.0 if rests else 0.0


class CoulombFriction(Effect):
    """F = -level sign(v); at v = 0 the force that keeps it there, up to `level`."""

    name = "coulomb_friction"
    parameters = (Parameter("level", "F"),)
    depends_on = ("direction",)
    siblings = (
        "asymmetric_friction",
        "stribeck_friction",
        "presliding_friction",
        "position_dependent_friction",
        "hysteresis",
        "backlash",
        "logarithmic_friction",
    )
    law = staticmethod(_law)
    remembers = True
    switches = True

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0, 0.0]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        return np.column_stack([-motion.direction])

    def says(self, values: Parameters, plant: Plant) -> str:
        level = self.quantity(values, "level", plant)
        return f"Dry friction of {level} opposes the motion and holds the machine at standstill."

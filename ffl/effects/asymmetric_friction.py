"""Friction with a level of its own in either direction."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import COMMIT
from ffl.effects.solve import set_friction
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: level_positive, level_negative; s: at rest at the start, at rest at the end."""
    if io[COMMIT] != 0.0:
        s[0] = s[1]
        return
    plus, minus = p[0], p[1]
    rests = set_friction(io, s[0] != 0.0, (plus, plus, plus), (minus, minus, minus), plus, minus)
    s[1] = 1.0 if rests else 0.0


class AsymmetricFriction(Effect):
    """F = -level_positive for v > 0, +level_negative for v < 0, sticking in between."""

    name = "asymmetric_friction"
    parameters = (Parameter("level_positive", "F"), Parameter("level_negative", "F"))
    depends_on = ("direction",)
    siblings = ("coulomb_friction", "constant_load", "position_dependent_friction")
    law = staticmethod(_law)
    remembers = True
    switches = True

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0, 0.0]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        direction = motion.direction
        return np.column_stack([-np.maximum(direction, 0.0), np.maximum(-direction, 0.0)])

    def says(self, values: Parameters, plant: Plant) -> str:
        plus = self.quantity(values, "level_positive", plant)
        minus = self.quantity(values, "level_negative", plant)
        return f"Dry friction depends on the direction: {plus} moving up, {minus} moving down."

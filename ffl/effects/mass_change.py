"""A moving mass other than the model's."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters, Setting
from ffl.effects.mechanics import Mechanics
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array


class MassChange(Effect):
    """F = -change mass a, put into the linear part and so exact at any size.

    On side `all` every mode is heavier by the same share, which is as well a command that moves less:
    such a change has no point where it sits.
    """

    name = "mass_change"
    parameters = (Parameter("change", "", lower=-0.99),)
    sides = (*Effect.sides, "all")
    depends_on = ("acceleration",)
    siblings = ("viscous_friction", "flexible_mode", "position_dependent_gain")

    def turn(self, spec: EffectSpec) -> int:
        """A mass that changes everywhere is more of every part, and leaves what others add what it is."""
        return 1 if spec.options.get("side") == "all" else 2

    def modify(self, mechanics: Mechanics, values: Parameters, setting: Setting) -> Mechanics:
        if self.side_in(setting) == "all":
            return mechanics.with_inertia(1.0 + values["change"])
        point = mechanics.point(self.side_in(setting), setting.mass_ratio)
        return mechanics.with_mass(point, values["change"] * mechanics.moving_mass)

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        return np.column_stack([-motion.mass * motion.a])

    def says(self, values: Parameters, plant: Plant) -> str:
        size = abs(100 * values["change"])
        return (
            f"The moving mass is {size:.3g} % {'larger' if values['change'] > 0 else 'smaller'} than "
            "the model's."
        )

"""A constant force, such as weight on an inclined axis."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters, Setting
from ffl.effects.mechanics import Mechanics
from ffl.effects.modal import moves
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


class ConstantLoad(Effect):
    """F = +force."""

    name = "constant_load"
    component = "environment"
    parameters = (Parameter("force", "F", lower=-np.inf),)
    siblings = ("asymmetric_friction", "drift", "linear_stiffness")

    def modify(self, mechanics: Mechanics, values: Parameters, setting: Setting) -> Mechanics:
        point = mechanics.point(self.side_in(setting), setting.mass_ratio)
        return mechanics.with_load(point, values["force"] / setting.force_per_input)

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        return np.ones((len(motion.t), 1))

    def says(self, values: Parameters, plant: Plant) -> str:
        if not moves(plant):
            return f"A constant {self.quantity(values, 'force', plant)} acts beside the input."
        return f"A constant force of {self.quantity(values, 'force', plant)} acts on the machine."

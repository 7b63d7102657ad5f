"""Viscous friction beside what the model has."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters, Setting
from ffl.effects.mechanics import Mechanics
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


class ViscousFriction(Effect):
    """F = -coefficient v, put into the linear part and so exact at any size."""

    name = "viscous_friction"
    parameters = (Parameter("coefficient", "F s/x"),)
    depends_on = ("velocity",)
    siblings = (
        "quadratic_drag",
        "coulomb_friction",
        "mass_change",
        "actuator_lag",
        "logarithmic_friction",
    )

    def modify(self, mechanics: Mechanics, values: Parameters, setting: Setting) -> Mechanics:
        point = mechanics.point(self.side_in(setting), setting.mass_ratio)
        return mechanics.with_feedback(point, 0.0, -values["coefficient"] / setting.force_per_input)

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        return np.column_stack([-motion.v])

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"Viscous friction of {self.quantity(values, 'coefficient', plant)} acts beside the "
            "damping that the model has."
        )

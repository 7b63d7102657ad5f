"""A spring to ground that the model does not have."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters, Setting
from ffl.effects.mechanics import Mechanics
from ffl.effects.modal import moves
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


class LinearStiffness(Effect):
    """F = -stiffness (x - centre), put into the linear part and so exact at any size. Below 0 it pushes
    away from its centre, as magnets do."""

    name = "linear_stiffness"
    parameters = (
        Parameter("stiffness", "F/x", lower=-np.inf),
        Parameter("centre", "x", lower=-np.inf, default=0.0),
    )
    depends_on = ("position",)
    siblings = ("hardening_spring", "constant_load", "hysteresis")

    def modify(self, mechanics: Mechanics, values: Parameters, setting: Setting) -> Mechanics:
        point = mechanics.point(self.side_in(setting), setting.mass_ratio)
        stiffness = values["stiffness"] / setting.force_per_input
        loaded = mechanics.with_load(point, stiffness * values["centre"])
        return loaded.with_feedback(point, -stiffness, 0.0)

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        """-x and 1: coefficients stiffness and stiffness * centre."""
        return np.column_stack([-motion.x, np.ones_like(motion.x)])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        stiffness = float(coefficients[0])
        centre = float(coefficients[1]) / stiffness if stiffness else 0.0
        return {"stiffness": stiffness, "centre": centre}

    def coefficients_of(self, values: Parameters) -> Array:
        return values["stiffness"] * np.array([1.0, values["centre"]])

    def says(self, values: Parameters, plant: Plant) -> str:
        stiffness = self.quantity(values, "stiffness", plant)
        centre = self.quantity(values, "centre", plant)
        if not moves(plant):
            return f"{stiffness} more drive the output towards {centre}."
        if values["stiffness"] < 0.0:
            return f"A negative stiffness of {stiffness} pushes away from {centre}."
        return f"A spring of {stiffness} pulls towards {centre}."

"""A cubic spring: stiffer, or softer, the further it is pulled."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Extent, Motion, Parameter, Parameters
from ffl.effects.law import X0
from ffl.effects.modal import moves
from ffl.effects.solve import bulge_of, end_motion, middle_motion, set_curve
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: cubic_coefficient, centre; s: end force and bulge (iterates)."""
    away = io[X0] - p[1]
    start = -p[0] * away * away * away
    force, bulge = s[0], s[1]
    for _ in range(16):
        xa, gx, va, gv = end_motion(io, start, bulge)
        away = xa + gx * force - p[1]
        error = force + p[0] * away * away * away
        change = -error / (1.0 + 3.0 * p[0] * away * away * gx)
        force += change
        half, _ = middle_motion(io, xa + gx * force, va + gv * force)
        away = half - p[1]
        more = bulge_of(start, -p[0] * away * away * away, force) - bulge
        bulge += more
        if abs(change) + abs(more) <= 1e-12 * (abs(start) + abs(force)):
            break
    s[0], s[1] = force, bulge
    set_curve(io, start, force, bulge)


class HardeningSpring(Effect):
    """F = -cubic_coefficient (x - centre)^3; a negative coefficient is a spring that softens (the restoring
    moment of a rolling ship, a pendulum)."""

    name = "hardening_spring"
    parameters = (
        Parameter("cubic_coefficient", "F/x^3", lower=-np.inf),
        Parameter("centre", "x", lower=-np.inf, linear=False, default=0.0),
    )
    depends_on = ("position",)
    siblings = ("linear_stiffness", "position_dependent_gain", "sensor_nonlinearity")
    law = staticmethod(_law)
    needs_mass = False

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0, 0.0]

    def credible(self, spec: EffectSpec, extent: Extent) -> bool:
        """One that begins farther away than the machine travels is another curve, a cubic beside the
        load and the stiffness that go with it. (A winch whose drum grows: at 34 rad, of a travel of 12.)"""
        centre = float(spec.parameters["centre"])
        return extent.lowest - extent.travel < centre < extent.highest + extent.travel

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        centres = motion.middle + motion.span * np.array([0.0, -0.5, -0.25, 0.25, 0.5])
        return [{"centre": float(c)} for c in np.unique(np.append(centres, 0.0))]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        return np.column_stack([-((motion.x - nonlinear["centre"]) ** 3)])

    def says(self, values: Parameters, plant: Plant) -> str:
        softens = values["cubic_coefficient"] < 0
        if moves(plant):
            what = "A spring softens" if softens else "A spring hardens"
        else:
            what = f"What drives the output back {'falls off' if softens else 'grows'}"
        size = {**values, "cubic_coefficient": abs(values["cubic_coefficient"])}
        return (
            f"{what} with the cube of the way from "
            f"{self.quantity(values, 'centre', plant)}: "
            f"{self.quantity(size, 'cubic_coefficient', plant)}."
        )

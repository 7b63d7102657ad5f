"""Stribeck friction: a higher level near standstill than in motion."""

from __future__ import annotations

import numpy as np
from numba import njit

from ffl.effects.base import Effect, Extent, Motion, Parameter, Parameters
from ffl.effects.law import COMMIT, GV, V0, V1
from ffl.effects.solve import set_friction
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array

FALLEN = 0.5  # of the top speed: 2 % of what falls is left there
LEAST = 0.1  # of the static level: what friction keeps at speed


@njit(error_model="numpy")
def _level(p, speed):  # type: ignore[no-untyped-def]
    ratio = speed / p[2]
    return p[0] + (p[1] - p[0]) * np.exp(-ratio * ratio) if ratio < 7.0 else p[0]


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: coulomb_level, static_level, stribeck_velocity; s: at rest at the start, at the end."""
    if io[COMMIT] != 0.0:
        s[0] = s[1]
        return
    v0 = 0.0 if s[0] != 0.0 else io[V0]
    direction = 1.0 if v0 > 0.0 or (v0 == 0.0 and io[V1] > 0.0) else -1.0
    start = _level(p, abs(v0))
    middle, end = start, start
    for _ in range(8):  # the level at the end depends on the velocity that it leaves there
        v1 = io[V1] - direction * io[GV] * (start + 4.0 * middle + end) / 6.0
        middle = _level(p, max(0.5 * direction * (v0 + v1), 0.0))
        following = _level(p, max(direction * v1, 0.0))
        done = abs(following - end) <= 1e-9 * end
        end = following
        if done:
            break
    static = p[0] + (p[1] - p[0])  # the level at rest, to the bit
    line, back = (start, middle, end), (static, static, static)
    rests = (
        set_friction(io, s[0] != 0.0, line, back, static, static)
        if direction > 0.0
        else set_friction(io, s[0] != 0.0, back, line, static, static)
    )
    s[1] = 1.0 if rests else 0.0


class StribeckFriction(Effect):
    """F = -sign(v) (coulomb + (static - coulomb) exp(-(v/v_s)^2)), sticking up to static_level.

    A static level below the Coulomb level is refused: nothing then falls with speed.
    """

    name = "stribeck_friction"
    parameters = (
        Parameter("coulomb_level", "F"),
        Parameter("static_level", "F"),
        Parameter("stribeck_velocity", "x/s", lower=1e-12, linear=False),
    )
    depends_on = ("velocity", "direction")
    siblings = (
        "coulomb_friction",
        "presliding_friction",
        "viscous_friction",
        "asymmetric_friction",
    )
    law = staticmethod(_law)
    remembers = True
    switches = True

    def credible(self, spec: EffectSpec, extent: Extent) -> bool:
        """Some of the level stays at speed, where what falls has fallen: what vanishes is no dry friction,
        what falls up to the top speed a damping."""
        values = spec.parameters
        fallen = values["stribeck_velocity"] < FALLEN * extent.speed
        return bool(fallen and values["coulomb_level"] > LEAST * values["static_level"])

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0, 0.0]

    def weakening(self, packed):  # type: ignore[no-untyped-def]
        return np.sqrt(2.0 / np.e) * (packed[1] - packed[0]) / packed[2]

    def check(self, spec):  # type: ignore[no-untyped-def]
        values = super().check(spec)
        self.require(
            values["static_level"] >= values["coulomb_level"],
            f"static_level = {values['static_level']:g} lies below coulomb_level = "
            f"{values['coulomb_level']:g}; exchange them",
        )
        return values

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        top = float(np.abs(motion.v).max(initial=0.0))
        shares = np.geomspace(0.01, 0.5, 9) if top > 0.0 else ()
        return [{"stribeck_velocity": float(top * share)} for share in shares]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        direction = motion.direction
        near = np.exp(-((motion.v / nonlinear["stribeck_velocity"]) ** 2))
        return np.column_stack([-direction, -direction * near])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        coulomb = max(float(coefficients[0]), 0.0)
        static = coulomb + max(float(coefficients[1]), 0.0)
        return {"coulomb_level": coulomb, "static_level": static, **nonlinear}

    def nonlinear_of(self, values: Parameters) -> dict[str, float]:
        return {"stribeck_velocity": values["stribeck_velocity"]}

    def coefficients_of(self, values: Parameters) -> Array:
        coulomb = values["coulomb_level"]
        return np.array([coulomb, values["static_level"] - coulomb])

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"Friction is {self.quantity(values, 'static_level', plant)} at standstill and falls to "
            f"{self.quantity(values, 'coulomb_level', plant)} above about "
            f"{self.quantity(values, 'stribeck_velocity', plant)} (Stribeck)."
        )

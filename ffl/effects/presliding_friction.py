"""Presliding friction: the contact gives way elastically before it slides."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffl.effects import bristle, slip
from ffl.effects.base import Effect, Motion, Parameter, Parameters, Setting
from ffl.effects.bristle import set_bristle
from ffl.effects.modal import is_speed
from ffl.effects.paths import bouc_wen
from ffl.effects.slip import ELEMENTS, set_slip
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

KINDS = ("lugre", "maxwell_slip")


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: level, stiffness, micro_damping; s: `set_bristle`'s."""
    set_bristle(io, s, p[0], p[0], p[1], p[2])


def _slip_law(p, s, io):  # type: ignore[no-untyped-def]
    """p: level, stiffness, micro_damping; s: `set_slip`'s."""
    set_slip(io, s, p[0], p[0], p[1], p[2])


class PreslidingFriction(Effect):
    """F = -(stiffness z + micro_damping dz/dt).

    kind "lugre" (default): one bristle, dz/dt = v - |v| z stiffness/level (LuGre without Stribeck;
    Canudas de Wit et al. 1995, equations (1) to (3) with g constant). "maxwell_slip": z the mean
    deflection of elements in parallel that slide one after the other (`slip`). Both follow
    level (1 - exp(-stiffness x/level)) from rest; on return the elements obey Masing's rule, which
    the bristle does not.
    """

    name = "presliding_friction"
    parameters = (
        Parameter("level", "F", lower=1e-12),
        Parameter("stiffness", "F/x", lower=1e-12, linear=False),
        Parameter("micro_damping", "F s/x", linear=False, default=0.0),
    )
    depends_on = ("direction", "history", "position")
    ladder = ("stiffness", np.geomspace(0.05, 20.0, 7))
    siblings = ("coulomb_friction", "hysteresis", "stribeck_friction", "asymmetric_friction")
    options = {"kind": KINDS}  # noqa: RUF012
    law = staticmethod(_law)
    remembers = True

    def pack(self, values: Parameters, setting: Setting) -> list[float]:
        kind = KINDS.index(setting.options.get("kind", KINDS[0]))
        return [*super().pack(values, setting), float(kind)]

    def law_in(self, setting: Setting):  # type: ignore[no-untyped-def]
        return _slip_law if setting.options.get("kind") == "maxwell_slip" else _law

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0] * (ELEMENTS + 1)

    def after_travel(self, state, packed, travel):  # type: ignore[no-untyped-def]
        displacement = packed[0] / packed[1]
        if packed[3]:
            return [*slip.carried(travel, displacement), state[-1]]
        return [bristle.carried(travel, displacement), *state[1:]]

    def forms(self, flexible: bool, sample_time: float = 0.0) -> list[dict[str, Any]]:
        """That of machines; whether the other does better is asked once this one stands."""
        return [{"kind": "maxwell_slip"}]

    def stiffness(self, packed):  # type: ignore[no-untyped-def]
        return packed[1]

    def reach(self, values: Parameters) -> float:
        return float(values["level"] / values["stiffness"])

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        return [{"displacement": float(d)} for d in motion.span * np.geomspace(1e-5, 2.5e-2, 8)]

    def regressors(self, motion: Motion, **nonlinear: Any) -> Array:
        """-z stiffness/level along the path; `displacement` is level/stiffness."""
        displacement = nonlinear["displacement"]
        if nonlinear.get("kind") == "maxwell_slip":
            return np.column_stack([-slip.slip(motion.x, displacement)])
        return np.column_stack([-bouc_wen(motion.x, displacement, 1.0, 1.0)])

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

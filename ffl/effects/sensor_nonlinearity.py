"""A sensor that clips, or that does not see the sign."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffl.effects.base import Effect, Extent, Motion, Parameter, Parameters, Setting
from ffl.effects.law import MEAN
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array

KINDS = ("clipping", "rectified", "clipping_above", "clipping_below")
CLIPS = frozenset(KINDS) - {"rectified"}
BEYOND = 0.02  # of the largest y: what a level may be short of it


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: kind (0 clipping, 1 rectified, 2 clipping above, 3 below), level."""
    if p[0] == 0.0:
        io[MEAN] = min(max(io[MEAN], -p[1]), p[1])
    elif p[0] == 1.0:
        io[MEAN] = abs(io[MEAN])
    elif p[0] == 2.0:
        io[MEAN] = min(io[MEAN], p[1])
    else:
        io[MEAN] = max(io[MEAN], p[1])


class SensorNonlinearity(Effect):
    """kind "clipping": y clipped at +-level; "clipping_above", "clipping_below": at one end alone, at a
    level of either sign; "rectified": |y| (`level` is not used)."""

    name = "sensor_nonlinearity"
    component = "sensor"
    port = "output"
    sides = ("sensor",)
    parameters = (Parameter("kind", "", linear=False), Parameter("level", "y", default=0.0))
    depends_on = ("position",)
    ladder = ("level", np.linspace(0.93, 1.07, 15))
    siblings = ("encoder_ripple", "saturation", "hardening_spring")
    fixed_amount = True
    law = staticmethod(_law)

    def check_value(self, parameter: Parameter, value: Any) -> Any:
        if parameter.name != "kind":
            return super().check_value(parameter, value)
        self.require(value in KINDS, f"kind = {value!r}; take one of {', '.join(KINDS)}")
        return value

    def check(self, spec):  # type: ignore[no-untyped-def]
        values = super().check(spec)
        self.require(
            values["kind"] != "clipping" or values["level"] > 0,
            "clipping needs a level above 0 in parameters",
        )
        return values

    def pack(self, values: Parameters, setting: Setting) -> list[float]:
        return [float(KINDS.index(values["kind"])), values["level"]]

    def idle(self, values: Parameters) -> tuple[str, ...]:
        return ("level",) if values["kind"] == "rectified" else ()

    def credible(self, spec: EffectSpec, extent: Extent) -> bool:
        """What clips shows nothing beyond."""
        values = spec.parameters
        return bool(
            values["kind"] != "clipping" or values["level"] > (1.0 - BEYOND) * extent.largest
        )

    def order(self, values: Parameters) -> int:
        return 1 if values["kind"] in CLIPS else 0

    def passes(self, values: Parameters, seen: Array) -> Array:
        if values["kind"] == "rectified":
            return np.sign(seen)
        if values["kind"] == "clipping":
            return (np.abs(seen) < values["level"]).astype(float)
        way = 1.0 if values["kind"] == "clipping_above" else -1.0
        return (way * seen < way * values["level"]).astype(float)

    def grid(self, motion: Motion) -> list[dict[str, Any]]:
        levels = np.unique(np.quantile(np.abs(motion.x), [0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99]))
        clipping = [{"kind": "clipping", "level": float(v)} for v in levels if v > 0]
        return [*clipping, {"kind": "rectified", "level": 0.0}]

    def regressors(self, motion: Motion, **nonlinear: Any) -> Array:
        level, x = nonlinear["level"], motion.x
        seen = {
            "clipping": lambda: np.clip(x, -level, level),
            "rectified": lambda: np.abs(x),
            "clipping_above": lambda: np.minimum(x, level),
            "clipping_below": lambda: np.maximum(x, level),
        }[nonlinear["kind"]]()
        return np.column_stack([seen - x])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return dict(nonlinear)

    def says(self, values: Parameters, plant: Plant) -> str:
        if values["kind"] == "rectified":
            return "The sensor is blind to the sign: it reads the magnitude."
        end = values["kind"].removeprefix("clipping").removeprefix("_") or "at"
        return f"The sensor clips {end} {self.quantity(values, 'level', plant)}."

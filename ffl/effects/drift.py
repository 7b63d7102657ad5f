"""A slow force: settling, a slow sine or a ramp."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from ffl.effects.base import Effect, Extent, Motion, Parameter, Parameters, Setting
from ffl.effects.law import FIRST, STEP, TIME
from ffl.effects.solve import bulge_of, set_curve
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array

BRIEF = 0.05  # of the recording: no drift is faster
SETTLES = "exponential"
KINDS = (SETTLES, "sine", "ramp")


@njit(error_model="numpy")
def _force(p, t):  # type: ignore[no-untyped-def]
    """p: amplitude, time_constant, kind."""
    if p[2] == 0.0:
        return p[0] * (1.0 - np.exp(-max(t, 0.0) / p[1]))
    if p[2] == 1.0:
        return p[0] * np.sin(2.0 * np.pi * t / p[1])
    return p[0] * t / p[1]


def _law(p, s, io):  # type: ignore[no-untyped-def]
    if io[FIRST] == 0.0:
        return
    t, h = io[TIME], io[STEP]
    first, last = _force(p, t), _force(p, t + h)
    set_curve(io, first, last, bulge_of(first, _force(p, t + 0.5 * h), last))


class Drift(Effect):
    """F = amplitude (1 - exp(-t/time_constant)); `kind` "sine": amplitude sin(2 pi t/time_constant);
    "ramp": amplitude t/time_constant. t is the recording's clock; the settling begins at t = 0."""

    name = "drift"
    component = "environment"
    parameters = (
        Parameter("amplitude", "F", lower=-np.inf),
        Parameter("time_constant", "s", lower=1e-6, linear=False),
    )
    options = {"kind": KINDS}  # noqa: RUF012
    depends_on = ("time", "temperature")
    siblings = ("constant_load", "periodic_disturbance", "linear_stiffness")
    law = staticmethod(_law)
    needs_mass = False

    def pack(self, values: Parameters, setting: Setting) -> list[float]:
        kind = float(KINDS.index(setting.options.get("kind", SETTLES)))
        return [values["amplitude"] / setting.force_per_input, values["time_constant"], kind]

    def credible(self, spec: EffectSpec, extent: Extent) -> bool:
        """What settles at once is a load that begins, not a drift; a sine of which no recording holds a
        period is any bend."""
        slow = float(spec.parameters["time_constant"]) / extent.duration
        return slow >= BRIEF and (slow <= 1.0 or spec.options.get("kind") != "sine")

    def grid(self, motion: Motion) -> list[dict[str, Any]]:
        duration = len(motion.t) * motion.sample_time
        settling, waves = np.geomspace(BRIEF, 4.0, 8), np.geomspace(BRIEF, 1.0, 6)
        return [
            {"time_constant": float(tau), "kind": kind}
            for kind, taus in zip(KINDS, (settling, waves, np.ones(1)), strict=True)
            for tau in duration * taus
        ]

    def regressors(self, motion: Motion, **nonlinear: Any) -> Array:
        tau, kind = nonlinear["time_constant"], nonlinear.get("kind", SETTLES)
        t = motion.t
        if kind == SETTLES:
            return (1.0 - np.exp(-np.maximum(t, 0.0) / tau))[:, None]
        return (np.sin(2.0 * np.pi * t / tau) if kind == "sine" else t / tau)[:, None]

    def compensation(self, motion: Motion, **nonlinear: float) -> Array | None:
        return None  # the reference does not know how long the machine has been on

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"A slow force drifts by {self.quantity(values, 'amplitude', plant)} over about "
            f"{self.quantity(values, 'time_constant', plant)}."
        )

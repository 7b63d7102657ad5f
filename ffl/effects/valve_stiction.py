"""An actuator whose stem sticks: it stays where it is until the command has gone far enough."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from ffl.effects.base import Effect, Motion, Parameter, Parameters, Setting
from ffl.effects.law import MEAN, SLOPE
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

KINDS = ("jump", "play")
# Bands that are looked at first: each opens another set of jumps, and one 1.4 % off did a quarter less, and
# less than a play of a third of it.
BANDS = 600


@njit(cache=True)
def _stems(u, band, follows, stem):  # type: ignore[no-untyped-def]
    at = u[0]
    for k in range(len(u)):
        if abs(u[k] - at) > band:
            at = u[k] - follows * (band if u[k] > at else -band)
        stem[k] = at


def stem_of(u: Array, band: float, kind: str = KINDS[0]) -> Array:
    """Where the stem stands under the commands `u` (N,), at rest under the first before."""
    out = np.empty(len(u))
    _stems(np.ascontiguousarray(u, float), band, float(kind == KINDS[1]), out)
    return out


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: band, 1 where it follows (play); s: stem."""
    if abs(io[MEAN] - s[0]) > p[0]:
        s[0] = io[MEAN] - p[1] * (p[0] if io[MEAN] > s[0] else -p[0])
    io[MEAN], io[SLOPE] = s[0], 0.0


class ValveStiction(Effect):
    """The stem x, which acts in place of u, stays while |u - x| <= band; beyond it (key `kind`)

    kind "jump" (default): x = u, stuck by friction, then free at once (Stenman, Gustafsson, Forsman
        2003, equation (4));
    kind "play": x = u - band sign(u - x), lost motion in the linkage.
    """

    name = "valve_stiction"
    component = "actuator"
    port = "command"
    default_side = "motor"
    parameters = (Parameter("band", "u", lower=1e-12, linear=False, stepped=True),)
    depends_on = ("command", "history")
    ladder = ("band", np.geomspace(0.96, 1.04, 17))
    options = {"kind": KINDS}  # noqa: RUF012
    siblings = ("dead_zone", "actuator_lag", "input_delay")
    fixed_amount = True
    of_processes = True
    law = staticmethod(_law)

    def pack(self, values: Parameters, setting: Setting) -> list[float]:
        return [*super().pack(values, setting), float(setting.options.get("kind") == KINDS[1])]

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0]

    def after_command(self, state, command):  # type: ignore[no-untyped-def]
        return [command]

    def grid(self, motion: Motion) -> list[dict[str, Any]]:
        bands = np.ptp(motion.u) * np.geomspace(3e-3, 0.3, BANDS) if len(motion.u) else ()
        return [{"band": float(band), "kind": kind} for band in bands if band > 0 for kind in KINDS]

    def regressors(self, motion: Motion, **nonlinear: Any) -> Array:
        return np.column_stack([stem_of(motion.u, **nonlinear) - motion.u])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return dict(nonlinear)

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"The actuator stays where it is until the command is {self.quantity(values, 'band', plant)} "
            "away (stiction or play of a valve)."
        )

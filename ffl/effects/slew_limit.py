"""A drive whose output cannot change faster than a rate."""

from __future__ import annotations

import numpy as np
from numba import njit

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import MEAN, SLOPE, STEP
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

QUANTILES = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999)
SHARES = np.geomspace(0.02, 0.9, 9)  # of the fastest change of the command


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: rate; s: output at the start of the step. Exact for a command that is held over the step: the
    output runs straight towards it, and from where it arrives on stands there."""
    wanted = io[MEAN]
    way, most = wanted - s[0], p[0] * io[STEP]
    if abs(way) >= most:
        change = most if way > 0.0 else -most
        io[MEAN], io[SLOPE] = s[0] + 0.5 * change, 0.5 * change
        s[0] += change
        return
    if way == 0.0:
        s[0] = wanted + io[SLOPE]
        return
    share = abs(way) / most  # of the step until it arrives
    io[MEAN] = wanted - 0.5 * way * share
    io[SLOPE] = way * share * (1.5 - share)
    s[0] = wanted


@njit(cache=True, nogil=True, error_model="numpy")
def _limited(u: Array, most: float) -> Array:
    """Mean over each sample of u, held, behind a drive that changes by `most` in a sample."""
    out = np.empty(len(u))
    at = u[0]
    for k in range(len(u)):
        way = u[k] - at
        if abs(way) >= most:
            change = most if way > 0.0 else -most
            out[k] = at + 0.5 * change
            at += change
        else:
            out[k] = u[k] - 0.5 * way * abs(way) / most
            at = u[k]
    return out


class SlewLimit(Effect):
    """|du_a/dt| <= rate towards u; u_a drives the plant."""

    name = "slew_limit"
    component = "actuator"
    port = "command"
    default_side = "motor"
    parameters = (Parameter("rate", "u/s", lower=1e-12, linear=False),)
    depends_on = ("time", "command")
    ladder = ("rate", np.geomspace(0.7, 1.4, 15))
    siblings = ("saturation", "actuator_lag", "input_delay")
    fixed_amount = True
    law = staticmethod(_law)

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0]

    def after_command(self, state, command):  # type: ignore[no-untyped-def]
        return [command]

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        change = np.abs(np.diff(motion.u)) / motion.sample_time
        fastest = float(change.max(initial=0.0))
        moving = change[change > 1e-6 * fastest]
        if not len(moving):
            return []
        rates = np.unique([*np.quantile(moving, QUANTILES), *(fastest * SHARES)])
        return [{"rate": float(rate)} for rate in rates]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        most = nonlinear["rate"] * motion.sample_time
        return np.column_stack([_limited(np.ascontiguousarray(motion.u), most) - motion.u])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return dict(nonlinear)

    def says(self, values: Parameters, plant: Plant) -> str:
        return f"The drive changes by no more than {self.quantity(values, 'rate', plant)} (slew limit)."

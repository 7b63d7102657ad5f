"""A first-order lag between command and force, such as a current loop."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import MEAN, SLOPE, STEP
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _moments(steps: float) -> tuple[float, float]:
    """Mean of exp(-a s) over 0 <= s <= 1 and its integral against 2 s - 1, a = `steps`."""
    if steps < 1e-3:
        return 1.0 - steps / 2.0 + steps * steps / 6.0, -steps / 6.0 + steps * steps / 12.0
    if steps > 700.0:
        mean = 1.0 / steps
        return mean, 2.0 * mean * mean - mean
    decay = np.exp(-steps)
    mean = (1.0 - decay) / steps
    return mean, 2.0 * (1.0 - (1.0 + steps) * decay) / (steps * steps) - mean


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: time_constant; s: lagged command, then constants of the step: mean and moment of the decay,
    decay over the step. Exact for a command that runs straight over the step."""
    if p[0] <= 1e-9 * io[STEP]:
        return
    ratio = p[0] / io[STEP]
    u, slope = io[MEAN], io[SLOPE]
    follow = u - slope - 2.0 * ratio * slope  # the particular solution at the start of the step
    excess = s[0] - follow
    mean, moment = s[1], s[2]
    io[MEAN] = u - 2.0 * ratio * slope + excess * mean
    io[SLOPE] = slope + 3.0 * excess * moment
    s[0] = u + slope - 2.0 * ratio * slope + excess * s[3]


class ActuatorLag(Effect):
    """time_constant du_a/dt = u - u_a; u_a drives the plant."""

    name = "actuator_lag"
    component = "actuator"
    port = "command"
    default_side = "motor"
    parameters = (Parameter("time_constant", "s"),)
    depends_on = ("time", "command")
    siblings = ("input_delay", "viscous_friction", "flexible_mode")
    law = staticmethod(_law)

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        steps = step / max(packed[0], 1e-12 * step)
        mean, moment = _moments(steps)
        return [0.0, mean, moment, float(np.exp(-steps))]

    def after_command(self, state, command):  # type: ignore[no-untyped-def]
        return [command, *state[1:]]

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        return [{"shape": s * motion.sample_time} for s in np.geomspace(0.25, 32.0, 8)]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        """(lagged u - u)/tau for the time constant `shape`; its coefficient is the time constant."""
        shape = nonlinear["shape"]
        decay = np.exp(-motion.sample_time / shape)
        from scipy.signal import lfilter  # half a second to import

        lagged = lfilter([0.0, 1.0 - decay], [1.0, -decay], motion.u - motion.u[0]) + motion.u[0]
        share = (1.0 - decay) * shape / motion.sample_time  # mean over the held sample
        mean = motion.u + (lagged - motion.u) * share
        return np.column_stack([(mean - motion.u) / shape])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return {"time_constant": max(float(coefficients[0]), 0.0)}

    def says(self, values: Parameters, plant: Plant) -> str:
        lag = values["time_constant"]
        said = f"{lag:.4g} s" if lag >= 1.0 else f"{lag * 1e3:.4g} ms"
        return f"The force follows the command with a first-order lag of {said}."

"""A command that arrives late, by fractions of a sample too."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import MEAN, SLOPE
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: delay; s: steps to wait n, fraction phi, place in the ring, ring of n + 2 past values.

    The command is constant over each step; delayed by (n + phi) steps it changes within the step,
    and the line handed on has its mean and its first moment.
    """
    n, phi = int(s[0]), s[1]
    place, size = int(s[2]), int(s[0]) + 2
    s[3 + place] = io[MEAN]
    new = s[3 + (place - n + size) % size]
    old = s[3 + (place - n - 1 + size) % size]
    s[2] = float((place + 1) % size)
    io[MEAN] = phi * old + (1.0 - phi) * new
    io[SLOPE] = 3.0 * phi * (1.0 - phi) * (new - old)


class InputDelay(Effect):
    """u delayed by `delay` seconds, whatever fraction of a sample that is."""

    name = "input_delay"
    component = "actuator"
    port = "command"
    default_side = "motor"
    parameters = (Parameter("delay", "s"),)
    depends_on = ("time", "command")
    siblings = ("actuator_lag", "viscous_friction")
    law = staticmethod(_law)

    def order(self, values: Parameters) -> int:
        """First: what is late is late alike before all else and behind it, and the law is exact where a
        command stands still over a step (behind a lag it was 0.06 ms off, with errors of 0.01 ms). A
        limit of that command goes before: it would meet the mean of two samples."""
        return -1

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        whole = np.floor(packed[0] / step * (1 + 1e-12))
        phi = max(packed[0] / step - whole, 0.0)
        return [float(whole), float(phi), 0.0, *np.zeros(int(whole) + 2)]

    def after_command(self, state, command):  # type: ignore[no-untyped-def]
        return [*state[:3], *np.full(len(state) - 3, command)]

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        return [{"shape": s * motion.sample_time} for s in (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        """(delayed u - u)/delay for the delay `shape`; its coefficient is the delay."""
        shape = nonlinear["shape"]
        t = np.arange(len(motion.u)) * motion.sample_time
        late = np.interp(t - shape, t, motion.u, left=motion.u[0])
        return np.column_stack([(late - motion.u) / shape])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return {"delay": max(float(coefficients[0]), 0.0)}

    def says(self, values: Parameters, plant: Plant) -> str:
        samples = values["delay"] / plant.sample_time
        delay = values["delay"]
        said = f"{delay:.4g} s" if delay >= 1.0 else f"{delay * 1e3:.4g} ms"
        return f"The command arrives {said} late ({samples:.3g} samples)."

"""Cogging: a force that repeats along the position."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters, Setting
from ffl.effects.law import COMMIT, FIRST, X0
from ffl.effects.periods import harmonics, sine_pair, wave_numbers
from ffl.effects.solve import end_motion, set_line
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: period, number of harmonics n, then amplitude and phase of each; s: both end forces.

    Newton on the force at the end; the stiffness of cogging is small against the inertia over one
    step, so three rounds leave rounding.
    """
    if io[COMMIT] != 0.0:
        return
    wave = 2.0 * np.pi / p[0]
    if io[FIRST] != 0.0:
        s[0] = 0.0
        for i in range(int(p[1])):
            s[0] += p[2 + 2 * i] * np.sin((i + 1) * wave * io[X0] + p[3 + 2 * i])
    xa, gx, _, _ = end_motion(io, s[0])
    force = s[1]
    for _ in range(6):
        wanted, slope = 0.0, 0.0
        for i in range(int(p[1])):
            angle = (i + 1) * wave * (xa + gx * force) + p[3 + 2 * i]
            wanted += p[2 + 2 * i] * np.sin(angle)
            slope += p[2 + 2 * i] * (i + 1) * wave * np.cos(angle)
        following = force - (force - wanted) / (1.0 - gx * slope)
        done = abs(following - force) <= 1e-12 * (abs(force) + abs(wanted))
        force = following
        if done:
            break
    s[1] = force
    set_line(io, s[0], force)


class Cogging(Effect):
    """F = sum_i amplitude_i sin(2 pi i x/period + phase_i)."""

    name = "cogging"
    component = "actuator"
    default_side = "motor"
    parameters = (
        Parameter("amplitude", "F"),
        Parameter("period", "x", lower=1e-12, linear=False),
        Parameter("phase", "rad", lower=-np.inf, default=0.0),
    )
    depends_on = ("position",)
    siblings = ("encoder_ripple", "position_dependent_friction", "periodic_disturbance")
    scan = "position"
    law = staticmethod(_law)

    def parameter(self, name: str) -> Parameter:
        stem, _, order = name.partition("_")
        if order.isdigit() and int(order) >= 2 and stem in ("amplitude", "phase"):
            base = super().parameter(stem)
            return Parameter(name, base.unit, base.lower, base.upper, base.linear, 0.0)
        return super().parameter(name)

    def pack(self, values: Parameters, setting: Setting) -> list[float]:
        pairs = harmonics(values)
        scale = 1.0 / setting.force_per_input
        numbers = [number for a, phi in pairs for number in (a * scale, phi)]
        return [values["period"], float(len(pairs)), *numbers]

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0, 0.0]

    def stiffness(self, packed):  # type: ignore[no-untyped-def]
        amplitudes = np.abs(packed[2::2]) * np.arange(1, int(packed[1]) + 1)
        return float(2 * np.pi / packed[0] * amplitudes.sum())

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        return [{"period": 1.0 / k} for k in wave_numbers(motion)]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        angle = 2 * np.pi * motion.x / nonlinear["period"]
        return np.column_stack([np.sin(angle), np.cos(angle)])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return {**nonlinear, **sine_pair(coefficients)}

    def says(self, values: Parameters, plant: Plant) -> str:
        more = len(harmonics(values)) - 1
        tail = f", with {more} more harmonic{'s' if more > 1 else ''}" if more else ""
        return (
            f"A force of {self.quantity(values, 'amplitude', plant)} repeats every "
            f"{self.quantity(values, 'period', plant)} along the position (cogging){tail}."
        )

"""Cogging: a force that repeats along the position."""

from __future__ import annotations

import numpy as np
from numba import njit

from ffl.effects.base import Effect, Motion, Parameter, Parameters, Setting
from ffl.effects.law import FIRST, GX, X0
from ffl.effects.periods import harmonics, sine_pair, wave_numbers
from ffl.effects.solve import bulge_of, end_motion, middle_motion, set_curve
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


@njit(error_model="numpy")
def _force(p, x):  # type: ignore[no-untyped-def]
    """Force and its derivative; harmonics by turning (sin, cos) on, one sine and cosine in all.

    p: wave number, number of harmonics n, then amplitude times (cos, sin) of the phase of each.
    """
    sine, cosine = np.sin(p[0] * x), np.cos(p[0] * x)
    s, c, force, slope = sine, cosine, 0.0, 0.0
    for i in range(int(p[1])):
        along, across = p[2 + 2 * i], p[3 + 2 * i]
        force += along * s + across * c
        slope += (i + 1) * p[0] * (along * c - across * s)
        s, c = s * cosine + c * sine, c * cosine - s * sine
    return force, slope


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """s: force at the start and at the end of the step (iterate), position of that end,
    bulge of the force between. Newton: the
    stiffness of cogging is small against the inertia over one step, so two rounds leave rounding."""
    if io[FIRST] != 0.0:
        if abs(io[X0] - s[2]) * p[0] * p[1] < 1e-10:  # this step starts where the last one ended
            s[0] = s[1]
        else:
            s[0], _ = _force(p, io[X0])
        s[3] = 0.0
    end, bulge, x1 = s[1], s[3], 0.0
    for _ in range(8):
        xa, gx, va, gv = end_motion(io, s[0], bulge)
        wanted, slope = _force(p, xa + gx * end)
        change = (wanted - end) / (1.0 - gx * slope)
        end += change
        x1 = xa + gx * end
        half, _ = middle_motion(io, x1, va + gv * end)
        middle, _ = _force(p, half)
        more = bulge_of(s[0], middle, end) - bulge
        bulge += more
        # What another round would change: quadratic in the end force, linear in the bulge.
        turn, drift = p[0] * p[1] * gx * change, p[0] * p[1] * io[GX] * more
        if turn * turn < 1e-10 and abs(drift) < 1e-6:
            break
    s[1], s[2], s[3] = end, x1, bulge
    set_curve(io, s[0], end, bulge)


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
    siblings = (
        "encoder_ripple",
        "position_dependent_friction",
        "periodic_disturbance",
        "hardening_spring",
    )
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
        parts = [scale * a * turn(phi) for a, phi in pairs for turn in (np.cos, np.sin)]
        return [2 * np.pi / values["period"], float(len(pairs)), *parts]

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0, 0.0, np.inf, 0.0]

    def stiffness(self, packed):  # type: ignore[no-untyped-def]
        amplitudes = np.hypot(packed[2::2], packed[3::2])
        return float(packed[0] * amplitudes @ np.arange(1, int(packed[1]) + 1))

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        return [{"period": 1.0 / k} for k in wave_numbers(motion)]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        """Sine and cosine over the `period`, then those of its `harmonics` (1: none)."""
        angle = 2 * np.pi * motion.x / nonlinear["period"]
        orders = range(1, int(nonlinear.get("harmonics", 1)) + 1)
        return np.column_stack([turn(k * angle) for k in orders for turn in (np.sin, np.cos)])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return {**nonlinear, **sine_pair(coefficients)}

    def nonlinear_of(self, values: Parameters) -> dict[str, float]:
        return {"period": values["period"], "harmonics": len(harmonics(values))}

    def coefficients_of(self, values: Parameters) -> Array:
        pairs = harmonics(values)
        return np.array([a * turn(phi) for a, phi in pairs for turn in (np.cos, np.sin)])

    def says(self, values: Parameters, plant: Plant) -> str:
        more = len(harmonics(values)) - 1
        tail = f", with {more} more harmonic{'s' if more > 1 else ''}" if more else ""
        return (
            f"A force of {self.quantity(values, 'amplitude', plant)} repeats every "
            f"{self.quantity(values, 'period', plant)} along the position (cogging){tail}."
        )

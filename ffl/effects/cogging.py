"""Cogging: a force that repeats along the position."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Parameter, Parameters
from ffl.effects.law import FIRST, GX, X0
from ffl.effects.periods import Repeating, series
from ffl.effects.solve import bulge_of, end_motion, middle_motion, set_curve
from ffl.systems.plant import Plant


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """s: force at the start and at the end of the step (iterate), position of that end,
    bulge of the force between. Newton: the
    stiffness of cogging is small against the inertia over one step, so two rounds leave rounding."""
    if io[FIRST] != 0.0:
        if abs(io[X0] - s[2]) * p[0] * p[1] < 1e-10:  # this step starts where the last one ended
            s[0] = s[1]
        else:
            s[0], _ = series(p, io[X0])
        s[3] = 0.0
    end, bulge, x1 = s[1], s[3], 0.0
    for _ in range(8):
        xa, gx, va, gv = end_motion(io, s[0], bulge)
        wanted, slope = series(p, xa + gx * end)
        change = (wanted - end) / (1.0 - gx * slope)
        end += change
        x1 = xa + gx * end
        half, _ = middle_motion(io, x1, va + gv * end)
        middle, _ = series(p, half)
        more = bulge_of(s[0], middle, end) - bulge
        bulge += more
        # What another round would change: quadratic in the end force, linear in the bulge.
        turn, drift = p[0] * p[1] * gx * change, p[0] * p[1] * io[GX] * more
        if turn * turn < 1e-10 and abs(drift) < 1e-6:
            break
    s[1], s[2], s[3] = end, x1, bulge
    set_curve(io, s[0], end, bulge)


class Cogging(Repeating):
    """F = sum_i amplitude_i sin(2 pi i x/period + phase_i)."""

    name = "cogging"
    component = "actuator"
    default_side = "motor"
    parameters = (
        Parameter("amplitude", "F"),
        Parameter("period", "x", lower=1e-12, linear=False),
        Parameter("phase", "rad", lower=-np.inf, default=0.0),
    )
    siblings = (
        "encoder_ripple",
        "position_dependent_friction",
        "periodic_disturbance",
        "hardening_spring",
    )
    law = staticmethod(_law)

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0, 0.0, np.inf, 0.0]

    def stiffness(self, packed):  # type: ignore[no-untyped-def]
        amplitudes = np.hypot(packed[2::2], packed[3::2])
        return float(packed[0] * amplitudes @ np.arange(1, int(packed[1]) + 1))

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"A force of {self.quantity(values, 'amplitude', plant)} repeats every "
            f"{self.quantity(values, 'period', plant)} along the position (cogging){self.more(values)}."
        )

"""A spring that was tightened before it meets the machine: it pushes at once, from either side."""

from __future__ import annotations

import numpy as np
from numba import njit

from ffl.effects.base import Effect, Extent, Motion, Parameter, Parameters
from ffl.effects.law import GX, GX_SLOPE, MEAN, SLOPE, X0, X1
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array

PLACES = 25  # along the travel that are screened
WIDTHS = (0.002, 0.02)  # of the travel
WIDEST, NARROWEST = 0.25, 1e-4  # of it: over more it is a spring, and less shows nowhere
PASSED = 2.0  # widths from the centre, to either side, that the machine must have been


@njit(error_model="numpy")
def _over_a_line(z0, z1):  # type: ignore[no-untyped-def]
    """(mean, slope) of clip(z, -1, 1) along a straight z0 -> z1: the line of the same first moment."""
    way = z1 - z0
    here, there = min(max(z0, -1.0), 1.0), min(max(z1, -1.0), 1.0)
    if abs(way) < 1e-3 or here * there == 1.0:  # short, or all on one side
        middle = min(max(0.5 * (z0 + z1), -1.0), 1.0)
        return (here + 4.0 * middle + there) / 6.0, 0.5 * (there - here)
    # Integrals of the clip: once, a(z) = z here - here^2/2, and twice, b(z).
    a0, a1 = z0 * here - 0.5 * here * here, z1 * there - 0.5 * there * there
    b0 = 0.5 * z0 * z0 * here - 0.5 * z0 * here * here + here * here * here / 6.0
    b1 = 0.5 * z1 * z1 * there - 0.5 * z1 * there * there + there * there * there / 6.0
    mean = (a1 - a0) / way
    moment = (a1 - (b1 - b0) / way) / way  # of s in 0 .. 1
    return mean, 6.0 * (moment - 0.5 * mean)


@njit(error_model="numpy")
def _error(p, io, z0, free, end):  # type: ignore[no-untyped-def]
    """By how much the step ends beyond where the force over it lets it end, and the line of that force."""
    mean, slope = _over_a_line(z0, end)
    return end - free + (io[GX] * mean + io[GX_SLOPE] * slope) * p[0] / p[2], mean, slope


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: preload, centre, width. The way is taken to be straight within the step. The force falls along
    it, so it ends at one place: secants within a bracket (Illinois), one where the force is the same."""
    z0 = (io[X0] - p[1]) / p[2]
    free = (io[X1] - p[1]) / p[2]
    reach = (abs(io[GX]) + abs(io[GX_SLOPE])) * p[0] / p[2]
    low, high = free - reach, free + reach
    under, mean, slope = _error(p, io, z0, free, low)
    over, _, _ = _error(p, io, z0, free, high)
    last, side = low, 0
    for _ in range(60):
        if not over > under:
            break
        end = (low * over - high * under) / (over - under)
        error, mean, slope = _error(p, io, z0, free, end)
        if error == 0.0 or abs(end - last) <= 1e-13 * (1.0 + abs(end)):
            break
        last = end
        if error > 0.0:
            high, over = end, error
            under = 0.5 * under if side > 0 else under
            side = 1
        else:
            low, under = end, error
            over = 0.5 * over if side < 0 else over
            side = -1
    io[MEAN], io[SLOPE] = -p[0] * mean, -p[0] * slope


class PreloadedSpring(Effect):
    """F = -preload clip((x - centre)/width, -1, 1): a spring tightened against a stop on either side of
    `centre`, as the return springs of throttles, pedals, joysticks and valves are; `width` is half the
    way over which one side lets go and the other takes hold. What it gains beyond is a
    `linear_stiffness`."""

    name = "preloaded_spring"
    parameters = (
        Parameter("preload", "F"),
        Parameter("centre", "x", lower=-np.inf, linear=False, default=0.0),
        Parameter("width", "x", lower=1e-12, linear=False),
    )
    depends_on = ("position",)
    siblings = ("linear_stiffness", "hardening_spring", "gravity_torque")
    law = staticmethod(_law)

    def stiffness(self, packed):  # type: ignore[no-untyped-def]
        return float(packed[0] / packed[2])

    def credible(self, spec: EffectSpec, extent: Extent) -> bool:
        """A spring of which one end alone was passed by as much again as lies between centre and end, the
        other made up for by a load, is an end stop, or a spring that is stiffer on one side."""
        width, centre = (float(spec.parameters[name]) for name in ("width", "centre"))
        beyond = PASSED * width
        passed = extent.lowest < centre - beyond and centre + beyond < extent.highest
        return passed and NARROWEST * extent.travel < width < WIDEST * extent.travel

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        at = motion.middle + motion.span * np.linspace(-0.5, 0.5, PLACES + 2)[1:-1]
        widths = [share * motion.span for share in WIDTHS]
        return [{"centre": float(c), "width": w} for w in widths for c in at]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        away = (motion.x - nonlinear["centre"]) / nonlinear["width"]
        return -np.clip(away, -1.0, 1.0)[:, None]

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"A preloaded spring pushes towards {self.quantity(values, 'centre', plant)} with "
            f"{self.quantity(values, 'preload', plant)} from either side."
        )

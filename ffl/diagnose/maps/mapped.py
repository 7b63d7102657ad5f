"""A map as the kernel runs it: its force is solved with the motion of its own sub-step.

A map whose signal is repeated along the motion that it makes (`FreeModel.simulate`) comes to rest in
a loop that holds the machine. On a lightly damped stage that nothing holds it does not: drag of ten
times the stage's own damping is answered ten times too large, again and again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from ffl.effects import Effect, Setting
from ffl.effects.base import Law, Parameters
from ffl.effects.law import GV, GV_SLOPE, GX, GX_SLOPE, MEAN, SENT, SLOPE, STEP, V0, V1, X0, X1
from ffl.effects.solve import middle_motion
from ffl.systems.plant import EffectSpec

if TYPE_CHECKING:
    from ffl.diagnose.maps.freemodel import Part

# What a force is: g(x), g(v), v g(x), direction g(x), g(x) a + g'(x) v^2/2, direction |u| g, v g(x)
# upwards or downwards alone, u^2 g(x), g(v) a, and direction g(a);
BY_POSITION, BY_VELOCITY, DAMPING, DRY, INERTIA = range(5)
DRY_BY_COMMAND, DAMPING_UP, DAMPING_DOWN, PULL, INERTIA_BY_SPEED = range(11, 16)
DRY_BY_ACCELERATION = 17
# what comes to a command: g(u), u g(x), u g(|v|) with a g for pushing and one for pulling, and what a limit
# cuts off that falls with |v|;
BY_COMMAND, GAIN, GAIN_BY_SPEED, FALLING = range(5, 9)
# and what comes to y: g(x), g(v), g(u) of the command before.
SHOWN_POSITION, SHOWN_VELOCITY, SHOWN_COMMAND = 9, 10, 16
BEYOND = 0.25  # of a grid's extent: a map goes on straight that far, from there it is constant
SWEEPS = 60
FLOOR = 1e-3  # of the largest velocity: slower than that there is no direction (`Motion.direction`)
EXACT = 1e-10  # of the force: change of it that ends the sweeps
STIFF = 1.0  # change of the force within a sub-step, of its cause: more is taken at the end alone
HEAD = 4  # numbers before the knots: kind, least speed of a direction, steepest dF/dv, how many


@njit(error_model="numpy")
def _at(p, values, n, z):  # type: ignore[no-untyped-def]
    """(g, dg/dz) of the map over the n knots that begin at p[HEAD], with its values from p[values]."""
    last = HEAD + n - 1
    reach = BEYOND * (p[last] - p[HEAD])
    inside = min(max(z, p[HEAD] - reach), p[last] + reach)
    low, high = 0, n - 1
    while high - low > 1:
        half = (low + high) // 2
        if p[HEAD + half] <= inside:
            low = half
        else:
            high = half
    width = max(p[HEAD + low + 1] - p[HEAD + low], 1e-300)
    slope = (p[values + low + 1] - p[values + low]) / width
    value = p[values + low] + slope * (inside - p[HEAD + low])
    return value, slope if inside == z else 0.0


@njit(error_model="numpy")
def _smooth(p, first, values, n, z):  # type: ignore[no-untyped-def]
    """g(z) of the map over the n even knots that begin at p[first], with its values from p[values]: of
    third order between four of them, a parabola as it is, and straight beyond. A sensor shows every
    kink of its scale."""
    last = first + n - 1
    width = max((p[last] - p[first]) / (n - 1), 1e-300)
    reach = BEYOND * (p[last] - p[first])
    at = (min(max(z, p[first] - reach), p[last] + reach) - p[first]) / width
    low = min(max(int(np.floor(at)), 0), n - 2)
    t = min(max(at - low, 0.0), 1.0)
    k = values + low
    one, two = p[k], p[k + 1]
    before = p[k - 1] if low > 0 else 3.0 * one - 3.0 * two + p[k + 2]
    after = p[k + 2] if low < n - 2 else 3.0 * two - 3.0 * one + p[k - 1]
    rise, fall = 0.5 * (two - before), 0.5 * (after - one)  # slopes at both ends, times the width
    bend, twist = 3.0 * (two - one) - 2.0 * rise - fall, rise + fall - 2.0 * (two - one)
    beyond = at - low - t
    return one + t * (rise + t * (bend + t * twist)) + beyond * (rise if beyond < 0.0 else fall)


@njit(error_model="numpy")
def smoothed(grid, values, z):  # type: ignore[no-untyped-def]
    """(N, k): maps of `values` (n, k) over an even `grid` (n,), at every z (N,), as the kernel has them."""
    n, out = len(grid), np.empty((len(z), values.shape[1]))
    for column in range(values.shape[1]):
        p = np.concatenate((grid, values[:, column]))
        for row in range(len(z)):
            out[row, column] = _smooth(p, 0, n, n, z[row])
    return out


@njit(error_model="numpy")
def _force(p, x, v, a, u):  # type: ignore[no-untyped-def]
    """(F, dF/dx, dF/dv, dF/da) at a motion, under a command."""
    kind, n = int(p[0]), int(p[3])
    first = HEAD + n
    if kind == BY_VELOCITY:
        g, slope = _at(p, first, n, v)
        return g, 0.0, slope, 0.0
    if kind == INERTIA_BY_SPEED:
        g, slope = _at(p, first, n, v)
        return g * a, 0.0, slope * a, g
    direction = min(max(v / p[1], -1.0), 1.0)
    turning = 1.0 / p[1] if abs(v) < p[1] else 0.0
    if kind == DRY_BY_COMMAND:
        level = p[first] * abs(u)
        return level * direction, 0.0, level * turning, 0.0
    if kind == DRY_BY_ACCELERATION:
        g, slope = _at(p, first, n, a)
        return g * direction, 0.0, g * turning, slope * direction
    g, slope = _at(p, first, n, x)
    if kind == BY_POSITION:
        return g, slope, 0.0, 0.0
    if kind == PULL:
        return u * u * g, u * u * slope, 0.0, 0.0
    if kind == DAMPING:
        return g * v, slope * v, g, 0.0
    if kind in (DAMPING_UP, DAMPING_DOWN):
        if (v > 0.0) != (kind == DAMPING_UP):
            return 0.0, 0.0, 0.0, 0.0
        return g * v, slope * v, g, 0.0
    if kind == DRY:
        return g * direction, slope * direction, g * turning, 0.0
    rise, bend = _at(p, first + n, n, x)
    return g * a + 0.5 * rise * v * v, slope * a + 0.5 * bend * v * v, rise * v, g


def _force_law(p, s, io):  # type: ignore[no-untyped-def]
    """Newton on the mean force, between what is known to be too small and too large: of the parabola
    through start, middle and end of the sub-step, or the end alone where the force is stiff (a jump at
    standstill), which does not ring."""
    step, mean, line, u = io[STEP], io[MEAN], io[SLOPE], io[SENT]
    stiff = p[2] * io[GV] > STIFF
    below, above = -np.inf, np.inf
    for _ in range(SWEEPS):
        x1 = io[X1] + io[GX] * mean + io[GX_SLOPE] * line
        v1 = io[V1] + io[GV] * mean + io[GV_SLOPE] * line
        a = (v1 - io[V0]) / step
        end, by_x, by_v, by_a = _force(p, x1, v1, a, u)
        answer = by_x * io[GX] + (by_v + by_a / step) * io[GV]
        wanted = end
        if not stiff:
            begin, _, _, _ = _force(p, io[X0], io[V0], a, u)
            x, v = middle_motion(io, x1, v1)
            middle, _, _, _ = _force(p, x, v, a, u)
            wanted = (begin + 4.0 * middle + end) / 6.0
            line = 0.5 * (end - begin)
            answer = 0.5 * (by_x * io[GX] + by_v * io[GV]) + by_a * io[GV] / step
        if wanted > mean:
            below = mean
        else:
            above = mean
        last, mean = mean, mean + (wanted - mean) / max(1.0 - answer, 0.5)
        if not below < mean < above and above - below < np.inf:  # round a kink and back again
            mean = 0.5 * (below + above)
        if abs(mean - last) <= EXACT * abs(mean):
            break
    io[MEAN], io[SLOPE] = mean, 0.0 if stiff else line


def _command_law(p, s, io):  # type: ignore[no-untyped-def]
    """The command at the middle of the sub-step, and where the machine is then."""
    kind, n = int(p[0]), int(p[3])
    u = io[MEAN]
    if kind == FALLING:
        limit = max(p[HEAD] - p[HEAD + 1] * abs(io[V0]), 0.0)
        if abs(u) > limit:
            io[MEAN] = limit if u > 0.0 else -limit
            io[SLOPE] = 0.0
        return
    if kind == BY_COMMAND:
        g, slope = _at(p, HEAD + n, n, u)
        io[MEAN] += g
        io[SLOPE] *= 1.0 + slope
        return
    at = io[X0] + 0.5 * io[STEP] * io[V0]
    first = HEAD + n
    if kind == GAIN_BY_SPEED:
        at, first = abs(io[V0]), first if u >= 0.0 else first + n
    g, _ = _at(p, first, n, at)
    io[MEAN] += u * g
    io[SLOPE] *= 1.0 + g


def _output_law(p, s, io):  # type: ignore[no-untyped-def]
    kind, n, last = int(p[0]), int(p[3]), HEAD + int(p[3])
    if kind == SHOWN_POSITION:
        io[MEAN] += _smooth(p, HEAD, last, n, io[X0])
    else:
        io[MEAN] += _at(p, last, n, io[V0] if kind == SHOWN_VELOCITY else io[SENT])[0]


LAWS = {"force": _force_law, "command": _command_law, "output": _output_law}


class Mapped(Effect):
    """One map at its place, with its numbers: in no catalogue, and of no use but to be simulated."""

    name = "map"
    parameters = ()
    depends_on = ("position", "velocity")

    def __init__(self, part: Part) -> None:
        self._part = part

    @property
    def spec(self) -> EffectSpec:
        place = self._part.place
        given = {"side": place.side, "mass_ratio": place.mass_ratio}
        return EffectSpec(self.name, {}, {k: v for k, v in given.items() if v is not None})

    def port_in(self, setting: Setting) -> str:
        return self._part.place.port

    def law_in(self, setting: Setting) -> Law:
        return LAWS[self._part.place.port]

    def pack(self, values: Parameters, setting: Setting) -> list[float]:
        part = self._part
        knots, g = part.term.knots(part.ranges), part.coefficients
        floor = FLOOR * max(max(abs(v) for v in part.ranges["v"]), 1e-300)
        kind, tail = part.term.kind, []
        assert kind is not None  # it runs in the loop
        steepest = 0.0
        if kind == BY_VELOCITY:
            steepest = float(np.abs(np.diff(g) / np.diff(knots)).max())
        elif kind in (DAMPING, DAMPING_UP, DAMPING_DOWN, DRY, DRY_BY_ACCELERATION):
            dry = kind in (DRY, DRY_BY_ACCELERATION)
            steepest = float(np.abs(g).max()) / (floor if dry else 1.0)
        elif kind == DRY_BY_COMMAND:
            steepest = float(np.abs(g).max() * knots[-1]) / floor
        elif kind == INERTIA:
            tail = list(np.gradient(g, np.maximum(np.ptp(knots), 1e-300) / (len(knots) - 1)))
        return [float(kind), floor, steepest, float(len(knots)), *knots, *g, *tail]

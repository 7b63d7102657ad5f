"""Lost motion between motor and load."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from ffl.effects.base import Effect, Law, Motion, Parameter, Parameters, Setting
from ffl.effects.law import (
    GV,
    GV_SLOPE,
    GX,
    GX_SLOPE,
    MEAN,
    SLOPE,
    STEP,
    TIME,
    V0,
    V1,
    X0,
    X1,
)
from ffl.effects.mechanics import Mechanics
from ffl.effects.paths import beyond, play
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array


def _play_law(p, s, io):  # type: ignore[no-untyped-def]
    """p: gap; s: output of the play relative to y, started (0 or 1), speed and time of the sample before.

    The load stays where it is while the motor crosses the gap (a load held by its own friction). Where
    the motor turned since the sample before, the load has gone as far as it went in between.
    """
    half, x, v = 0.5 * p[0], io[X0], io[V0]
    if s[1] == 0.0:
        s[0], s[1] = x, 1.0
    for at in (x + beyond(s[2], v, io[TIME] - s[3]), x):
        s[0] = min(max(s[0], at - half), at + half)
    s[2], s[3] = v, io[TIME]
    io[MEAN] += s[0] - x


@njit(error_model="numpy")
def _stretch(io, x1, v1, f):  # type: ignore[no-untyped-def]
    """Stretch and its rate at the fraction f of the step: the cubic through both ends' motion."""
    x0, h = io[X0], io[STEP]
    rise, bend = x1 - x0, h * io[V0]
    square = 3.0 * rise - 2.0 * bend - h * v1
    cube = bend + h * v1 - 2.0 * rise
    x = x0 + f * (bend + f * (square + f * cube))
    return x, (bend + f * (2.0 * square + 3.0 * f * cube)) / h


@njit(error_model="numpy")
def _passage(io, x1, v1, wall):  # type: ignore[no-untyped-def]
    """Fraction of the step at which the stretch passes `wall`; the ends lie on either side of it."""
    low, high, below = 0.0, 1.0, io[X0] < wall
    for _ in range(30):
        half = 0.5 * (low + high)
        if (_stretch(io, x1, v1, half)[0] < wall) == below:
            low = half
        else:
            high = half
    return 0.5 * (low + high)


@njit(error_model="numpy")
def _piece(p, io, x1, v1, begin, end):  # type: ignore[no-untyped-def]
    """Integral and first moment of the force from `begin` to `end`, three Gauss points."""
    half, middle, wide = 0.5 * p[0], 0.5 * (begin + end), 0.5 * (end - begin)
    x, _ = _stretch(io, x1, v1, middle)
    total, moment = 0.0, 0.0
    for node in range(-1, 2):
        f = middle + node * wide * 0.7745966692414834
        weight = wide * (8.0 / 9.0 if node == 0 else 5.0 / 9.0)
        stretch, rate = _stretch(io, x1, v1, f)
        force = p[1] * stretch + p[2] * rate
        if x > half:
            force += min(0.0, -p[1] * (stretch - half) - p[3] * rate)
        elif x < -half:
            force += max(0.0, -p[1] * (stretch + half) - p[3] * rate)
        total += weight * force
        moment += weight * (2.0 * f - 1.0) * force
    return total, moment


def _gap_law(p, s, io):  # type: ignore[no-untyped-def]
    """p: gap, stiffness and damping of the coupling, damping in contact.

    The plant holds the coupling as spring and damper; this force takes both away and puts a contact
    in their place that pushes beyond the gap and never pulls. The moments at which the stretch passes a
    wall of the gap are located within the step.
    """
    half = 0.5 * p[0]
    mean, slope = io[MEAN], io[SLOPE]
    for _ in range(12):
        x1 = io[X1] + io[GX] * mean + io[GX_SLOPE] * slope
        v1 = io[V1] + io[GV] * mean + io[GV_SLOPE] * slope
        first, second = 1.0, 1.0
        if (io[X0] < -half) != (x1 < -half):
            first = _passage(io, x1, v1, -half)
        if (io[X0] < half) != (x1 < half):
            second = _passage(io, x1, v1, half)
        if second < first:
            first, second = second, first
        total, moment = _piece(p, io, x1, v1, 0.0, first)
        if first < 1.0:
            t, m = _piece(p, io, x1, v1, first, second)
            total, moment = total + t, moment + m
        if second < 1.0:
            t, m = _piece(p, io, x1, v1, second, 1.0)
            total, moment = total + t, moment + m
        change = abs(total - mean) + abs(3.0 * moment - slope)
        mean, slope = total, 3.0 * moment
        if change <= 1e-10 * p[1] * half:
            break
    io[MEAN], io[SLOPE] = mean, slope


PLACES = {  # of the gap, where it is not between motor and load
    "play": "between the machine and its measuring head",
    "load": "before a part that knocks behind it",
}
LOAD = {"load_fraction": 0.3, "frequency": 150.0, "damping": 0.2}
RANGE = {"load_fraction": (0.03, 0.95), "frequency": (5.0, 2000.0), "damping": (0.002, 2.0)}
KINDS, PARTS = ("play", "coupling", "load"), ("motor", "load")


class Backlash(Effect):
    """Lost motion of total width `gap`, in one of three forms (key `kind`):

    "play"      y follows the motor's position with a play: the load keeps its place within the gap,
                held by friction of its own. Default for a plant without a mode.
    "coupling"  the spring between motor and load of a plant with a mode has a dead zone. Default
                there. Key `damping`: damping ratio in contact (default: the mode's own).
    "load"      the share `load_fraction` (0.3) of the moving mass lies behind the gap, on a contact
                spring that resonates with the rest at `frequency` (150 Hz) with `damping` (0.2); key
                `measured` = "motor" (default) or "load" says which part the sensor sees,
                `damped` on which of the two the damping of a rigid plant acts.
    """

    name = "backlash"
    component = "transmission"
    parameters = (Parameter("gap", "x"),)
    options = {  # noqa: RUF012
        "kind": KINDS, "measured": PARTS, "damped": PARTS, **dict.fromkeys(LOAD)
    }  # fmt: skip
    sides = ("sensor",)
    depends_on = ("direction", "history")
    ladder = ("gap", np.geomspace(0.02, 50.0, 16))
    siblings = ("hysteresis", "coulomb_friction", "dead_zone", "presliding_friction")
    port = "output"

    def check_option(self, name, value):  # type: ignore[no-untyped-def]
        super().check_option(name, value)
        self.require(
            name != "load_fraction" or value < 1.0, f"load_fraction = {value} must lie below 1"
        )

    def kind_in(self, setting: Setting) -> str:
        flexible = len(setting.mechanics.modes) > 1
        return str(setting.options.get("kind", "coupling" if flexible else "play"))

    def port_in(self, setting: Setting) -> str:
        return "output" if self.kind_in(setting) == "play" else "force"

    def law_in(self, setting: Setting) -> Law:
        return _play_law if self.kind_in(setting) == "play" else _gap_law

    def side_in(self, setting: Setting) -> str:
        return {"play": "sensor", "coupling": "coupling", "load": self.name}[self.kind_in(setting)]

    def turn(self, spec: EffectSpec) -> int:
        return 0 if spec.options.get("kind") == "load" else 2

    def modify(self, mechanics: Mechanics, values: Parameters, setting: Setting) -> Mechanics:
        if self.kind_in(setting) != "load":
            return mechanics
        share, frequency, damping = (setting.options.get(k, v) for k, v in LOAD.items())
        seen, damped = (setting.options.get(k, PARTS[0]) == "load" for k in ("measured", "damped"))
        self.require(
            not damped or len(mechanics.modes) == 1,
            'damped = "load" needs a rigid plant, whose damping is that of one body; leave it out',
        )
        side = ("sensor", setting.mass_ratio)
        return mechanics.with_part_on_spring(
            self.name, side, share, frequency, damping, seen, damped
        )

    def pack(self, values: Parameters, setting: Setting) -> list[float]:
        kind = self.kind_in(setting)
        if kind == "play":
            self.require(
                setting.mechanics.place is None,
                'kind = "play" needs a plant whose output is a position; here it is a speed: take '
                'kind = "load"',
            )
            return [values["gap"]]
        mobility = setting.point(self.side_in(setting)).mobility
        if kind == "load":
            _, frequency, damping = (setting.options.get(k, v) for k, v in LOAD.items())
            square, rate = (2 * np.pi * frequency) ** 2, 4 * np.pi * damping * frequency
            return [values["gap"], square / mobility, rate / mobility, rate / mobility]
        self.require(
            len(setting.mechanics.modes) > 1,
            'kind = "coupling" needs a plant with a mode; take kind = "play" or "load"',
        )
        stiffness, damping = setting.mechanics.coupling(setting.mass_ratio)
        ratio = setting.options.get("damping")
        contact = damping if ratio is None else 2.0 * ratio * np.sqrt(stiffness / mobility)
        return [values["gap"], stiffness, damping, contact]

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0, 0.0, 0.0, 0.0]

    def stiffness(self, packed):  # type: ignore[no-untyped-def]
        return packed[1] if len(packed) > 1 else 0.0

    def free_options(self, options):  # type: ignore[no-untyped-def]
        values = {name: options[name] for name in RANGE if name in options}
        if options.get("kind") == "load":
            values = {**LOAD, **values}
        return {name: (float(value), *RANGE[name]) for name, value in values.items()}

    def forms(self, flexible: bool, sample_time: float = 0.0) -> list[dict[str, Any]]:
        """Also a part that knocks behind the gap, but not where the slowest contact is over within two
        samples: such a recording shows a play alone, and to follow a contact takes all its time."""
        if flexible:
            return [{"kind": "coupling"}, {"kind": "play"}]
        if 2.0 * sample_time * RANGE["frequency"][0] >= 1.0:
            return [{"kind": "play"}]
        loads = [{"kind": "load", "measured": side} for side in PARTS]
        return [{"kind": "play"}, *loads]

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        return [{"shape": float(g)} for g in motion.span * np.geomspace(1e-5, 0.1, 9)]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        """(play - x)/gap in the shape it has at the gap `shape`; its coefficient is the gap."""
        shape = nonlinear["shape"]
        return np.column_stack(
            [(play(motion.x, shape, motion.v, motion.sample_time) - motion.x) / shape]
        )

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return {"gap": max(float(coefficients[0]), 0.0)}

    def says(self, values: Parameters, plant: Plant) -> str:
        where = PLACES.get(str(values.get("kind")), "in the transmission")
        return f"There is a play of {self.quantity(values, 'gap', plant)} {where} (backlash)."

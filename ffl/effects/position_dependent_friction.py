"""Friction whose level depends on position and direction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numba import njit
from scipy.interpolate import CubicSpline

from ffl.effects.base import Effect, Motion, Parameter, Parameters, Setting
from ffl.effects.bristle import carried, set_bristle
from ffl.effects.law import COMMIT, FIRST, GV, V0, V1, X0, X1
from ffl.effects.solve import middle_motion, set_friction
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

LEAST = 1e-12  # output units: travel before a level of zero slides
FINE = 8  # straight pieces of a curve between two knots
CUBIC = {"interpolation": "cubic"}
MUCH = 0.3  # of the level, at the ends: what a spring must make of it to be spoken of
LITTLE = 0.2  # of the variance of what the directions differ by: what a spring may leave


@njit(error_model="numpy")
def _levels(p, x):  # type: ignore[no-untyped-def]
    """Levels in + and - direction at x: straight between knots, constant beyond the ends.

    p: number of knots n, then n grid values, n positive levels, n negative levels,
    and stiffness, static_ratio, stribeck_velocity.
    """
    n = int(p[0])
    if x <= p[1]:
        return p[1 + n], p[1 + 2 * n]
    if x >= p[n]:
        return p[2 * n], p[3 * n]
    low, high = 1, n
    while high - low > 1:
        half = (low + high) // 2
        if p[half] <= x:
            low = half
        else:
            high = half
    share = (x - p[low]) / (p[low + 1] - p[low])
    plus = p[low + n] + share * (p[low + 1 + n] - p[low + n])
    minus = p[low + 2 * n] + share * (p[low + 1 + 2 * n] - p[low + 2 * n])
    return plus, minus


@njit(error_model="numpy")
def _share(ratio, velocity, speed):  # type: ignore[no-untyped-def]
    """Of the table's level, at a speed: `ratio` at standstill, 1 well above `velocity`."""
    x = speed / velocity if velocity > 0.0 else 7.0
    return 1.0 + (ratio - 1.0) * np.exp(-x * x) if x < 7.0 else 1.0


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """s: rigid, at rest at the start and at the end of the step being solved; elastic, `set_bristle`'s
    three and the share of the level at the speed of this step."""
    last = 3 * int(p[0])
    stiffness = p[last + 1]
    if stiffness > 0.0:
        if io[FIRST] != 0.0:
            end = io[V1] - io[GV] * stiffness * s[0]
            s[3] = _share(p[last + 2], p[last + 3], 0.5 * abs(io[V0] + end))
        plus, minus = _levels(p, io[X0])
        least = LEAST * stiffness
        set_bristle(io, s, max(s[3] * plus, least), max(s[3] * minus, least), stiffness, 0.0)
        return
    if io[COMMIT] != 0.0:
        s[0] = s[1]
        return
    plus, minus = _levels(p, io[X0])
    plus_end, minus_end = _levels(p, io[X1])
    x, _ = middle_motion(io, io[X1], io[V1])
    plus_half, minus_half = _levels(p, x)
    up, down = (plus, plus_half, plus_end), (minus, minus_half, minus_end)
    rests = set_friction(io, s[0] != 0.0, up, down, plus, minus)
    s[1] = 1.0 if rests else 0.0


class PositionDependentFriction(Effect):
    """F = -level(x, direction) sign(v), from a table over position, sticking at v = 0.

    `table` = {grid, positive, negative}: rising positions and the levels there while moving in
    positive and negative direction. `level` is the mean of the table (computed where absent).
    With a `stiffness` the contact gives way before it slides (LuGre): F = -stiffness z,
    dz/dt = v - |v| z stiffness/(level share(v)), share(v) = 1 + (static_ratio - 1)
    exp(-(v/stribeck_velocity)^2); `static_ratio` below 1 is friction that eases near standstill.
    Between knots the level goes straight, or (`interpolation` = "cubic") on the cubic spline through
    them, in `FINE` straight pieces, never below 0; beyond the ends it is constant.
    """

    name = "position_dependent_friction"
    parameters = (
        Parameter("table", "F"),
        Parameter("level", "F", default=-1.0),
        Parameter("stiffness", "F/x", linear=False, default=0.0),
        Parameter("static_ratio", "", linear=False, default=1.0),
        Parameter("stribeck_velocity", "x/s", linear=False, default=0.0),
    )
    depends_on = ("position", "direction")
    siblings = ("coulomb_friction", "asymmetric_friction", "cogging")
    options = {"interpolation": ("linear", "cubic")}  # noqa: RUF012
    law = staticmethod(_law)
    remembers = True
    switches = True

    def check(self, spec):  # type: ignore[no-untyped-def]
        values = super().check(spec)
        table = values["table"]
        mean = float(np.mean([table["positive"], table["negative"]]))
        if values["level"] < 0:
            values["level"] = mean
        self.require(
            abs(values["level"] - mean) <= 1e-3 * max(mean, 1e-12),
            f"level = {values['level']:g} is not the mean of the table, {mean:g}; leave it out",
        )
        return values

    def check_value(self, parameter: Parameter, value: Any) -> Any:
        if parameter.name != "table":
            return super().check_value(parameter, value)
        wanted = ("grid", "positive", "negative")
        self.require(
            isinstance(value, dict) and set(value) == set(wanted),
            "table must hold grid, positive and negative, three lists of numbers",
        )
        table = {key: [super(type(self), self).check_value(_NUMBER, v) for v in value[key]]
                 for key in wanted}  # fmt: skip
        grid = np.array(table["grid"])
        self.require(
            len(grid) >= 2 and len({len(v) for v in table.values()}) == 1,
            "table needs grid, positive and negative of one length, at least 2",
        )
        self.require(bool(np.all(np.diff(grid) > 0)), "table.grid must rise strictly")
        levels = np.array([table["positive"], table["negative"]])
        self.require(bool(np.all(levels >= 0)), "table levels are magnitudes; give values >= 0")
        return table

    def pack(self, values: Parameters, setting: Setting) -> list[float]:
        table = drawn_out(values["table"]) if is_cubic(setting.options) else values["table"]
        scale = 1.0 / setting.force_per_input
        levels = [scale * v for key in ("positive", "negative") for v in table[key]]
        return [float(len(table["grid"])), *table["grid"], *levels, *self._contact(values, scale)]

    @staticmethod
    def _contact(values: Parameters, scale: float) -> list[float]:
        return [scale * values["stiffness"], values["static_ratio"], values["stribeck_velocity"]]

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0, 0.0, 0.0, 1.0]

    def after_travel(self, state, packed, travel):  # type: ignore[no-untyped-def]
        if not packed[-3] > 0:
            return state
        levels = packed[1 + int(packed[0]) : -3]
        displacement = max(float(np.mean(levels)) / packed[-3], LEAST)
        return [carried(travel, displacement), *state[1:]]

    def stiffness(self, packed):  # type: ignore[no-untyped-def]
        return packed[-3]

    def weakening(self, packed):  # type: ignore[no-untyped-def]
        stiffness, ratio, velocity = packed[-3:]
        if not (stiffness > 0 and velocity > 0 and ratio > 1):
            return 0.0
        knots = int(packed[0])
        return np.sqrt(2.0 / np.e) * (ratio - 1.0) * max(packed[1 + knots : -3]) / velocity

    def reach(self, values: Parameters) -> float:
        return float(values["level"] / values["stiffness"]) if values.get("stiffness") else 0.0

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        low, high = float(motion.x.min()), float(motion.x.max())
        return [{"knots": float(n), "low": low, "high": high} for n in (5, 9)]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        """One function of position per knot for either direction, 1 there and 0 at all others: a hat, or
        a spline; `knots` spread from `low` to `high`."""
        knots = _grid(nonlinear)
        grid, rows = knots, np.eye(len(knots))
        if is_cubic(nonlinear):
            grid = _finer(knots)
            rows = _spline(knots, rows, grid)
        hats = np.array([np.interp(motion.x, grid, row) for row in rows]).T
        direction = motion.direction[:, None]
        return np.hstack([-hats * np.maximum(direction, 0), hats * np.maximum(-direction, 0)])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        grid = _grid(nonlinear)
        levels = np.maximum(np.asarray(coefficients, float), 0.0)
        plus, minus = levels[: len(grid)].tolist(), levels[len(grid) :].tolist()
        table = {"grid": grid.tolist(), "positive": plus, "negative": minus}
        return {"table": table, "level": float(levels.mean())}

    def nonlinear_of(self, values: Parameters) -> dict[str, float]:
        """Knots as close as the closest of the table, which diagnosis spreads evenly."""
        grid = np.asarray(values["table"]["grid"], float)
        knots = 1 + np.ceil((grid[-1] - grid[0]) / np.diff(grid).min() - 1e-6)
        return {"knots": float(knots), "low": float(grid[0]), "high": float(grid[-1])}

    def coefficients_of(self, values: Parameters) -> Array:
        table, knots = values["table"], _grid(self.nonlinear_of(values))
        sides = ("positive", "negative")
        return np.concatenate([np.interp(knots, table["grid"], table[key]) for key in sides])

    def says(self, values: Parameters, plant: Plant) -> str:
        table = values["table"]
        levels = np.array([table["positive"], table["negative"]])
        unit = self.parameter("level").unit_in(plant)
        up, down = levels.mean(axis=1)
        told = (
            f"Dry friction varies with position between {levels.min():.4g} and {levels.max():.4g} "
            f"{unit} (mean {values['level']:.4g} {unit}: {up:.4g} moving up, {down:.4g} down)"
        )
        if (stiffness := values.get("stiffness", 0.0)) > 0:
            told += f", gives way over about {values['level'] / stiffness:.3g} {plant.output_unit}"
        if values.get("stribeck_velocity", 0.0) > 0:
            told += (
                f", and is {values['static_ratio']:.3g} of that near standstill, below about "
                f"{self.quantity(values, 'stribeck_velocity', plant)}"
            )
        return told + "." + self._spring_in(table, plant)

    def _spring_in(self, table: Parameters, plant: Plant) -> str:
        """What a spring makes of a table: it adds k (x - c) to levels up and takes it off those down."""
        grid, up, down = (np.array(table[key]) for key in ("grid", "positive", "negative"))
        odd = 0.5 * (up - down)
        slope, offset = np.polyfit(grid, odd, 1)
        left = odd - (slope * grid + offset)
        at_ends = 0.5 * slope * (grid[-1] - grid[0])
        if at_ends <= MUCH * float(np.mean([up, down])) or np.var(left) > LITTLE * np.var(odd):
            return ""
        spring = f"{slope:.4g} {self.parameter('stiffness').unit_in(plant)}"
        return (
            f" The directions differ as by a spring of {spring} about {-offset / slope:.4g}"
            f" {plant.output_unit}, which no recording of such a table tells from it."
        )


def is_cubic(options: Mapping[str, Any]) -> bool:
    """Whether levels go on a spline between knots."""
    return options.get("interpolation") == CUBIC["interpolation"]


def drawn_out(table: Mapping[str, Sequence[float]]) -> dict[str, list[float]]:
    """The cubic spline through the knots of `table` as one with `FINE` times as many."""
    knots = np.asarray(table["grid"], float)
    grid, sides = _finer(knots), ("positive", "negative")
    curves = _spline(knots, np.array([table[key] for key in sides]), grid)
    levels = {key: np.maximum(c, 0.0).tolist() for key, c in zip(sides, curves, strict=True)}
    return {"grid": grid.tolist(), **levels}


def _finer(knots: Array) -> Array:
    """`FINE` steps for every one of `knots`."""
    at = np.linspace(0.0, len(knots) - 1.0, FINE * (len(knots) - 1) + 1)
    return np.interp(at, np.arange(len(knots)), knots)


def _spline(knots: Array, rows: Array, grid: Array) -> Array:
    """Every one of `rows` at `grid`; its third derivative is continuous at the second knot from an end."""
    ends = "not-a-knot" if len(knots) > 3 else "natural"
    return np.asarray(CubicSpline(knots, rows, axis=1, bc_type=ends)(grid))


_NUMBER = Parameter("table", "F", lower=-np.inf)


def _grid(nonlinear):  # type: ignore[no-untyped-def]
    return np.linspace(nonlinear["low"], nonlinear["high"], int(nonlinear["knots"]))

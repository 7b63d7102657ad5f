"""Smooth maps without a name: a driver times a free function of one variable, entering at a port.

    signal(t) = driver(t) * g(variable(t)),   g = sum_j c_j hat_j,  c ~ N(0, size^2 K(length))

with hats on a grid of the variable and K a Gaussian kernel over it: a Gaussian process in the space
of its weights. Drivers are what physics multiplies with: nothing, the direction, the velocity, the
acceleration, the command, its square (as iron is pulled).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ffl.diagnose.maps.grids import (
    accelerations,
    even,
    hats,
    interpolated,
    moments,
    speeds,
    top_speed,
    velocities,
    warped,
)
from ffl.diagnose.maps.histories import Ranges, faded, heat, hot_gain, memories
from ffl.diagnose.maps.mapped import (
    BY_COMMAND,
    BY_POSITION,
    BY_VELOCITY,
    DAMPING,
    DAMPING_DOWN,
    DAMPING_UP,
    DRY,
    DRY_BY_ACCELERATION,
    DRY_BY_COMMAND,
    GAIN,
    GAIN_BY_SPEED,
    INERTIA,
    INERTIA_BY_SPEED,
    PULL,
    SHOWN_COMMAND,
    SHOWN_POSITION,
    SHOWN_VELOCITY,
    smoothed,
)
from ffl.effects import Motion
from ffl.systems.state_space import Array

LENGTHS = (0.03, 0.08, 0.2, 0.6)  # of the grid: how fast a map may vary
JITTER = 1e-6
FALLS = (0.25, 0.5, 1.0)  # of the largest command, that a limit loses at the largest speed
LEVELS = 14


@dataclass(frozen=True)
class Term:
    """A family of maps: `columns(motion, ranges)` (N, k); `grid(ranges)` (k,) where the map lives, None
    where the columns have no order. `driver` and `along` say it: driver * g(along). `bank(motion,
    ranges, time constants)`: the columns of a history; `along_grid(motion, grid, values)`: the
    map itself. `side` "sent": of the command as it was recorded, not simulated. `kind`: what it is to
    the kernel (`mapped`), None where it is run by repetition; `levels`: its knots there, if not
    those of `grid`; `column`: what else was recorded that it reads."""

    name: str
    port: str
    variables: tuple[str, ...]
    driver: str
    along: str
    columns: Callable[[Motion, Ranges], Array]
    grid: Callable[[Ranges], Array] | None
    bank: Callable[[Motion, Ranges, Array], Array] | None = None
    along_grid: Callable[[Motion, Array, Array], Array] | None = None
    side: str = "sensor"
    kind: int | None = None
    levels: Callable[[Ranges], Array] | None = None
    column: str = ""

    def knots(self, ranges: Ranges) -> Array:
        """Where the map's values stand that the kernel runs it by."""
        found = self.grid or self.levels
        assert found is not None
        return found(ranges)

    def signal(self, motion: Motion, ranges: Ranges, coefficients: Array) -> Array:
        """columns @ coefficients, (N,), without the table where there is a grid."""
        if self.grid is None or self.along_grid is None:
            return self.columns(motion, ranges) @ coefficients
        return self.along_grid(motion, self.grid(ranges), coefficients)

    def kernel(self, ranges: Ranges, length: float) -> Array:
        """Prior covariance of the coefficients, unit size; `length` relative to the grid's extent."""
        if self.grid is None:
            k = self.columns(_point(ranges), ranges).shape[1]
            return np.eye(k)
        at = self.coordinate(ranges)
        at = (at - at[0]) / max(at[-1] - at[0], 1e-300)
        k = np.exp(-0.5 * ((at[:, None] - at[None]) / length) ** 2)
        z = self.grid(ranges)
        for trend in (
            z,
            np.abs(z),
        ):  # straight parts cost no more than any other: maps go on straight
            trend = trend / max(float(np.abs(z).max()), 1e-300)
            k += np.outer(trend, trend)
        return k + JITTER * np.eye(len(at))

    def coordinate(self, ranges: Ranges) -> Array:
        """The grid in the coordinate in which the map varies evenly."""
        assert self.grid is not None
        at = self.grid(ranges)
        return warped(at, ranges) if self.along in ("velocity", "speed") else at

    @property
    def lengths(self) -> tuple[float, ...]:
        return LENGTHS if self.grid is not None else (1.0,)


def _point(ranges: Ranges) -> Motion:
    zero = np.zeros(2)
    return Motion(zero, zero, zero, zero, zero, zero, ranges["step"][0])


# --- columns -------------------------------------------------------------------------------------


def variable(m: Motion, signal: str) -> Array:
    """The variable of a map; time is that since the recording began."""
    if signal in m.others:
        return m.others[signal]
    return m.t - m.t.min() if signal == "t" else getattr(m, signal)  # type: ignore[no-any-return]


def _over(m: Motion, signal: str, grid: Array) -> Array:
    """`variable`; a column in an experiment that nobody has run yet is in the middle of what it was."""
    if signal in m.others or hasattr(m, signal):
        return variable(m, signal)
    return np.full(len(m.t), 0.5 * (grid[0] + grid[-1]))


def _map(driver: Callable[[Motion], Array | float], signal: str, grid: Callable[[Ranges], Array]):  # type: ignore[no-untyped-def]
    def columns(m: Motion, ranges: Ranges) -> Array:
        at = grid(ranges)
        value = _over(m, signal, at)
        weight = np.broadcast_to(np.asarray(driver(m), float), value.shape)
        return hats(value, at) * weight[:, None]

    return columns


def _driven(driver: Callable[[Motion], Array | float], signal: str):  # type: ignore[no-untyped-def]
    def along(m: Motion, grid: Array, values: Array) -> Array:
        return driver(m) * interpolated(_over(m, signal, grid), grid, values)

    return along


def _inertia_along(m: Motion, grid: Array, values: Array) -> Array:
    slope = interpolated(m.x, grid, np.gradient(values, grid))
    return interpolated(m.x, grid, values) * m.a + 0.5 * slope * m.v**2


def _inertia(m: Motion, ranges: Ranges) -> Array:
    """M(x) a + M'(x) v^2/2: what Lagrange gives for a mass that depends on position."""
    grid = _positions(ranges)
    table = hats(m.x, grid)
    slope = table @ np.gradient(np.eye(len(grid)), grid, axis=0)
    return table * m.a[:, None] + 0.5 * slope * m.v[:, None] ** 2


def _scale_along(m: Motion, grid: Array, values: Array) -> Array:
    return smoothed(grid, values[:, None], m.x)[:, 0]


def _scale(m: Motion, ranges: Ranges) -> Array:
    """What a sensor's scale adds by position."""
    grid = _positions(ranges)
    return smoothed(grid, np.eye(len(grid)), m.x)


def _largest(ranges: Ranges) -> Array:
    return np.array([max(abs(at) for at in ranges["u"])])


_positions, _few, _commands = even("x", 49), even("x", 17), even("u", 33)


def _load(m: Motion, ranges: Ranges) -> Array:
    return np.column_stack([np.abs(m.u) * m.direction])


def _pushed(m: Motion, ranges: Ranges) -> Array:
    """The command by speed, pushing and pulling apart."""
    table = hats(np.abs(m.v), speeds(ranges))
    u = m.u[:, None]
    return np.hstack([table * np.maximum(u, 0.0), table * np.minimum(u, 0.0)])


def _limited(m: Motion, ranges: Ranges) -> Array:
    """What is cut off a command, by its size and the speed together: sign(u) max(0, |u| + k |v| - c), for
    several k and c. A limit that falls with the speed, as a supply's voltage makes it, is one of them."""
    size = max(abs(at) for at in ranges["u"]) or 1e-300
    sign, out = np.sign(m.u)[:, None], []
    for share in FALLS:
        both = np.abs(m.u) / size + share * np.abs(m.v) / top_speed(ranges)
        beyond = both[:, None] - np.linspace(0.0, 1.0 + share, LEVELS, endpoint=False)
        out.append(np.maximum(beyond, 0.0) * sign)
    return np.hstack(out)


def _heard(m: Motion) -> Array:
    """The command that acts when a sample is taken: the one before."""
    return np.append(m.u[:1], m.u[:-1])


def one(m: Motion) -> float:
    return 1.0


def direction(m: Motion) -> Array:
    return m.direction


def gridded(
    name: str,
    port: str,
    variables: tuple[str, ...],
    said: str,
    driver: Callable[[Motion], Array | float],
    along: str,
    grid: Callable[[Ranges], Array],
    kind: int | None = None,
    column: str = "",
) -> Term:
    signal = SIGNALS.get(along, along)
    return Term(
        name,
        port,
        variables,
        said,
        along,
        _map(driver, signal, grid),
        grid,
        along_grid=_driven(driver, signal),
        kind=kind,
        column=column,
    )


def _of_history(
    name: str,
    port: str,
    variables: tuple[str, ...],
    said: str,
    along: str,
    columns: Callable[[Motion, Ranges, Array], Array],
) -> Term:
    return Term(
        name,
        port,
        variables,
        said,
        along,
        lambda m, ranges: columns(m, ranges, memories(ranges)),
        None,
        columns,
    )


def command(m: Motion) -> Array:
    return m.u


SIGNALS = {
    "position": "x",
    "velocity": "v",
    "acceleration": "a",
    "command": "u",
    "time": "t",
}  # of a `Motion`
POSITION, VELOCITY, COMMAND = ("position",), ("velocity",), ("command",)
HEAT = ("command", "history", "time")
TERMS: tuple[Term, ...] = (
    gridded("position", "force", POSITION, "", one, "position", _positions, BY_POSITION),
    gridded("velocity", "force", VELOCITY, "", one, "velocity", velocities, BY_VELOCITY),
    gridded(
        "direction by position", "force", ("position", "direction"), "sign(velocity)", direction,
        "position", _positions, DRY,
    ),
    gridded(
        "velocity by position", "force", ("position", "velocity"), "velocity", lambda m: m.v,
        "position", _few, DAMPING,
    ),
    gridded(
        "upward velocity by position", "force", ("position", "velocity", "direction"),
        "max(0, velocity)", lambda m: np.maximum(m.v, 0.0), "position", _few, DAMPING_UP,
    ),
    gridded(
        "downward velocity by position", "force", ("position", "velocity", "direction"),
        "min(0, velocity)", lambda m: np.minimum(m.v, 0.0), "position", _few, DAMPING_DOWN,
    ),
    Term(
        "inertia by position", "force", ("position", "acceleration"), "acceleration", "position",
        _inertia, _positions, along_grid=_inertia_along, kind=INERTIA,
    ),
    Term(
        "direction by size of command", "force", ("command", "direction"),
        "sign(velocity)", "|command|", _load, None,
        kind=DRY_BY_COMMAND, levels=_largest,
    ),
    gridded(
        "direction by acceleration", "force", ("acceleration", "direction"), "sign(velocity)",
        direction, "acceleration", accelerations, DRY_BY_ACCELERATION,
    ),
    gridded(
        "inertia by speed", "force", ("velocity", "acceleration"), "acceleration",
        lambda m: m.a, "velocity", velocities, INERTIA_BY_SPEED,
    ),
    gridded(
        "pull by position", "force", ("command", "position"), "command^2",
        lambda m: m.u**2, "position", _positions, PULL,
    ),
    gridded(
        "direction by time", "force", ("time", "direction"), "sign(velocity)", direction,
        "time", moments,
    ),
    gridded(
        "inertia by time", "force", ("time", "acceleration"), "acceleration", lambda m: m.a,
        "time", moments,
    ),
    _of_history("history of position", "force", ("history", "position"), "", "faded position", faded),
    _of_history("heat of the command", "force", HEAT, "", "heat", heat),
    gridded("command", "command", COMMAND, "", one, "command", _commands, BY_COMMAND),
    gridded(
        "command by position", "command", ("command", "position"), "command", command,
        "position", _positions, GAIN,
    ),
    Term(
        "command by velocity", "command", ("command", "velocity"), "command", "speed", _pushed, None,
        kind=GAIN_BY_SPEED, levels=speeds,
    ),
    Term(
        "limit by speed", "command", ("command", "velocity"), "sign(command)",
        "|command| and speed", _limited, None, side="sent",
    ),
    gridded(
        "command by time", "command", ("time", "command"), "command", command, "time", moments,
    ),
    _of_history("command by its heat", "command", HEAT, "command", "heat", hot_gain),
    Term(
        "position at the sensor", "output", POSITION, "", "position",
        _scale, _positions, along_grid=_scale_along, kind=SHOWN_POSITION,
    ),
    gridded(
        "velocity at the sensor", "output", VELOCITY, "", one,
        "velocity", velocities, SHOWN_VELOCITY,
    ),
    Term(
        "command at the sensor", "output", COMMAND, "", "command",
        lambda m, ranges: hats(_heard(m), _commands(ranges)), _commands, kind=SHOWN_COMMAND,
        along_grid=lambda m, grid, values: interpolated(_heard(m), grid, values),
    ),
)  # fmt: skip

"""Smooth maps without a name: a driver times a free function of one variable, entering at a port.

    signal(t) = driver(t) * g(variable(t)),   g = sum_j c_j hat_j,  c ~ N(0, size^2 K(length))

with hats on a grid of the variable and K a Gaussian kernel over it: a Gaussian process in the space
of its weights. Drivers are what physics multiplies with: nothing, the direction, the velocity, the
acceleration, the command, its square (as iron is pulled).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ffl.diagnose.maps.histories import Ranges, faded, heat, hot_gain, memories
from ffl.diagnose.maps.mapped import (
    BY_COMMAND,
    BY_POSITION,
    BY_VELOCITY,
    DAMPING,
    DAMPING_DOWN,
    DAMPING_UP,
    DRY,
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
MOMENTS = 9  # knots of a map of the time: slower than what moves


@dataclass(frozen=True)
class Term:
    """A family of maps: `columns(motion, ranges)` (N, k); `grid(ranges)` (k,) where the map lives, None
    where the columns have no order. `driver` and `along` say it: driver * g(along). `bank(motion,
    ranges, time constants)`: the columns of a history; `along_grid(motion, grid, values)`: the
    map itself. `side` "sent": of the command as it was recorded, not simulated. `kind`: what it is to
    the kernel (`mapped`), None where it is run by repetition; `levels`: its knots there, if not
    those of `grid`."""

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
        return _warp(at, ranges) if self.along in ("velocity", "speed") else at

    @property
    def lengths(self) -> tuple[float, ...]:
        return LENGTHS if self.grid is not None else (1.0,)


def _point(ranges: Ranges) -> Motion:
    zero = np.zeros(2)
    return Motion(zero, zero, zero, zero, zero, zero, ranges["step"][0])


def ranges_of(motions: Sequence[Motion]) -> dict[str, tuple[float, float]]:
    """Least and greatest of each signal over the recordings; 'step' and 'time' for histories."""
    out = {}
    for name in ("x", "v", "u"):
        joined = np.concatenate([getattr(m, name) for m in motions])
        out[name] = (float(joined.min()), float(joined.max()))
    step = motions[0].sample_time
    out["step"] = (step, max(len(m.t) for m in motions) * step)
    return out


# --- grids ---------------------------------------------------------------------------------------


def _even(name: str, k: int) -> Callable[[Ranges], Array]:
    return lambda ranges: np.linspace(*ranges[name], k)


def _top(ranges: Ranges) -> float:
    return max(abs(v) for v in ranges["v"]) or 1e-300


def _warp(v: Array, ranges: Ranges) -> Array:
    return np.arcsinh(v / (0.02 * _top(ranges)))


def _velocities(ranges: Ranges) -> Array:
    edge = np.arcsinh(50.0)
    return 0.02 * _top(ranges) * np.sinh(np.linspace(-edge, edge, 41))


def _speeds(ranges: Ranges) -> Array:
    return np.linspace(0.0, _top(ranges), 15)


def _moments(ranges: Ranges) -> Array:
    return np.linspace(0.0, ranges["step"][1], MOMENTS)


def _hats(x: Array, grid: Array) -> Array:
    """(N, k): linear interpolation weights of x on the grid, going on straight beyond its ends by a
    quarter of its extent at most."""
    k = len(grid)
    at = np.clip(np.searchsorted(grid, x, side="right") - 1, 0, k - 2)
    reach = 0.25 * (grid[-1] - grid[0])
    inside = np.clip(x, grid[0] - reach, grid[-1] + reach)
    share = (inside - grid[at]) / np.maximum(grid[at + 1] - grid[at], 1e-300)
    out = np.zeros((len(x), k))
    rows = np.arange(len(x))
    out[rows, at] = 1.0 - share
    out[rows, at + 1] += share
    return out


def _interpolated(x: Array, grid: Array, values: Array) -> Array:
    """_hats(x, grid) @ values."""
    reach = 0.25 * (grid[-1] - grid[0])
    x = np.clip(x, grid[0] - reach, grid[-1] + reach)
    first, last = (
        np.diff(values[part]) / np.diff(grid[part]) for part in (slice(2), slice(-2, None))
    )
    beyond = np.minimum(x - grid[0], 0.0) * first[0] + np.maximum(x - grid[-1], 0.0) * last[0]
    return np.interp(x, grid, values) + beyond


# --- columns -------------------------------------------------------------------------------------


def variable(m: Motion, signal: str) -> Array:
    """The variable of a map; time is that since the recording began."""
    return m.t - m.t.min() if signal == "t" else getattr(m, signal)  # type: ignore[no-any-return]


def _map(driver: Callable[[Motion], Array | float], signal: str, grid: Callable[[Ranges], Array]):  # type: ignore[no-untyped-def]
    def columns(m: Motion, ranges: Ranges) -> Array:
        value = variable(m, signal)
        weight = np.broadcast_to(np.asarray(driver(m), float), value.shape)
        return _hats(value, grid(ranges)) * weight[:, None]

    return columns


def _driven(driver: Callable[[Motion], Array | float], signal: str):  # type: ignore[no-untyped-def]
    def along(m: Motion, grid: Array, values: Array) -> Array:
        return driver(m) * _interpolated(variable(m, signal), grid, values)

    return along


def _inertia_along(m: Motion, grid: Array, values: Array) -> Array:
    slope = _interpolated(m.x, grid, np.gradient(values, grid))
    return _interpolated(m.x, grid, values) * m.a + 0.5 * slope * m.v**2


def _inertia(m: Motion, ranges: Ranges) -> Array:
    """M(x) a + M'(x) v^2/2: what Lagrange gives for a mass that depends on position."""
    grid = _positions(ranges)
    hats = _hats(m.x, grid)
    slope = hats @ np.gradient(np.eye(len(grid)), grid, axis=0)
    return hats * m.a[:, None] + 0.5 * slope * m.v[:, None] ** 2


def _scale_along(m: Motion, grid: Array, values: Array) -> Array:
    return smoothed(grid, values[:, None], m.x)[:, 0]


def _scale(m: Motion, ranges: Ranges) -> Array:
    """What a sensor's scale adds by position."""
    grid = _positions(ranges)
    return smoothed(grid, np.eye(len(grid)), m.x)


def _largest(ranges: Ranges) -> Array:
    return np.array([max(abs(at) for at in ranges["u"])])


_positions, _few, _commands = _even("x", 49), _even("x", 17), _even("u", 33)


def _load(m: Motion, ranges: Ranges) -> Array:
    return np.column_stack([np.abs(m.u) * m.direction])


def _inertial_load(m: Motion, ranges: Ranges) -> Array:
    return np.column_stack([np.abs(m.a) * m.direction])


def _pushed(m: Motion, ranges: Ranges) -> Array:
    """The command by speed, pushing and pulling apart."""
    hats = _hats(np.abs(m.v), _speeds(ranges))
    u = m.u[:, None]
    return np.hstack([hats * np.maximum(u, 0.0), hats * np.minimum(u, 0.0)])


def _limited(m: Motion, ranges: Ranges) -> Array:
    """What is cut off a command, by its size and the speed together: sign(u) max(0, |u| + k |v| - c), for
    several k and c. A limit that falls with the speed, as a supply's voltage makes it, is one of them."""
    size = max(abs(at) for at in ranges["u"]) or 1e-300
    sign, out = np.sign(m.u)[:, None], []
    for share in FALLS:
        both = np.abs(m.u) / size + share * np.abs(m.v) / _top(ranges)
        beyond = both[:, None] - np.linspace(0.0, 1.0 + share, LEVELS, endpoint=False)
        out.append(np.maximum(beyond, 0.0) * sign)
    return np.hstack(out)


def _heard(m: Motion) -> Array:
    """The command that acts when a sample is taken: the one before."""
    return np.append(m.u[:1], m.u[:-1])


def _one(m: Motion) -> float:
    return 1.0


def _direction(m: Motion) -> Array:
    return m.direction


def _gridded(
    name: str,
    port: str,
    variables: tuple[str, ...],
    said: str,
    driver: Callable[[Motion], Array | float],
    along: str,
    grid: Callable[[Ranges], Array],
    kind: int | None = None,
) -> Term:
    signal = SIGNALS[along]
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


def _command(m: Motion) -> Array:
    return m.u


SIGNALS = {"position": "x", "velocity": "v", "command": "u", "time": "t"}  # of a `Motion`
POSITION, VELOCITY, COMMAND = ("position",), ("velocity",), ("command",)
HEAT = ("command", "history", "time")
TERMS: tuple[Term, ...] = (
    _gridded("position", "force", POSITION, "", _one, "position", _positions, BY_POSITION),
    _gridded("velocity", "force", VELOCITY, "", _one, "velocity", _velocities, BY_VELOCITY),
    _gridded(
        "direction by position", "force", ("position", "direction"), "sign(velocity)", _direction,
        "position", _positions, DRY,
    ),
    _gridded(
        "velocity by position", "force", ("position", "velocity"), "velocity", lambda m: m.v,
        "position", _few, DAMPING,
    ),
    _gridded(
        "upward velocity by position", "force", ("position", "velocity", "direction"),
        "max(0, velocity)", lambda m: np.maximum(m.v, 0.0), "position", _few, DAMPING_UP,
    ),
    _gridded(
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
    Term(
        "direction by size of acceleration", "force", ("acceleration", "direction"),
        "sign(velocity)", "|acceleration|", _inertial_load, None,
    ),
    _gridded(
        "inertia by speed", "force", ("velocity", "acceleration"), "acceleration",
        lambda m: m.a, "velocity", _velocities, INERTIA_BY_SPEED,
    ),
    _gridded(
        "pull by position", "force", ("command", "position"), "command^2",
        lambda m: m.u**2, "position", _positions, PULL,
    ),
    _gridded(
        "direction by time", "force", ("time", "direction"), "sign(velocity)", _direction,
        "time", _moments,
    ),
    _of_history("history of position", "force", ("history", "position"), "", "faded position", faded),
    _of_history("heat of the command", "force", HEAT, "", "heat", heat),
    _gridded("command", "command", COMMAND, "", _one, "command", _commands, BY_COMMAND),
    _gridded(
        "command by position", "command", ("command", "position"), "command", _command,
        "position", _positions, GAIN,
    ),
    Term(
        "command by velocity", "command", ("command", "velocity"), "command", "speed", _pushed, None,
        kind=GAIN_BY_SPEED, levels=_speeds,
    ),
    Term(
        "limit by speed", "command", ("command", "velocity"), "sign(command)",
        "|command| and speed", _limited, None, side="sent",
    ),
    _gridded(
        "command by time", "command", ("time", "command"), "command", _command, "time", _moments,
    ),
    _of_history("command by its heat", "command", HEAT, "command", "heat", hot_gain),
    Term(
        "position at the sensor", "output", POSITION, "", "position",
        _scale, _positions, along_grid=_scale_along, kind=SHOWN_POSITION,
    ),
    _gridded(
        "velocity at the sensor", "output", VELOCITY, "", _one,
        "velocity", _velocities, SHOWN_VELOCITY,
    ),
    Term(
        "command at the sensor", "output", COMMAND, "", "command",
        lambda m, ranges: _hats(_heard(m), _commands(ranges)), _commands, kind=SHOWN_COMMAND,
        along_grid=lambda m, grid, values: _interpolated(_heard(m), grid, values),
    ),
)  # fmt: skip

"""Maps of what else was recorded: another axis, a temperature, a gripper that is closed."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from ffl.diagnose.maps.grids import hats, interpolated
from ffl.diagnose.maps.histories import Ranges
from ffl.diagnose.maps.terms import Term
from ffl.diagnose.recorded.others import RATES
from ffl.effects import Motion
from ffl.systems.state_space import Array

LEVELS = 9
Driver = Callable[[Motion], Array]
DRIVERS: tuple[tuple[str, str, str, tuple[str, ...], Driver | None], ...] = (
    # port, driver in words, name before "by NAME", variables beside the column's, driver
    ("force", "", "force", (), None),
    ("force", "velocity", "velocity", ("velocity",), lambda m: m.v),
    ("force", "sign(velocity)", "direction", ("direction",), lambda m: m.direction),
    ("force", "acceleration", "acceleration", ("acceleration",), lambda m: m.a),
    ("command", "command", "command", ("command",), lambda m: m.u),
    ("output", "", "sensor", (), None),
)


def _read(m: Motion, name: str, grid: Array) -> Array:
    """The column along the motion; in an experiment that nobody has run yet, the middle of what it was."""
    known = m.others.get(name)
    return np.full(len(m.t), 0.5 * (grid[0] + grid[-1])) if known is None else known


@lru_cache
def terms_by(name: str) -> tuple[Term, ...]:
    """The maps over the column `name`: a force, what goes with the velocity, the direction, the
    acceleration or the command by it, and an error of the sensor. A rate of a column is a force in
    proportion to it."""
    rate = next((said for said in RATES if name.startswith(said)), "")
    column = f"column {name[len(rate) :]}"
    if rate:
        straight = Term(
            f"force by {name}", "force", (column,), "", name,
            lambda m, ranges: m.others.get(name, np.zeros(len(m.t)))[:, None], None, column=name,
        )  # fmt: skip
        return (straight,)

    def grid(ranges: Ranges) -> Array:
        return np.linspace(*ranges[name], LEVELS)

    def term(port: str, said: str, title: str, variables: tuple[str, ...], driver: Driver | None):  # type: ignore[no-untyped-def]
        def columns(m: Motion, ranges: Ranges) -> Array:
            at = grid(ranges)
            table = hats(_read(m, name, at), at)
            return table if driver is None else table * driver(m)[:, None]

        def along(m: Motion, at: Array, values: Array) -> Array:
            read = interpolated(_read(m, name, at), at, values)
            return read if driver is None else driver(m) * read

        return Term(
            f"{title} by {name}", port, (*variables, column), said, name, columns, grid,
            along_grid=along, column=name,
        )  # fmt: skip

    return tuple(term(*row) for row in DRIVERS)

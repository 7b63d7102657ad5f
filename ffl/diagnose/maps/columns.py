"""Maps of what else was recorded: another axis, a temperature, a gripper that is closed."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from ffl.diagnose.maps.grids import even
from ffl.diagnose.maps.terms import Term, command, direction, gridded, one
from ffl.diagnose.recorded.others import RATES
from ffl.effects import Motion
from ffl.systems.state_space import Array

LEVELS = 9
DRIVERS: tuple[tuple[str, str, str, tuple[str, ...], Callable[[Motion], Array | float]], ...] = (
    # name before "by NAME", port, driver in words, variables beside the column's, driver
    ("force", "force", "", (), one),
    ("velocity", "force", "velocity", ("velocity",), lambda m: m.v),
    ("direction", "force", "sign(velocity)", ("direction",), direction),
    ("acceleration", "force", "acceleration", ("acceleration",), lambda m: m.a),
    ("command", "command", "command", ("command",), command),
    ("sensor", "output", "", (), one),
)


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
    return tuple(
        gridded(
            f"{title} by {name}", port, (*variables, column), said, driver, name,
            even(name, LEVELS), column=name,
        )
        for title, port, said, variables, driver in DRIVERS
    )  # fmt: skip

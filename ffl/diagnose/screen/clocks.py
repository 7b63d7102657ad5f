"""Columns where recordings say nothing of when one began after another: each has a phase of its own, or
shows a later part of what settles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffl.systems.state_space import Array


def apart(columns: Array, lengths: Sequence[int]) -> Array:
    """Columns of their own for every recording."""
    out = np.zeros((len(columns), columns.shape[1] * len(lengths)))
    at, k = 0, columns.shape[1]
    for i, n in enumerate(lengths):
        out[at : at + n, i * k : (i + 1) * k] = columns[at : at + n]
        at += n
    return out


def begun_apart(settling: Sequence[Array], goes_on: Sequence[bool], one: float) -> list[Array]:
    """Columns of a force that settles, `one` (1 - exp(-t/T)) in the first recording, (N, 1), of which each
    other one may show any later part: one column for the force, one more for each of those. `goes_on`:
    whether it is a further piece of the recording before it."""
    which = np.cumsum([k == 0 or not later for k, later in enumerate(goes_on)]) - 1
    tables = []
    for at, column in zip(which, settling, strict=True):
        table = np.zeros((len(column), which[-1] + 1))
        table[:, 0] = column[:, 0]
        if at:
            table[:, at] = one - column[:, 0]
        tables.append(table)
    return tables

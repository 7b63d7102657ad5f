"""One thing found in a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

Array = np.ndarray
Severity = Literal["fault", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """What (kind), in which column (where), said in a sentence, how grave, when [s], how much."""

    kind: str
    where: str
    text: str
    severity: Severity
    time_s: tuple[tuple[float, float], ...] = ()
    value: float | None = None


def equal_runs(x: Array, shortest: int) -> tuple[Array, Array]:
    """(first, stop) of every stretch of at least `shortest` exactly equal samples."""
    edges = np.flatnonzero(np.diff(x) != 0.0) + 1
    first = np.concatenate([[0], edges])
    stop = np.concatenate([edges, [len(x)]])
    long = stop - first >= shortest
    return first[long], stop[long]


def spans(t: Array, first: Array, stop: Array, most: int = 20) -> tuple[tuple[float, float], ...]:
    """Times of the stretches, the longest `most` of them, in order."""
    longest = np.sort(np.argsort(first - stop, kind="stable")[:most])
    return tuple((float(t[first[k]]), float(t[stop[k] - 1])) for k in longest)

"""A sensor that stands at its limit: the same last digit again and again while the drive goes on.

A likelihood gives no credit for that; a smooth curve that bends at the top fits the rest as well.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec, Plant

RUN = 8  # samples at the limit in a row
MOVES = 0.01  # of the drive's range: what it must move meanwhile


def clipping(plant: Plant, recordings: Sequence[Recording]) -> EffectSpec | None:
    """The clipping that an open-loop output shows by standing at one largest magnitude, the same in
    all recordings that reach it; None where none does."""
    if plant.controller is not None:
        return None
    level = max(float(np.abs(r.y).max()) for r in recordings)
    for r in recordings:
        at = np.abs(r.y) == level
        if not at.any() or not np.all(np.isfinite(r.u)):
            continue
        edges = np.flatnonzero(np.diff(np.concatenate([[0], at.astype(int), [0]])))
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            if b - a >= RUN and np.ptp(r.u[a:b]) > MOVES * np.ptp(r.u):
                values = {"kind": "clipping", "level": level}
                return EffectSpec("sensor_nonlinearity", values)
    return None

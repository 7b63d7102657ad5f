"""Numbers of what is foretold moved one by one: where moments of contact jump with every number,
derivatives say little."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.predict.foretold import Told
from ffl.diagnose.recorded.trials import Trial
from ffl.systems.state_space import Array

TRIES = 5  # steps of a move
MOVES = (0.2, 0.1, 0.05)  # of a number's unit, one after the other


def moved(
    point: Told, trials: Sequence[Trial], sizes: Sequence[float] = MOVES, *, mass: bool = False
) -> Told:
    """All numbers of the effects, and the mass, moved one by one as long as it helps."""
    worth = point.worth(trials)
    coordinates = point.model.coordinates
    own = [k for k, c in enumerate(coordinates) if c.kind != "correction"]
    for size in sizes:
        for k in [*(masses(point.model) if mass else ()), *own]:
            way = np.zeros(len(coordinates))
            way[k] = size * units(point)[k]
            point, worth = walked(point, worth, way, trials)
    return point


def walked(point: Told, worth: float, way: Array, trials: Sequence[Trial]) -> tuple[Told, float]:
    """(the point, its worth) after steps of `way`, forth or back, as many as help."""
    for sign in (1.0, -1.0):
        for _ in range(TRIES):
            tried = point.at(point.theta + sign * way)
            value = tried.worth(trials)
            if not value > worth:
                break
            point, worth = tried, value
    return point, worth


def units(point: Told) -> Array:
    """By what a move is measured: the gap itself, a unit of logarithms and of the mass, else a scale."""
    sizes = [1.0 if c.log else c.scale for c in point.model.coordinates]
    for k in masses(point.model):
        sizes[k] = 1.0
    at = gap_at(point.model)
    sizes[at] = point.theta[at]
    return np.array(sizes)


def gap_at(model: Model) -> int:
    """Which coordinate is the play's."""
    return [c.name for c in model.coordinates].index("gap")


def masses(model: Model) -> list[int]:
    """Which coordinates are the mass's."""
    return [k for k, c in enumerate(model.coordinates) if c.key[:2] == ("correction", "mass")]

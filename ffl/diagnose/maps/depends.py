"""What a map depends on: how much of its evidence is lost when one variable is shuffled in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.random import Generator

from ffl.diagnose.maps.freemodel import (
    FreeModel,
    FreeScreen,
    Part,
    evidence,
    held_motion,
    tables_of,
)
from ffl.diagnose.recorded.warmth import feels_heat
from ffl.effects import Motion
from ffl.systems.state_space import Array

SHUFFLES = 3
BLOCKS = 20  # pieces of a recording that a variable's shuffling moves about


def needed_variables(
    screen: FreeScreen, free: FreeModel, white: Array, part: Part, rng: Generator
) -> dict[str, float]:
    """Share of the map's evidence that is lost when one variable's blocks are moved about in time. Of heat
    nothing is said: wherever the command's blocks go, they warm nearly alike."""
    if feels_heat(part.term):
        return {}
    motions = [free.follow(trial, [part.place]) for trial in screen.scene.trials]
    if any(m is None for m in motions):
        return {}
    along = [m[1] for m in motions if m is not None]
    entry = [(part.term, part.place)]
    table = tables_of(screen, entry, [part.ranges], along)[0]
    own = screen.from_nominal(free.model)
    target = screen.beyond(white + own + table @ part.coefficients)
    whole = evidence(part.term, part.ranges, screen.beyond(table), target).gain
    if whole <= 0:
        return {}
    out = {}
    for name in part.term.variables:
        if name not in SHUFFLED:
            continue
        lost = []
        for _ in range(SHUFFLES):
            columns = [
                part.term.columns(
                    SHUFFLED[name](held_motion(m[part.place], part.place), rng), part.ranges
                )
                for m in along
            ]
            other = screen.beyond(screen.through(part.place, columns))
            lost.append(1.0 - evidence(part.term, part.ranges, other, target).gain / whole)
        out[name] = float(np.clip(np.min(lost), 0.0, 1.0))
    return out


def _blocks(x: Array, rng: Generator) -> Array:
    pieces = np.array_split(np.arange(len(x)), BLOCKS)
    return x[np.concatenate([pieces[k] for k in rng.permutation(len(pieces))])]


def _shuffled_direction(m: Motion, rng: Generator) -> Motion:
    return replace(m, v=np.abs(m.v) * np.sign(_blocks(m.v, rng)))


def _shuffled_velocity(m: Motion, rng: Generator) -> Motion:
    return replace(m, v=_blocks(m.v, rng))


SHUFFLED = {
    "position": lambda m, rng: replace(m, x=_blocks(m.x, rng)),
    "velocity": _shuffled_velocity,
    "direction": _shuffled_direction,
    "acceleration": lambda m, rng: replace(m, a=_blocks(m.a, rng)),
    "command": lambda m, rng: replace(m, u=_blocks(m.u, rng)),
    "time": lambda m, rng: replace(m, t=_blocks(m.t, rng)),
}

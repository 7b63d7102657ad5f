"""Noise slower than an observer's errors live: what it makes looks like loads, springs and drifts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.scene import Runs, Scene
from ffl.effects import EFFECTS

LASTING = frozenset({"position", "time", "temperature", "history", "acceleration"})
BENT = "hysteresis"  # turns round with the machine, but over its whole way


def slowly(names: Sequence[str], others: Sequence[str]) -> bool:
    """Whether nothing that `names` have beyond `others` goes by speed, its direction or the command. (No
    noise turns round where a robot's axis does.)"""
    more = list(names)
    for name in others:
        if name in more:
            more.remove(name)
    return bool(more) and all(
        name == BENT or set(EFFECTS[name].depends_on) <= LASTING for name in more
    )


def gained_in_own_noise(scene: Scene, model: Runs, base: Runs) -> float:
    """Log-likelihood that `model` gains over `base` in the recordings of `scene` where all that either
    leaves is noise of any colour: where an observer leads of noise as slow as there can be. (Force noise of
    4 % that lasts half a second was a spring of less than nothing, 100 nats, a hysteresis, 73, a wave of
    0.36 Hz, 61, and a drift, 93: under slow noise of its own -2, 0, -1 and 13. Loads, springs and friction
    that are there kept 80 to 3,200.)"""
    worth = [in_own_noise(scene, one) for one in (model, base)]
    return np.inf if worth[1] == -np.inf else worth[0] - worth[1]


def in_own_noise(scene: Scene, model: Runs) -> float:
    """Log-likelihood of what `model` leaves, were it all noise; -inf where it leaves all bounds."""
    own = replace(scene, slowest=0.0) if scene.observed else scene
    left = own.residuals(model)
    return -np.inf if left is None else own.in_own_noise(left)

"""Where maps can be judged: where the machine is, and has been a while, in the range that was fitted."""

from __future__ import annotations

import numpy as np

from ffl.diagnose.contest.judging import LOST
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.maps.freemodel import FreeModel
from ffl.systems.state_space import Array

# Log-likelihood that held-out recordings must bring (nulls reach 1), if so much is due.
HELD_WORTH = 10.0


def hardly_shown(promise: float, fitted: float) -> bool:
    """Held-out recordings that would bring next to nothing of maps in the mean (`promise`), or little of
    what the `fitted` ones do (a magnet that the judging move passes by: 79 of 19,415)."""
    return promise < max(HELD_WORTH, LOST * fitted)


def where_known(free: FreeModel, x: Array, scene: Scene) -> Array:
    """Where the position is, and has been for the loop's memory, within the fitted range."""
    spans = [p.ranges["x"] for p in free.parts if "position" in p.term.variables]
    if not spans:
        return np.ones(len(x), bool)
    low, high = max(s[0] for s in spans), min(s[1] for s in spans)
    slack = 0.01 * (high - low)
    outside = (x < low - slack) | (x > high + slack)
    since = np.arange(len(x)) - np.maximum.accumulate(
        np.where(outside, np.arange(len(x)), -(10**9))
    )
    return since > _memory(scene)


def _memory(scene: Scene) -> int:
    """Samples after which the loop has forgotten a force but for a hundredth."""
    n = min(4096, max(len(t) for t in scene.trials))
    unit = np.zeros(n)
    unit[0] = 1.0
    energy = np.cumsum(scene.loop.process_sensitivity.filter(unit) ** 2)
    return int(np.searchsorted(energy, 0.9999 * energy[-1]))

"""Where maps can be judged: where the machine is, and has been a while, in the range that was fitted."""

from __future__ import annotations

import numpy as np

from ffl.diagnose.contest.earning import LOST
from ffl.diagnose.contest.judging import noise_error
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.maps.freemodel import FreeModel
from ffl.systems.state_space import Array

# Log-likelihood that held-out recordings must bring (nulls reach 1), if so much is due.
HELD_WORTH = 10.0
FORGOTTEN = 1e-4  # of a force's energy in y, when the loop has forgotten it
UNSEEN = 0.1  # of the noise in y: what may be left of an error made outside


def hardly_shown(promise: float, fitted: float) -> bool:
    """Held-out recordings that would bring next to nothing of maps in the mean (`promise`), or little of
    what the `fitted` ones do (a magnet that the judging move passes by: 79 of 19,415)."""
    return promise < max(HELD_WORTH, LOST * fitted)


def where_known(free: FreeModel, x: Array, scene: Scene, missed: Array | None = None) -> Array:
    """Where the position `x` is, and has been for the loop's memory, within the fitted range: until of a
    force made outside a hundredth is left, and of what was `missed` there less than the noise. (A gain that
    ripples was learned over 48 mm and judged on 132: 0.8 mm missed outside were 11 times the noise when
    a hundredth was left of them.)"""
    spans = [p.ranges["x"] for p in free.parts if "position" in p.term.variables]
    if not spans:
        return np.ones(len(x), bool)
    low, high = max(s[0] for s in spans), min(s[1] for s in spans)
    slack = 0.01 * (high - low)
    outside = (x < low - slack) | (x > high + slack)
    since = np.arange(len(x)) - np.maximum.accumulate(
        np.where(outside, np.arange(len(x)), -(10**9))
    )
    left = FORGOTTEN
    if missed is not None and outside.any():
        error = float(np.mean(missed[outside] ** 2))
        calm = noise_error(scene, scene) / scene.samples
        left = min(left, UNSEEN * calm / max(error, 1e-300))
    return since > _memory(scene, left)


def _memory(scene: Scene, left: float) -> int:
    """Samples after which the loop has forgotten a force but for the share `left` of its energy in y."""
    n = min(4096, max(len(t) for t in scene.trials))
    unit = np.zeros(n)
    unit[0] = 1.0
    response = scene.loop.process_sensitivity.filter(unit) ** 2
    to_come = np.cumsum(response[::-1])[::-1]
    return int(np.count_nonzero(to_come > left * to_come[0]))

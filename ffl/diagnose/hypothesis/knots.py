"""Levels of a friction table where the recordings hardly show any: as those beside them are.

A machine stands at the ends of its stroke, or passes them in one direction; a level there is free to be
anything, and a held-out run that goes there is foretold by it (levels of 0 beside 2.1 N left 25 times what
the true model leaves). Levels of neighbouring knots t differ by as much as those do that are shown, in the
mean by d:

    min over step of |R step|^2/s^2 + |D (t + step)|^2/d^2,

R'R = J'J of the fit, s^2 its mean square, D the differences along either direction of motion.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import Fit
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.triangle import lengths, triangle
from ffl.systems.state_space import Array

SHOWN = 0.1  # of the mean level: a standard error below it shows a level
USUAL = 0.3  # of the mean level: by what neighbours differ where fewer than three are shown
LEAST = 0.05  # of the mean level: by what neighbours may differ at least
HARDLY = 0.5  # of that difference: a standard error above it leaves a level to its neighbours


def continued(found: Fit, scene: Scene) -> Fit:
    """`found`, of `scene`, with the levels of its friction table that hardly show brought to what their
    neighbours say, all other numbers with them, its Jacobian as it was; itself where every level shows."""
    sides = _sides(found.model)
    if not sides or found.status == "diverged":
        return found
    theta = found.model.theta
    level = float(np.mean(np.concatenate([theta[side] for side in sides])))
    error, knots = _error(found), np.concatenate(sides)
    usual = _difference(theta, error, sides, level)
    if not usual > 0.0 or not np.any(error[knots] > HARDLY * usual):
        return found
    pairs = _neighbours(sides)
    changes = np.zeros((len(pairs), len(theta)))
    for row, (low, high) in enumerate(pairs):
        changes[row, low], changes[row, high] = -1.0 / usual, 1.0 / usual
    noise = np.sqrt(max(1.0, found.cost / max(len(found.white) - len(theta), 1)))
    seen = triangle(np.where(np.isfinite(found.jacobian), found.jacobian, 0.0), found.white)[0]
    table = np.vstack([seen / noise, changes])
    scale = np.maximum(lengths(table), 1e-300)
    wanted = np.concatenate([np.zeros(len(seen)), -changes @ theta])
    step = np.linalg.lstsq(table / scale, wanted, rcond=1e-12)[0] / scale
    model = found.model.at(theta + step)
    residuals = scene.residuals(model)
    if residuals is None:
        return found
    white = scene.whiten(residuals)
    rough = [float(np.sum((changes @ m.theta) ** 2)) for m in (found.model, model)]
    better = white @ white / noise**2 + rough[1] < found.cost / noise**2 + rough[0]
    return replace(found, model=model, white=white) if better else found


def _sides(model: Model) -> list[list[int]]:
    """Where the levels of each direction stand in theta, from knot to knot."""
    out: dict[str, list[int]] = {}
    for k, c in enumerate(model.coordinates):
        if c.kind == "effect" and c.place is not None:
            out.setdefault(c.place[0], []).append(k)
    return list(out.values())


def _neighbours(sides: list[list[int]]) -> list[tuple[int, int]]:
    return [pair for side in sides for pair in pairwise(side)]


def _error(found: Fit) -> Array:
    """Standard errors, infinite where nothing is shown."""
    return np.where(lengths(found.jacobian) > 0.0, found.spread, np.inf)


def _difference(theta: Array, error: Array, sides: list[list[int]], level: float) -> float:
    """By how much neighbouring levels differ in the mean square, of those that are shown."""
    shown = error < SHOWN * level
    found = [theta[b] - theta[a] for a, b in _neighbours(sides) if shown[a] and shown[b]]
    if len(found) < 3:
        return USUAL * level
    return max(float(np.sqrt(np.mean(np.square(found)))), LEAST * level)

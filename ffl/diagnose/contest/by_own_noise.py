"""The numbers of what was named, fitted once more by the noise that is left.

Rivals are fitted under the least white noise that the recordings show: coloured noise in a contest would
let slow physics go as noise. Once the names stand there is none left to let go, and least squares weighed
by the noise as it is have the least errors of all that are linear in y (Aitken 1936). And a fit that
ended on a ledge goes on from below it: the sum of squares of a play, a stop or dry friction is no bowl, and
its bottom may lie a tenth of the number away from where all derivatives vanish.

(A play of 115.9 um: 88.7 +- 0.6 um before, 102.4 +- 3.7 after.)
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ffl.diagnose.contest.judging import Judged, by_its_noise, held_out, levelled, raw_error
from ffl.diagnose.contest.parallel import each
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import Fit, fit, surprise
from ffl.diagnose.hypothesis.model import TABLE, Model
from ffl.systems.state_space import Array

PASSES = 4  # noise and numbers in turns
ROUNDS = 20
NO_MORE = 1.1  # times the squares of what held-out runs are missed by
ENOUGH = 1.0  # log-likelihood that one more pass must have brought
WAYS = (0.02, 0.1, 0.3)  # of a number: how far to look
LOOKS = 6  # at most, one after the other
LOWER = 2.0  # in the sum of squares: a place to go on from


def by_own_noise(held: Scene | None, judged: Judged) -> Judged:
    """`judged` with its numbers fitted by the noise that they leave, in turns with that, as long as fitted
    and held-out recordings together are the likelier for it and the held-out ones are not missed by more.
    Led by an observer all that is slow would go as noise: not there. (A robot's axis, held-out error
    0.00069, was 0.00085.) Nor beside a friction table, whose levels trade against a damping without a
    trace. (EMPS: a mean of 22.1 N for 20.4.)"""
    names = judged.model.names
    if judged.scene.observed or not names or TABLE in names:
        return judged
    held = held if judged.held is None else judged.held  # whitened as `judged` was
    for _ in range(PASSES):
        found = fit(judged.scene, judged.model, rounds=ROUNDS)
        if found.status == "diverged":
            break
        found = looked_around(judged.scene, found)
        own, likelihood = by_its_noise(judged.scene, found.model)
        judging = own if held is None else held
        other = Judged(found, own, likelihood, *held_out(held, judging, found), held)
        before, after = levelled([judged, other])
        missed = raw_error(held, found.model) > NO_MORE * raw_error(held, judged.model)
        if missed or not after.score > before.score:
            break
        judged = other
        if after.score < before.score + ENOUGH:
            break
    return judged


def looked_around(scene: Scene, found: Fit) -> Fit:
    """`found`, or gone on from where a number of an effect lies farther off, by itself or the others moved
    with it, and the sum of squares is lower."""
    for _ in range(LOOKS):
        places = list(_around(found))
        sums = each(lambda model: _cost(scene, model), places)
        if min(sums, default=np.inf) > _cost_of(found) - LOWER:
            break
        lower = fit(scene, places[int(np.argmin(sums))], rounds=ROUNDS)
        if lower.status == "diverged" or _cost_of(lower) > _cost_of(found) - LOWER:
            break
        found = lower
    return found


def _around(found: Fit) -> Iterator[Model]:
    """Models with one number of an effect some `WAYS` off, the others as they are or as they go with it."""
    model, theta = found.model, found.model.theta
    for k, c in enumerate(model.coordinates):
        unit = 1.0 if c.log else abs(float(theta[k]))
        if c.kind != "effect" or c.place is not None or not unit:
            continue
        alone = np.zeros(len(theta))
        alone[k] = unit
        ways = [alone]
        if np.isfinite(along := _along(found, k)).all():
            ways.append(unit * along)
        for way in ways:
            yield from (model.at(theta + s * w * way) for w in WAYS for s in (1.0, -1.0))


def _along(found: Fit, k: int) -> Array:
    """How the others move with number `k`, (p,), where the sum of squares is least: a column of the
    covariance over its variance."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return found.covariance[:, k] / found.covariance[k, k]


def _cost(scene: Scene, model: Model) -> float:
    return scene.cost(model) + 2.0 * surprise(model)


def _cost_of(found: Fit) -> float:
    return found.cost + 2.0 * found.surprise

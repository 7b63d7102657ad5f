"""Who stays though held-out recordings are against it, where they show the model's own numbers as others.

A mode that the fitted recordings excite at reversals only is corrected by what the form of a friction
leaves there, several standard errors off. Held-out recordings that excite it then leave the most where all
else is right, for there nothing else blurs them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.earning import UNTOLD, stays
from ffl.diagnose.contest.judging import Judged, levelled
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import jacobian

ROUNDS = 5
ENOUGH = 0.98  # of the sum of squares: a round that leaves more is the last


def stays_in_a_believed_model(quiet: Scene, judged: Judged, without: Judged, keep: float) -> bool:
    """Whether the effect of `judged` that fitted recordings tell plainly is worth `keep` over `without` it
    once either has the linear model's own numbers where the held-out recordings have them, as far as these
    are believed of a careful engineer's model (`Coordinate.doubt`). (Drag beside friction and a ripple:
    2,014 fitted and -237 held out, where a mode lay 0.8 % off; 857 held out with the mode in its place.)
    """
    told = judged.fitted - without.fitted
    if told < UNTOLD or judged.held is None or judged.held_out >= without.held_out:
        return False
    ours, theirs = (_believed(quiet, one) for one in (judged, without))
    if ours is None or theirs is None:
        return False
    ours, theirs = levelled([ours, theirs])
    return stays(ours, theirs, keep)


def _believed(quiet: Scene, judged: Judged) -> Judged | None:
    """`judged` with what it leaves of its held-out recordings under numbers of the model's own that are
    fitted to these by Gauss and Newton, |white|^2 + |number/belief|^2."""
    assert judged.held is not None
    held, model = judged.held.like(quiet), judged.model
    own = [k for k, c in enumerate(model.coordinates) if c.kind == "correction"]
    left = held.residuals(model)
    if left is None or not own:
        return None
    belief = np.array([model.coordinates[k].doubt for k in own])
    white = held.whiten(left)
    for _ in range(ROUNDS):
        theta = model.theta.copy()
        columns = held.whiten_stacked(jacobian(held, model, left, chosen=own))
        if not np.all(np.isfinite(columns)):
            break
        table = np.vstack([columns * belief, np.eye(len(own))])
        wanted = np.concatenate([white, -theta[own] / belief])
        theta[own] += belief * np.linalg.lstsq(table, wanted, rcond=1e-12)[0]
        moved = model.at(theta)
        now = held.residuals(moved)
        there = white if now is None else held.whiten(now)
        if now is None or float(there @ there) > ENOUGH * float(white @ white):
            break
        model, left, white = moved, now, there
    return replace(judged, held_white=white)

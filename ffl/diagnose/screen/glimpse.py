"""Who of many rivals gets anywhere: a few steps of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial

import numpy as np

from ffl.diagnose.contest.judging import Judged, raw_residuals
from ffl.diagnose.contest.parallel import each
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import Fit, fit
from ffl.diagnose.hypothesis.ladders import with_best_start
from ffl.diagnose.recorded.starts import with_clocks
from ffl.diagnose.screen.candidate import Candidate
from ffl.systems.state_space import Array

GLIMPSE = 3  # steps by which it is seen whether a rival gets anywhere
PLACES = 2  # of one effect that are fitted on
SAME = 1e-3  # of what a rival takes off: nearer, one of the same place has only begun elsewhere
PROMISING = (
    0.3  # of what the best rival takes off the sum of squares, or gains in likelihood, by then
)
FAINT = 16.0  # log-likelihood


def promising(quiet: Scene, base: Judged, entrants: Sequence[Candidate]) -> list[Fit]:
    """A few steps of every entrant from its best start; those that take off a good part of what the
    best of them does, of one effect at many places the two that do most: it is moved to the others
    when it stands. An effect that none of these names has its say by likelihood, with the noise that
    each leaves itself: of two effects together the slow and large one makes the sum of squares alone.
    """
    before = quiet.residuals(base.model)
    cost = 0.0 if before is None else float(np.sum(quiet.whiten(before) ** 2))

    def begun(c: Candidate) -> Fit:
        start = with_best_start(quiet, c)
        known = c.like.shared(start)
        return fit(with_clocks(quiet, start, 1), start, rounds=GLIMPSE, known=known)

    fits = each(begun, entrants)
    most = max((cost - f.cost for f in fits), default=0.0)
    chosen: list[Fit] = []
    first: dict[str, Fit] = {}
    count = Counter[str]()
    for f in sorted(fits, key=lambda f: f.cost):
        name = f.model.names[-1]
        if any(_same(f, other, SAME * max(cost - f.cost, 1.0)) for other in chosen):
            continue
        first.setdefault(name, f)
        count[name] += 1
        if count[name] <= PLACES and cost - f.cost >= PROMISING * most:
            chosen.append(f)
    names = {f.model.names[-1] for f in chosen}
    if before is None or names == set(first):
        return chosen
    best = list(first.values())
    likely = each(quiet.in_own_noise, [before, *map(partial(_left, quiet), best)])
    gains = [one - likely[0] for one in likely[1:]]
    least = max(PROMISING * max(gains), FAINT)
    told = zip(best, gains, strict=True)
    return chosen + [f for f, gain in told if f.model.names[-1] not in names and gain >= least]


def _left(scene: Scene, fit: Fit) -> list[Array]:
    return raw_residuals(scene, fit.model)


def _same(one: Fit, other: Fit, within: float) -> bool:
    """The same effect at the same place, in the same valley."""
    this, that = one.model.effects[-1], other.model.effects[-1]
    alike = this.name == that.name and dict(this.options) == dict(that.options)
    return alike and abs(one.cost - other.cost) < within

"""Who of the screen's candidates is worth a fit."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from ffl.diagnose.contest.judging import PER_NUMBER
from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.screen.candidate import Candidate
from ffl.effects import EFFECTS

SHORTLIST = 6
WORTH_A_FIT = 0.15  # of the best first-order gain
ELSEWHERE = 0.4  # of the first-order gain: the same physics at another point worth a fit


def shortlist(
    candidates: Sequence[Candidate],
    depth: int = SHORTLIST,
    places: int = 2,
    points: Collection[Place] = (),
) -> list[Candidate]:
    """Who is worth a full fit: the best of the screen, one place per effect but for the first few
    (`places`), and their siblings; of forces also at `points`, where effects stand already: what drives
    a machine, holds and guides it is often one and the same part."""
    if not candidates:
        return []
    best: dict[str, Candidate] = {}
    for c in candidates:
        best.setdefault(c.spec.name, c)
    ranked = sorted(best.values(), key=lambda c: -(c.gain - 2 * PER_NUMBER * c.freedom))
    top = ranked[0].gain
    chosen = [c for c in ranked[:depth] if c.gain > WORTH_A_FIT * top]
    names = {c.spec.name for c in chosen}
    for k, c in enumerate(list(chosen)):  # the same physics at another point of the machine
        elsewhere = [o for o in candidates if o.spec.name == c.spec.name and o is not c]
        near = [o for o in elsewhere if o.gain > ELSEWHERE * c.gain]
        chosen += near if k < places else _there(near, c, points)
    for c in ranked[:2]:
        for sibling in EFFECTS[c.spec.name].siblings:
            if sibling in best and sibling not in names and best[sibling].gain > 0.02 * top:
                chosen.append(best[sibling])
                names.add(sibling)
    return chosen


def _there(
    others: Sequence[Candidate], chosen: Candidate, points: Collection[Place]
) -> list[Candidate]:
    """The best of `others` at each of `points` where `chosen` is not."""
    out: dict[Place, Candidate] = {}
    for o in others:
        if o.place in points and o.place != chosen.place:
            out.setdefault(o.place, o)
    return list(out.values())

"""Who of the screen's candidates is worth a fit."""

from __future__ import annotations

from collections.abc import Sequence

from ffl.diagnose.judging import PER_NUMBER
from ffl.diagnose.screen import Candidate
from ffl.effects import EFFECTS

SHORTLIST = 6
WORTH_A_FIT = 0.15  # of the best first-order gain
ELSEWHERE = 0.4  # of the first-order gain: the same physics at another point worth a fit


def shortlist(
    candidates: Sequence[Candidate], depth: int = SHORTLIST, places: int = 2
) -> list[Candidate]:
    """Who is worth a full fit: the best of the screen, one place per effect but for the first few
    (`places`), and their siblings."""
    if not candidates:
        return []
    best: dict[str, Candidate] = {}
    for c in candidates:
        best.setdefault(c.spec.name, c)
    ranked = sorted(best.values(), key=lambda c: -(c.gain - 2 * PER_NUMBER * c.freedom))
    top = ranked[0].gain
    chosen = [c for c in ranked[:depth] if c.gain > WORTH_A_FIT * top]
    names = {c.spec.name for c in chosen}
    for c in list(chosen[:places]):  # the same physics at another point of the machine
        elsewhere = [o for o in candidates if o.spec.name == c.spec.name and o is not c]
        chosen += [o for o in elsewhere if o.gain > ELSEWHERE * c.gain]
    for c in ranked[:2]:
        for sibling in EFFECTS[c.spec.name].siblings:
            if sibling in best and sibling not in names and best[sibling].gain > 0.02 * top:
                chosen.append(best[sibling])
                names.add(sibling)
    return chosen

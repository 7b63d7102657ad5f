"""A friction by position taken apart again: plain dry friction, and a force by position beside it.

A table of levels for either direction holds both, and does more than both as long as somebody else is
missing whose share it can draw as well. It is taken for them before that one joins, and each half alone is
far behind it: so once all stand it is held against the two. (Cogging and Coulomb friction of two masses
were a table of 66 numbers by 152, whose drive had a gain by position; beside that gain the two are ahead.)
"""

from __future__ import annotations

from collections.abc import Callable

from ffl.diagnose.contest.judging import Judged, credible, judge, levelled, likeliest
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.settle import excluded, plain_form
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.ladders import with_best_start
from ffl.diagnose.hypothesis.model import TABLE
from ffl.diagnose.screen.screen import Screen
from ffl.effects import EFFECTS

TRIED = 2  # forces by position that promise most beside plain friction


def untabled(
    quiet: Scene, held: Scene | None, current: Judged, say: Callable[[str], None]
) -> Judged | None:
    """`current` with plain dry friction and the likeliest force by position for its table; None where it
    has none, nobody stands beside it, or no such two come up to it."""
    model = current.model
    if TABLE not in model.names or TABLE in model.proven or len(model.effects) < 2:
        return None
    index = model.names.index(TABLE)
    plain = plain_form(model.effects[index])
    if plain is None:
        return None
    like = fit(quiet, model.without(index).with_effect(plain), rounds=6)
    taken = excluded(like.model)
    forces = [
        name
        for name, effect in EFFECTS.items()
        if effect.port == "force" and set(effect.depends_on) == {"position"} and name not in taken
    ]
    found: list[Judged] = []
    for c in Screen(quiet, like).candidates(forces)[:TRIED]:
        start = with_best_start(quiet, c)
        two = judge(quiet, held, fit(quiet, start, rounds=6, known=like.shared(start)).model, 10)
        ahead, behind = levelled([two, current])
        gained = ahead.score - behind.score
        say(f"  {plain.name} and {c.spec.name} for {TABLE}: {gained:+.1f}")
        if gained > 0.0 and credible(two):
            found.append(two)
    return likeliest(found) if found else None

"""A friction by position taken apart again: plain dry friction, and a force by position beside it.

A table of levels for either direction holds both, and does more than both as long as somebody else is
missing whose share it can draw as well. It is taken for them before that one joins, and each half alone is
far behind it: so once all stand it is held against the two. (Cogging and Coulomb friction of two masses
were a table of 66 numbers by 152, whose drive had a gain by position; beside that gain the two are ahead.)
"""

from __future__ import annotations

from collections.abc import Callable

from ffl.diagnose.contest.dry import excluded, level_of, plain_form
from ffl.diagnose.contest.judging import Judged, credible, judge, levelled, likeliest
from ffl.diagnose.contest.plainest import CONTACT
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.ladders import with_best_start
from ffl.diagnose.hypothesis.model import TABLE
from ffl.diagnose.hypothesis.places import POINT
from ffl.diagnose.screen.screen import Screen
from ffl.effects import EFFECTS, Effect
from ffl.systems.plant import EffectSpec

TRIED = 2  # of those that promise most beside the friction


def untabled(
    quiet: Scene, held: Scene | None, current: Judged, say: Callable[[str], None]
) -> Judged | None:
    """`current` with two in the place of its table: plain dry friction and the likeliest force by position,
    or, where its contact yields, presliding friction and the likeliest of all; None where it has no table,
    nobody stands beside it, or no such two come up to it."""
    model = current.model
    if TABLE not in model.names or TABLE in model.proven or len(model.effects) < 2:
        return None
    index = model.names.index(TABLE)
    spec, bare = model.effects[index], model.without(index)
    forces = [name for name, effect in EFFECTS.items() if _by_position(effect)]
    pairs = ((plain_form(spec), forces), (_yielding(spec), list(EFFECTS)))
    found: list[Judged] = []
    for dry, names in pairs:
        if dry is None:
            continue
        like = fit(quiet, bare.with_effect(dry), rounds=6)
        free = [name for name in names if name not in excluded(like.model)]
        for c in Screen(quiet, like).candidates(free)[:TRIED]:
            start = with_best_start(quiet, c)
            two = judge(
                quiet, held, fit(quiet, start, rounds=6, known=like.shared(start)).model, 10
            )
            ahead, behind = levelled([two, current])
            gained = ahead.score - behind.score
            say(f"  {dry.name} and {c.spec.name} for {TABLE}: {gained:+.1f}")
            if gained > 0.0 and credible(two):
                found.append(two)
    return likeliest(found) if found else None


def _by_position(effect: Effect) -> bool:
    return effect.port == "force" and set(effect.depends_on) == {"position"}


def _yielding(table: EffectSpec) -> EffectSpec | None:
    """Presliding friction of the mean level of a `table`, as stiff as its contact; None of a rigid one.
    (A seal that gives way, a dead zone and a load of -12 N were a table of levels by direction, all alike,
    and a load of -3.7 N.)"""
    stiffness, level = table.parameters.get("stiffness"), level_of(table)
    if not stiffness or level is None:
        return None
    options = {k: v for k, v in table.options.items() if k in POINT}
    values = {"level": level, "stiffness": stiffness, "micro_damping": 0.0}
    return EffectSpec(CONTACT, values, options)

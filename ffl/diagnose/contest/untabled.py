"""A friction by position taken apart again: plain dry friction, and a force by position beside it.

A table of levels for either direction holds both, and does more than both as long as somebody else is
missing whose share it can draw as well. It is taken for them before that one joins, and each half alone is
far behind it: so once all stand it is held against the two. (Cogging and Coulomb friction of two masses
were a table of 66 numbers by 152, whose drive had a gain by position; beside that gain the two are ahead.)
So it is alone where it leaves far more than noise: it came in the place of another, who held neither.
(Cogging with a harmonic at a motor and levels by direction at its load were presliding friction first, then
the table by 3,945, 35 times the error held out; the two are 1,315 ahead of it.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.dry import BY_DIRECTION, excluded, level_of, plain_form
from ffl.diagnose.contest.judging import Judged, credible, judge, levelled, likeliest
from ffl.diagnose.contest.plainest import CONTACT
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import Fit, fit
from ffl.diagnose.hypothesis.harmonics import with_harmonics
from ffl.diagnose.hypothesis.ladders import with_best_start
from ffl.diagnose.hypothesis.model import TABLE, Model
from ffl.diagnose.hypothesis.places import of_the_machine, placed
from ffl.diagnose.screen.screen import Screen
from ffl.effects import EFFECTS, Effect
from ffl.effects.periods import AGAIN, sine_pair
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

REPEATS = "cogging"
PART = 0.1  # of a period over the travel: from one wave to the next
LEVEL = 0.1  # share by which levels of the two directions differ that are told as two
TRIED = 2  # of those that promise most beside the friction


def untabled(
    quiet: Scene, held: Scene | None, current: Judged, say: Callable[[str], None]
) -> Judged | None:
    """`current` with two in the place of its table: plain dry friction, with a level for either direction
    where the table's differ, and the likeliest force by position with its harmonics, or, where its contact
    yields, presliding friction and the likeliest of all; None where it has no table, stands alone and
    leaves little, or no such two come up to it."""
    model = current.model
    if TABLE not in model.names or TABLE in model.proven:
        return None
    if len(model.effects) < 2 and not current.fit.far:
        return None
    index = model.names.index(TABLE)
    spec, bare = model.effects[index], model.without(index)
    forces = [name for name, effect in EFFECTS.items() if _by_position(effect)]
    read = _repeats(spec)
    pairs = (
        (plain_form(spec), forces, read),
        (_by_direction(spec), forces, read),
        (_yielding(spec), list(EFFECTS), None),
    )
    found: list[Judged] = []
    for dry, names, also in pairs:
        for first in [] if dry is None else _beside(quiet, bare.with_effect(dry), names, also):
            two = with_harmonics(quiet, held, judge(quiet, held, first.model, 10), say)
            ahead, behind = levelled([two, current])
            gained = ahead.score - behind.score
            say(f"  {two.name} for {TABLE}: {gained:+.1f}")
            if gained > 0.0 and credible(two):
                found.append(two)
    return likeliest(found) if found else None


def _beside(quiet: Scene, model: Model, names: Sequence[str], read: EffectSpec | None) -> list[Fit]:
    """`model` with each of those of `names` that promise most beside it, and with what was `read` off the
    table, at the place where that leaves least, fitted as far as it is seen how far they get."""
    like = fit(quiet, model, rounds=6)
    free = [name for name in names if name not in excluded(like.model)]
    starts = [with_best_start(quiet, c) for c in Screen(quiet, like).candidates(free)[:TRIED]]
    begun = [fit(quiet, start, rounds=6, known=like.shared(start)) for start in starts]
    if read is not None and read.name in free:
        places = [replace(read, options=place.options) for place in of_the_machine(model)]
        tried = [fit(quiet, model.with_effect(there), rounds=6) for there in places]
        begun.append(min(tried, key=lambda one: one.cost))
    return begun


def _by_position(effect: Effect) -> bool:
    return effect.port == "force" and set(effect.depends_on) == {"position"}


def _by_direction(table: EffectSpec) -> EffectSpec | None:
    """Dry friction of the mean level of a `table` for either direction; None where these are nearly one."""
    values = table.parameters["table"]
    ways = {f"level_{way}": float(np.mean(values[way])) for way in ("positive", "negative")}
    low, high = sorted(ways.values())
    if low <= 0.0 or high - low < LEVEL * high:
        return None
    options = placed(table)
    return EffectSpec(BY_DIRECTION, ways, options)


def _repeats(table: EffectSpec) -> EffectSpec | None:
    """A cogging that is half of what a `table` has more in the one direction than in the other, its mean
    aside, F = (negative - positive)/2: the period that leaves least at the knots, the finest of two knots.
    Beside the friction alone a screen sees the corrections that were bent in its place, and may see no
    period; the table has it. None of one with too few knots for a period and a half."""
    levels = table.parameters["table"]
    x, force = np.array(levels["grid"]), 0.5 * np.subtract(levels["negative"], levels["positive"])
    span = float(np.ptp(x))
    waves = np.arange(AGAIN / span, 0.5 * (len(x) - 1) / span, PART / span)

    def sine(wave: float) -> tuple[float, float, Array]:
        angle = 2.0 * np.pi * wave * x
        columns = np.column_stack([np.sin(angle), np.cos(angle), np.ones_like(x)])
        drawn = np.linalg.lstsq(columns, force, rcond=1e-9)[0]
        return float(np.sum((force - columns @ drawn) ** 2)), wave, drawn

    if not len(waves):
        return None
    _, wave, drawn = min(map(sine, waves), key=lambda one: one[0])
    return EffectSpec(REPEATS, {"period": 1.0 / wave, **sine_pair(drawn)})


def _yielding(table: EffectSpec) -> EffectSpec | None:
    """Presliding friction of the mean level of a `table`, as stiff as its contact; None of a rigid one.
    (A seal that gives way, a dead zone and a load of -12 N were a table of levels by direction, all alike,
    and a load of -3.7 N.)"""
    stiffness, level = table.parameters.get("stiffness"), level_of(table)
    if not stiffness or level is None:
        return None
    options = placed(table)
    values = {"level": level, "stiffness": stiffness, "micro_damping": 0.0}
    return EffectSpec(CONTACT, values, options)

"""Numbers of the model far from where it states them, and effects in their place.

A light resonance is damped as much by anything that comes late: below it the damping of a stage on a spring
does what a lag of the drive does, and much of what hysteresis does. Free beside every hypothesis it goes as
far as it must before any effect is asked for. From there no fit of the effect finds back, or the effect
brings little that is not there already. So who challenges is begun with such numbers as the model states
them too, and once more with them held there: an effect for a number that no engineer can have got so wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ffl.diagnose.contest.earning import LEAST
from ffl.diagnose.contest.judging import Judged, judge, levelled, raw_error
from ffl.diagnose.contest.restraint import worse
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.amounts import NAMES
from ffl.diagnose.hypothesis.model import Model

FAR = 3.0  # times what an engineer may be mistaken by: a damping 90 % off, a frequency 4.5 %
SURE = 3.0  # standard errors
TELLS = 25.0  # score by which an effect must be ahead of the numbers in whose place it is
TRIED = 4  # challengers that are begun so, one of a name
ROUNDS = 10


def far_off(judged: Judged) -> frozenset[str]:
    """Dampings and frequencies, sure ones, farther from the model's than an engineer may be mistaken by: a
    mass or a spring is what it is, and nobody else does what it does."""
    model = judged.model
    return frozenset(
        c.name
        for c, spread in zip(model.coordinates, judged.spread, strict=True)
        if c.kind == "correction" and c.name not in ("mass", "stiffness")
        if abs(model.corrections.get(c.name, 0.0)) > max(FAR * c.doubt, SURE * spread)
    )


def begun_as_stated(
    quiet: Scene, held: Scene | None, base: Judged, rivals: Sequence[Judged]
) -> list[Judged]:
    """The first `rivals` of `base` begun with its numbers far off as the model states them. (Hysteresis in
    noise on a stage with a spring brought 64 beside 14 times its damping, and 520 from the stated one.)"""
    return [judge(quiet, held, model, ROUNDS) for model in _as_stated(base, rivals)[0]]


def in_their_place(
    quiet: Scene, held: Scene | None, base: Judged, rivals: Sequence[Judged], threshold: float
) -> list[Judged]:
    """The first `rivals` of `base` with its numbers far off held where the model states them, those that
    say clearly more than `base`, best first: each an effect for these numbers, so that it need not bring
    what one more effect must. (A lag of 2.9 ms beside a limit was six times the damping and 99 behind.)"""
    models, names = _as_stated(base, rivals)
    held_there = [replace(model, unmoved=model.unmoved | names) for model in models]
    base, *kept = levelled([base, *(judge(quiet, held, model, ROUNDS) for model in held_there)])
    ahead = [
        r
        for r in kept
        if r.score > base.score + max(TELLS, threshold)
        if r.fitted > base.fitted + LEAST and r.held_out > base.held_out - LEAST / 2
    ]
    return sorted(ahead, key=lambda r: -r.score)


def _as_stated(base: Judged, rivals: Sequence[Judged]) -> tuple[list[Model], frozenset[str]]:
    """(The first `rivals` with the numbers of `base` that are far off as the model states them, one of a
    name; these numbers). None where much more than noise is left: there such numbers stand for what nobody
    has said yet."""
    names = frozenset() if base.fit.far else far_off(base)
    first: dict[str, Model] = {}
    for rival in sorted(rivals, key=lambda j: -j.score) if names else ():
        stated = {k: v for k, v in rival.model.corrections.items() if k not in names}
        first.setdefault(rival.name, replace(rival.model, corrections=stated))
    return list(first.values())[:TRIED], names


def let_free(held: Scene | None, judged: Judged) -> Judged:
    """`judged` with the numbers free again that it has as stated for an effect in their place; not the one
    that an effect of its kind stands for, which would trade against it, and none where held-out recordings
    speak against it. (With 12 % more mass a robot's axis was left with five times the error there.)"""
    own = {name for name, effect in NAMES.items() if effect in judged.model.names}
    free = replace(judged.model, unmoved=judged.model.unmoved & own)
    if free.unmoved == judged.model.unmoved:
        return judged
    freed = judge(judged.scene, held, free, ROUNDS, judged.fit)
    errors = raw_error(held, freed.model), raw_error(held, judged.model)
    return judged if worse(held, freed, judged, *errors) else freed

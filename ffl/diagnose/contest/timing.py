"""A delay or a lag beside a flexible mode, begun from the delay or the lag.

A delay, a lag and a mode bend the same phase. Where a lag came in first, alone ahead of a delay, the mode
beside it settles where it makes up for what is wrong with the lag, and from there neither may be exchanged
alone. (A delay of two samples beside a mode at 134 Hz was told as a lag of as much and a mode at 52 Hz; a
mode that is looked for beside the delay alone comes to 131 Hz, 4,400 ahead.)
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace

from ffl.diagnose.contest.judging import Judged, credible, judge, levelled
from ffl.diagnose.contest.line import LATE
from ffl.diagnose.contest.modes import MODE, from_everywhere
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.settle import SUBSTITUTE
from ffl.diagnose.hypothesis.ladders import with_best_start
from ffl.diagnose.screen.screen import Screen, as_measured
from ffl.systems.plant import EffectSpec

BENDING = ("actuator_lag", "input_delay")
NEAR = 20.0  # score by which a pair may be behind under the noise of the one that stands
PLACES = 2  # of a mode, that are fitted


def begun_late(
    quiet: Scene, held: Scene | None, current: Judged, say: Callable[[str], None]
) -> Judged | None:
    """The best of a delay and of a lag, each with the mode that is looked for beside it, in the place of
    what `current` has of the three, where that is two of them or more; None where it is not within `NEAR`
    of `current`: under its own noise it may yet be ahead. (A wafer arm with a delay of 4.3 ms and a mode at
    35 Hz was told a lag of 3.6 ms and a delay of 0.8: where first order begins the mode it ends 48 behind,
    where all frequencies and sizes are tried first 150 ahead.)"""
    model = current.model
    own = {spec.name: spec for spec in model.effects if spec.name in (*BENDING, MODE)}
    late = sum(own[name].parameters[LATE[name]] for name in BENDING if name in own)
    if len(own) < 2 or late <= 0.0 or model.proven & set(own):
        return None
    company = replace(
        model, corrections={k: model.corrections[k] for k in model.corrections.keys() & model.held}
    )
    for name in own:
        company = company.without(company.names.index(name))
    near = []
    for name in BENDING:
        beside = company.with_effect(EffectSpec(name, {LATE[name]: late}, {}))
        begun = judge(quiet, held, beside, 8).fit
        screen = as_measured(quiet, begun) or Screen(quiet, begun)
        seen = [with_best_start(quiet, c) for c in screen.candidates([MODE])[:PLACES]]
        deepest = from_everywhere(quiet, begun, begun.model)[0].model
        for start in (*seen, deepest):  # first order sees one valley where others are deeper
            rival = judge(quiet, held, start, 10)
            if not credible(rival):
                continue
            ahead, stands = levelled([rival, current])
            gained = ahead.score - stands.score
            say(f"  {name}, then {MODE}, for {' and '.join(own)}: {gained:+.1f}")
            near.append((gained - SUBSTITUTE * (start is deepest), rival))
    gained, best = max(near, key=lambda way: way[0], default=(-float("inf"), None))
    return best if gained > -NEAR else None


def late_otherwise(
    held: Scene | None, judged: Judged, outcome: Outcome, before: Collection[str]
) -> tuple[Judged, Outcome]:
    """(`judged`, `outcome` with who was tried as its rival), or with a delay for its lag or a lag for its
    delay, where an effect has come in that was not among those `before`, as a number of the model's own
    that crossed the line: beside the free number another lateness stood. (A delay of 1.12 ms and 5.3 % more
    mass at the motor: a lag was 468 ahead beside a mass that was free everywhere, the delay is 461 ahead
    beside what was missing.)"""
    names = judged.model.names
    own = [name for name in BENDING if name in names]
    if set(names) <= set(before) or len(own) != 1 or own[0] in judged.model.proven:
        return judged, outcome
    (mine,), index = own, names.index(own[0])
    (other,) = [name for name in BENDING if name != mine]
    spec = judged.model.effects[index]
    effects = list(judged.model.effects)
    effects[index] = EffectSpec(other, {LATE[other]: spec.parameters[LATE[mine]]}, {})
    rival = judge(judged.scene, held, replace(judged.model, effects=tuple(effects)), 10)
    if not credible(rival):
        return judged, outcome
    ahead, stands = levelled([rival, judged])
    best, name = (ahead, other) if ahead.score > stands.score else (judged, mine)
    pair = [(other, ahead), (mine, stands)]
    return best, replace(outcome, contenders={**outcome.contenders, name: pair})

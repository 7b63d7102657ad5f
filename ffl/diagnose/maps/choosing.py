"""Which of the maps that were tried is believed, and whether it earns its place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffl.diagnose.contest.earning import HALF, LOST, UNTOLD, promised
from ffl.diagnose.maps.form import FreeForm, held_gain
from ffl.diagnose.maps.freemodel import SENT, Part
from ffl.diagnose.maps.freerank import WORTH, Entry
from ffl.diagnose.maps.known import HELD_WORTH, hardly_shown

SHARE = 0.004  # of the number of samples: log-likelihood that a further map must bring
RECORDED = 2.0  # times the squares that a map of what was recorded leaves: less than were there
FAR = 2.5  # times what another map leaves: a map that leaves more is not nearly right
SIMPLER = 0.97  # share of the best score at which a map of fewer variables is preferred, if it
NO_WORSE = 1.25  # leaves no more than this of what the best one leaves
SEEN = 0.5  # of what one map knows: another that knows less of it is no judge
CLOSE = 1.1  # times what another map leaves of held-out recordings: as much as it does


def score_of(f: FreeForm, before: FreeForm) -> float:
    return f.evidence - before.evidence + held_of(before, f)


def earns(f: FreeForm, before: FreeForm) -> bool:
    """Enough in fitted and held-out recordings alike; a further map must not patch what the first one
    leaves imperfect."""
    fitted, held = f.evidence - before.evidence, held_of(before, f)
    if any(p.place.side == SENT for p in f.parts) and before.cost < RECORDED * f.cost:
        return False  # feedback makes the command of the noise too (a null: 243 nats, 5 % of the squares)
    if before.parts and (fitted < SHARE * len(f.white) or held < SHARE * int(f.known.sum())):
        return False
    if not before.held_white.size:
        return fitted > WORTH
    if hardly_told(before, f):
        return fitted > UNTOLD and held > -max(HELD_WORTH, LOST * fitted)
    # Of little that could be told there, half.
    sure = fitted > UNTOLD and held > HALF * promise_of(before, f)
    return fitted > WORTH and (held > HELD_WORTH or sure)


def promise_of(before: FreeForm, after: FreeForm) -> float:
    """See `promised`, where the maps are known."""
    if not before.held_white.size:
        return np.inf
    return promised(after.held_white, before.held_white, after.known)


def hardly_told(before: FreeForm, after: FreeForm) -> bool:
    """The held-out recordings hardly show the maps."""
    return hardly_shown(promise_of(before, after), after.evidence - before.evidence)


def held_of(before: FreeForm, after: FreeForm) -> float:
    return held_gain(before.held_white, after.held_white, after.known)


def not_far(done: Sequence[FreeForm]) -> list[FreeForm]:
    """Those beside whom no other that leaves hardly more where it was fitted leaves so much less held out
    that they are not nearly right, whatever they took off. (Of heat in a servo's stage a map that sees the
    command as recorded took off nine tenths, feedback's answer in it, and left eight times what heat left.
    Of an eddy brake on a printer the one that left 1.2 of the noise where it was fitted left 245 held out,
    another from elsewhere 1.4 and 2.5.)"""
    return [f for f in done if not any(_far_ahead(g, f) for g in done)]


def _far_ahead(g: FreeForm, f: FreeForm) -> bool:
    """Held out, on what both know, and hardly behind where they were fitted."""
    if g.cost > NO_WORSE * f.cost:
        return False
    both = f.known & g.known
    if both.sum() <= SEEN * f.known.sum():
        return FAR * g.cost < f.cost and FAR * g.held_cost < f.held_cost
    ahead, behind = (float(np.mean(one.held_white[both] ** 2)) for one in (g, f))
    return FAR * ahead < behind


def no_worse(done: Sequence[FreeForm], current: FreeForm) -> list[FreeForm]:
    """The map of the best score, and those near it that leave hardly more than it does, in the fitted and
    in the held-out recordings."""
    best = max(done, key=lambda f: score_of(f, current))
    least = SIMPLER * score_of(best, current)
    return [
        f
        for f in done
        if score_of(f, current) >= least
        and f.cost <= NO_WORSE * best.cost
        and f.held_cost <= NO_WORSE * best.held_cost
    ]


def near(listed: Sequence[Entry]) -> list[Part]:
    """The maps of one variable that to first order are worth as much as the best."""
    least = SIMPLER * listed[0].evidence.gain
    near = [e.part for e in listed if e.evidence.gain >= least]
    return [part for part in near if len(part.term.variables) == 1]


def alike(f: FreeForm, best: FreeForm) -> bool:
    """Recordings cannot tell `f`, of other variables than `best` and not of more, from it. (Where a spring
    holds a slow stage, what depends on the command and what depends on the position are one.)"""
    own, other = best.parts[-1].term.variables, f.parts[-1].term.variables
    if set(own) & set(other) or len(other) > len(own):
        return False
    known = f.known & best.known
    ahead = held_gain(f.held_white, best.held_white, known)
    left, least = (float(np.sum(one.held_white[known] ** 2)) for one in (f, best))
    # Neither is drawn exactly: of long recordings a few per cent of the noise are many times a likelihood.
    return 0.5 * (f.cost - best.cost) < WORTH and (ahead < HELD_WORTH or left < CLOSE * least)


def drives_itself(f: FreeForm) -> bool:
    """With less than no damping: of maps that do as much the others come first. (A force by position
    beside -1.4 times the stated damping stood for an amplifier weaker one way.)"""
    return f.free.model.corrections.get("damping", 0.0) < -1.0


def taken_up(f: FreeForm) -> bool:
    """A mass that is another as time goes on. Where nothing but the mass takes force, it and a gain that is
    another are one; gains fade more often, so of maps that do as much the others come first."""
    return f.parts[-1].term.name == "inertia by time"

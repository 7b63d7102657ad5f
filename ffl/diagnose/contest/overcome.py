"""A load beyond the friction: levels by direction of which one has come down to nothing.

A constant load and dry friction below it push the same way in both directions. Levels by direction hold
them as long as the friction is the larger; beyond, the lower one ends at its bound, and what is left is
neither's. (A load of -6.9 N and a Stribeck curve from 6.3 to 3.1 N behind a spring were levels of 10.4 and
0 N, 6.5 times the error held out; neither half comes near the levels by itself.)
"""

from __future__ import annotations

from collections.abc import Callable

from ffl.diagnose.contest.dry import BY_DIRECTION, PLAINEST
from ffl.diagnose.contest.judging import Judged, best_against, judge
from ffl.diagnose.contest.parallel import each
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import LOAD
from ffl.diagnose.hypothesis.places import of_the_machine, placed
from ffl.systems.plant import EffectSpec

NOTHING = 0.05  # of the upper level: a lower one that is as good as none
SHARES = (0.25, 0.45)  # of the upper level: a friction to begin with, the rest the load's
ROUNDS = 12


def overcome(
    quiet: Scene, held: Scene | None, current: Judged, say: Callable[[str], None]
) -> Judged | None:
    """`current` with plain dry friction and a constant load in the place of levels by direction of which
    one is nothing, wherever on the machine that is likeliest; None where they are not ahead. What form
    the friction has, and where else the load acts, is asked once they stand."""
    model = current.model
    if BY_DIRECTION not in model.names or BY_DIRECTION in model.proven or LOAD in model.names:
        return None
    at = model.names.index(BY_DIRECTION)
    levels = model.effects[at]
    up, down = (float(levels.parameters[f"level_{way}"]) for way in ("positive", "negative"))
    most = max(up, down)
    if not min(up, down) < NOTHING * most:
        return None
    bare = model.without(at)
    options = [placed(levels)]
    options += [place.options for place in of_the_machine(model) if place.options not in options]
    starts = []
    for there in options:
        for share in SHARES:
            level = share * most
            force = (level - most) if up > down else (most - level)
            both = bare.with_effect(EffectSpec(PLAINEST, {"level": level}, there))
            starts.append(both.with_effect(EffectSpec(LOAD, {"force": force}, there)))
    tried = each(lambda start: judge(quiet, held, start, ROUNDS), starts)
    found = best_against(tried, current)
    if found is None:
        return None
    best, gained = found
    say(f"  {PLAINEST} and {LOAD} for {BY_DIRECTION}: {gained:+.1f}")
    return best if gained > 0.0 else None

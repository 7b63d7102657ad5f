"""Who comes second by a little, where something is left that nobody may explain: another way to go on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.dry import CREEPING, DRY
from ffl.diagnose.contest.earning import promise
from ffl.diagnose.contest.judging import Judged, best_against, judge
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.settle import KEEP
from ffl.diagnose.hypothesis.model import LOAD
from ffl.systems.plant import EffectSpec

NEAR = 0.3  # of what the best refused would bring: a rival behind by less may be the better start
FORKS = 2  # most of these that are followed
HARDENS = "hardening_spring"
WITHIN = (0.25, 0.5, 0.75)  # of the travel: where the middle of a spring is looked for
ROUNDS = 20  # of a fit from there
BEHIND = 20.0  # score by which a spring about a middle of its own and a load may be behind


def forks(outcome: Outcome) -> list[tuple[str, Judged]]:
    """(effect, hypothesis with another in its place), best first, that come near what stands, leave
    something else than it, and by less than what the best of those that found no leave would bring,
    its numbers not charged: it tells how much is left."""
    refused = []
    for step in reversed(outcome.steps):
        if step.accepted is not None:
            break
        refused += [
            rival.fitted + rival.held_out - step.before.fitted - step.before.held_out
            for rival in step.rivals
        ]
    left = max(refused, default=0.0)
    if left < KEEP:
        return []
    out = []
    for name, others in outcome.contenders.items():
        own = others[0][1]
        for rival, other in others[1:]:
            gap = own.score - other.score
            if rival == name or {rival, name} <= DRY - CREEPING or gap > NEAR * left:
                continue  # forms of one friction differ by too little to be another way
            if promise(other.fit.white, own.fit.white) > gap + KEEP:
                out.append((gap, name, other))
    nearest: dict[tuple[str, ...], tuple[str, Judged]] = {}
    for _, name, other in sorted(out, key=lambda f: f[0]):
        nearest.setdefault(other.model.names, (name, other))
    return list(nearest.values())[:FORKS]


def within_the_travel(
    quiet: Scene, held: Scene | None, current: Judged, say: Callable[[str], None]
) -> Judged | None:
    """A hardening spring about a place within the travel and a constant load, for one whose middle no
    recording came near; None where it is behind by more than `BEHIND`: beside who is missing it may be
    ahead. (Far from its middle it is a load and a spring that hardly hardens, and no load comes in beside
    it: of a spring, a load and a dead zone one spring was told, and the dead zone not.)"""
    model = current.model
    if model.names.count(HARDENS) != 1 or LOAD in model.names or HARDENS in model.proven:
        return None
    at = model.names.index(HARDENS)
    place = np.concatenate([trial.y for trial in quiet.trials])
    low, high = float(place.min()), float(place.max())
    spring = model.effects[at]
    centre, steep = (float(spring.parameters[name]) for name in ("centre", "cubic_coefficient"))
    if low <= centre <= high:
        return None
    bare = {k: v for k, v in model.corrections.items() if k in model.held}
    tried = []
    for part in WITHIN:
        middle = low + part * (high - low)
        columns = np.column_stack([(place - middle) ** 3, -np.ones_like(place)])
        hard, force = np.linalg.lstsq(columns, steep * (place - centre) ** 3, rcond=None)[0]
        values = {"centre": middle, "cubic_coefficient": float(hard)}
        load = EffectSpec(LOAD, {"force": float(force)}, spring.options)
        other = replace(model, corrections=bare).with_parameters(at, values).with_effect(load)
        tried.append(judge(quiet, held, other, ROUNDS))
    found = best_against(tried, current)
    if found is None:
        return None
    best, gained = found
    say(f"  {HARDENS} within the travel and {LOAD}: {gained:+.1f}")
    return best if gained > -BEHIND else None

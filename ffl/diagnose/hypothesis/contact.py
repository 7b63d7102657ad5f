"""The form of a contact that gives way: many elements that slide one after the other, or one bristle.

They differ where the motion turns back: the elements start again at the full stiffness, the bristle at
up to twice of it. One taken for the other gets the stiffness wrong by that factor, and what it leaves
looks like damping.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.judging import Judged, judge, levelled
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Model
from ffl.effects import EFFECTS

NAME = "presliding_friction"
FACTORS = (0.5, 1.0, 2.0)  # on the stiffness: what the other form takes it for
SOFTER = (0.1, 0.3)  # the same, of what is stuck in another valley


def with_other_contact(
    quiet: Scene, held: Scene | None, judged: Judged, say: Callable[[str], None]
) -> Judged:
    """`judged` with the other form of its presliding friction, or with a contact that is much softer, where
    that scores better: between two stiffnesses every one may be worse. (A pivot of 0.35 N m/rad stood
    as one of 3.16, with 0.7 as good as neither; begun at a tenth it was 230 ahead, at 0.346.)"""
    if NAME not in judged.model.names:
        return judged
    kinds = EFFECTS[NAME].options["kind"]
    other = next(k for k in kinds if k != _kind(judged))
    starts = [_with(judged, other, factor) for factor in FACTORS]
    best = starts[int(np.argmin([quiet.cost(start) for start in starts]))]
    judged = _better(quiet, held, judged, best, 4, f"{other} contact", say)
    for start in [_with(judged, _kind(judged), factor) for factor in SOFTER]:
        judged = _better(quiet, held, judged, start, 8, "softer contact", say)
    return judged


def _better(
    quiet: Scene,
    held: Scene | None,
    judged: Judged,
    start: Model,
    rounds: int,
    words: str,
    say: Callable[[str], None],
) -> Judged:
    """`judged`, or what `start` comes to in so many `rounds` where that scores better."""
    rival, judged = levelled([judge(quiet, held, start, rounds, judged.fit), judged])
    say(f"  {words}: {rival.score - judged.score:+.1f}")
    return rival if rival.score > judged.score else judged


def _kind(judged: Judged) -> str:
    spec = judged.model.effects[judged.model.names.index(NAME)]
    return str(spec.options.get("kind", EFFECTS[NAME].options["kind"][0]))


def _with(judged: Judged, kind: str, factor: float) -> Model:
    """The model with its contact of that `kind`, `factor` times as stiff."""
    model = judged.model
    index = model.names.index(NAME)
    spec = model.effects[index]
    values = {**spec.parameters, "stiffness": factor * spec.parameters["stiffness"]}
    other = replace(spec, parameters=values, options={**spec.options, "kind": kind})
    model = replace(model, effects=(*model.effects[:index], other, *model.effects[index + 1 :]))
    return model.at(model.theta)  # within bounds

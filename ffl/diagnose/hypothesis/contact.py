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
from ffl.effects import EFFECTS

NAME = "presliding_friction"
FACTORS = (0.5, 1.0, 2.0)  # on the stiffness: what the other form takes it for


def with_other_contact(
    quiet: Scene, held: Scene | None, judged: Judged, say: Callable[[str], None]
) -> Judged:
    """`judged` with the other form of its presliding friction where that scores better."""
    if NAME not in judged.model.names:
        return judged
    index = judged.model.names.index(NAME)
    spec = judged.model.effects[index]
    kinds = EFFECTS[NAME].options["kind"]
    kind = next(k for k in kinds if k != spec.options.get("kind", kinds[0]))
    starts = []
    for factor in FACTORS:
        values = {**spec.parameters, "stiffness": factor * spec.parameters["stiffness"]}
        other = replace(spec, parameters=values, options={**spec.options, "kind": kind})
        effects = (*judged.model.effects[:index], other, *judged.model.effects[index + 1 :])
        model = replace(judged.model, effects=effects)
        starts.append(model.at(model.theta))  # within bounds
    best = starts[int(np.argmin([quiet.cost(start) for start in starts]))]
    rival, judged = levelled([judge(quiet, held, best, 4, judged.fit), judged])
    say(f"  {kind} contact: {rival.score - judged.score:+.1f}")
    return rival if rival.score > judged.score else judged

"""One effect in the place of all that stand: what the stated machine shows beside them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from ffl.diagnose.contest.judging import Judged, credible, judge, levelled
from ffl.diagnose.contest.rounds import Step
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.settle import KEEP, SUBSTITUTE

ROUNDS = 8
CLEAR = 2.0  # times what those who stand brought: what it must promise to first order


def in_their_stead(
    steps: Sequence[Step],
    quiet: Scene,
    held: Scene | None,
    current: Judged,
    say: Callable[[str], None],
) -> Judged | None:
    """The effect that the last round saw most of beside the stated numbers, by itself, where that is more
    than those who stand have brought; None where it is no likelier than they are. Beside them nobody may
    earn a place who is what they stand for. (A mode of 0.04 Hz and the plant's own moved by 9 % rang like
    a disturbance at 15.4 Hz, which brought 100 beside them, and 490 more without; the first round had
    seen the mode, since the plant's own was 6 % off indeed.)"""
    model = current.model
    if not steps or not model.names or model.proven or model.names != steps[-1].before.model.names:
        return None
    stated = [
        c
        for c in steps[-1].screened
        if c.like.model.corrections != steps[-1].before.model.corrections
        and c.spec.name not in model.names
    ]
    best = max(stated, key=lambda c: c.gain, default=None)
    brought = current.fitted - steps[0].before.fitted
    if best is None or 0.5 * best.gain < CLEAR * max(brought, KEEP):
        return None
    start = replace(best.like.model, effects=()).with_effect(best.spec)
    alone = judge(quiet, held, start, ROUNDS)
    if not credible(alone):
        return None
    ahead, stands = levelled([alone, current])
    say(f"  {alone.name} alone: {ahead.score - stands.score:+.1f}")
    return alone if ahead.score > stands.score + SUBSTITUTE else None

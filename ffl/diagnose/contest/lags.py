"""Two lags in a row, fitted to a machine with an effect: the zero that they bent with may go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ffl.diagnose.contest.judging import Judged, judge, levelled
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.linear import WITHOUT_ZERO, has_zero


def plain_lags(
    quiet: Scene, held: Scene | None, base: Judged, say: Callable[[str], None]
) -> Judged:
    """Two lags without their zero where, beside effects, they do as well: a linear model that was fitted
    to a machine with the effect bends, and a zero is what two lags have to bend with."""
    model = base.model
    if not model.effects or WITHOUT_ZERO in model.corrections:
        return base
    if not has_zero(model.base.simulator.mechanics):
        return base
    corrections = {**model.corrections, WITHOUT_ZERO: 1.0}
    plain = replace(model, corrections=corrections, held=model.held | {WITHOUT_ZERO})
    other, base = levelled([judge(quiet, held, plain, 8), base])
    say(f"  the lags without their zero: {other.score - base.score:+.1f}")
    return other if other.score >= base.score else base

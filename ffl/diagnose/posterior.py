"""How sure a name is: its hypothesis against every other that was fitted in its place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ffl.diagnose.judging import Judged

TEMPER = 2.5  # scores are log-likelihoods of models that are all a little wrong
ELSE = 0.01  # probability that it is none of the rivals tried


def probabilities(
    name: str, contenders: Mapping[str, Sequence[tuple[str, Judged]]]
) -> dict[str, float]:
    """Probability of each name in the place of `name`, of the best hypothesis by that name:
    proportional to exp(score/TEMPER), `name` itself at least as probable as any other."""
    scores: dict[str, float] = {}
    for rival, judged in contenders.get(name, ()):
        if np.isfinite(judged.score):
            scores[rival] = max(scores.get(rival, -np.inf), judged.score)
    top = max(scores.values(), default=0.0)
    scores[name] = top
    weights = {n: float(np.exp(max((s - top) / TEMPER, -700.0))) for n, s in scores.items()}
    total = sum(weights.values()) / (1.0 - ELSE)
    return {n: w / total for n, w in weights.items()}

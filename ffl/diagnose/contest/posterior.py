"""How sure a name is: its hypothesis against every other that was fitted in its place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ffl.diagnose.contest.judging import Judged

# Calibrated on the last used-up seeds of the blind challenge: of names without a near rival and the verdict
# explained 496 of 506 were right (thirteen seeds), of those with structure left 102 of 119 (the same; on
# the eleven before them, with the methods of their days, 64 of 90).
TEMPER = 4.0  # scores are log-likelihoods of models that are all a little wrong
ELSE = 0.03  # probability that it is none of the rivals tried
ELSE_IF_MORE_IS_LEFT = 0.14  # the same where structure is left that no name explains
# The same where free runs leave far more than noise: of eight such names four were right.
ELSE_IF_FAR = 0.4
FAR = 8.0  # times what noise can make: of eight names that left ten times and more two were right
ELSE_IF_MOST_IS_LEFT = 0.6  # the same there


def probabilities(
    name: str, contenders: Mapping[str, Sequence[tuple[str, Judged]]], elsewhere: float = ELSE
) -> dict[str, float]:
    """Probability of each name in the place of `name`, of the best hypothesis by that name:
    proportional to exp(score/TEMPER), `name` itself at least as probable as any other. They sum to
    1 - `elsewhere`, the probability that it is none of them (`none_of_them`)."""
    scores: dict[str, float] = {}
    for rival, judged in contenders.get(name, ()):
        if np.isfinite(judged.score):
            scores[rival] = max(scores.get(rival, -np.inf), judged.score)
    top = max(scores.values(), default=0.0)
    scores[name] = top
    weights = {n: float(np.exp(max((s - top) / TEMPER, -700.0))) for n, s in scores.items()}
    total = sum(weights.values()) / (1.0 - elsewhere)
    return {n: w / total for n, w in weights.items()}


def none_of_them(complete: bool, loud: float, far: bool = False) -> float:
    """Probability that a name and all its rivals are wrong; `complete`: nothing is left but noise, `loud`:
    the noise that is left over what the plant file's can be at most, `far`: held-out free runs leave far
    more than noise."""
    if complete:
        return ELSE
    if loud > FAR:
        return ELSE_IF_MOST_IS_LEFT
    return ELSE_IF_FAR if far else ELSE_IF_MORE_IS_LEFT

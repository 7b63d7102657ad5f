"""A sine of time at its other frequencies: recordings on one clock, some way apart, make a comb of them.

Between recordings that begin `d` seconds after one another a sine of frequency f + k/d has the same phase
in both as one of f, and differs within each alone. So the likelihood has a tooth every 1/d, and first order
takes the one whose middle is nearest to what it tried; recordings that judge, elsewhere on the clock, then
speak against it. (1.1 N at 3.647 Hz, 19 s apart: at 3.596 Hz 61 fitted and 69 lost held out, at its own
67 and 94 gained.)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

from ffl.diagnose.contest.judging import Judged, judge
from ffl.diagnose.contest.parallel import each
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.model import Model
from ffl.effects import EFFECTS

WORTH = 20.0  # log-likelihood below which a sine is not worth a look
TEETH = 3  # on either side
PAIRS = 2  # of recordings, those nearest to one another
FOLLOWED = 2  # of the teeth that leave least
ROUNDS, LAST = 3, 6  # of the fits of all, and of those that are followed


def other_teeth(
    quiet: Scene, held: Scene | None, base: Judged, rivals: Sequence[Judged]
) -> list[Judged]:
    """The likeliest sine of time among `rivals` at those of its other frequencies that leave least of the
    fitted recordings; none where it does not do `WORTH` beyond `base`, or there is but one recording."""
    sines = [r for r in rivals if EFFECTS[r.model.names[-1]].scan == "time"]
    best = max(sines, key=lambda r: r.fitted, default=None)
    if best is None or best.fitted - base.fitted < WORTH:
        return []
    begun = list(_beside(best.model, quiet))
    fits = each(lambda model: fit(quiet, model, rounds=ROUNDS), begun)
    first = sorted(fits, key=lambda one: one.cost + one.surprise)[:FOLLOWED]
    return each(lambda one: judge(quiet, held, one.model, LAST, one), first)


def _beside(model: Model, scene: Scene) -> Iterator[Model]:
    *company, sine = model.effects
    starts = sorted(float(trial.t[0]) for trial in scene.trials)
    apart = sorted({round(b - a, 6) for a, b in pairwise(starts) if b > a})
    frequency = float(sine.parameters["frequency"])
    for d in apart[:PAIRS]:
        for k in range(-TEETH, TEETH + 1):
            other = frequency + k / d
            if k and other > 0.0:
                numbers = {**sine.parameters, "frequency": other}
                yield replace(model, effects=(*company, replace(sine, parameters=numbers)))

"""A play that was named by prediction, and free runs that follow it all the same.

Where nobody states the noise, a loop that never rattled may have lost the contest to what passes for noise.
The filter's company is then right and its gap in one of many narrow valleys. Free runs, where they follow
the machine, have one broad valley: from a ladder of gaps they are fitted by simulation, and where they are
as likely as the filter's answer, and follow the held-out recordings, the contest goes on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ffl.diagnose.contest.judging import Judged, judge, raw_error
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.search import go_on
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.noise import Noise

LADDER = (0.1, 0.2, 0.35, 0.6, 1.0, 1.6)  # times the gap
ROUNDS = 8
LITTLE = 0.1  # of the held-out sum of squares


def with_free_runs(
    scene: Scene,
    held: Scene | None,
    outcome: Outcome,
    prior: Noise,
    threshold: float,
    say: Callable[[str], None],
) -> Outcome:
    """`outcome`, or, where free runs of a play that was named by prediction follow the recordings, the
    contest gone on from there; `prior`: noise as the plant file states it, or a guess."""
    told = outcome.standing
    if held is None or not told.predicted or "backlash" not in told.model.names:
        return outcome
    ground = replace(scene, trials=told.scene.trials, noise=prior)
    judging = told.held or held
    run = [judge(ground, judging, model, ROUNDS) for model in _ladder(told.model)]
    best = max(run, key=lambda one: one.fitted)
    if not _follows(best, told, ground, judging):
        return outcome
    say(f"{best.name}: free runs follow it")
    found = go_on(replace(scene, trials=ground.trials), judging, best, threshold, say)
    followed = _follows(found.standing, told, ground, judging)
    return replace(found, steps=[*outcome.steps, *found.steps]) if followed else outcome


def _ladder(model: Model) -> list[Model]:
    """The same company with other gaps, the linear part as stated."""
    k = model.names.index("backlash")
    spec = model.effects[k]
    out = []
    for share in LADDER:
        wider = {**spec.parameters, "gap": spec.parameters["gap"] * share}
        effects = (*model.effects[:k], replace(spec, parameters=wider), *model.effects[k + 1 :])
        out.append(replace(model, effects=effects, corrections={}))
    return out


def _follows(freely: Judged, told: Judged, scene: Scene, held: Scene) -> bool:
    """Whether free runs are no less likely than what was `told` from sample to sample, and leave next to
    nothing of what its own free runs leave of the held-out recordings: there noise alone parts them."""
    if scene.like(freely.scene).by_free_run(freely.model) < told.fitted:
        return False
    return raw_error(held, freely.model) < LITTLE * raw_error(held, told.model)

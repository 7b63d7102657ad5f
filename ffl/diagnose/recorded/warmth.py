"""Heat that a recording begins with: what the machine did before is not recorded.

A map along the heat of the command, h' = (u^2 - h)/T, knows u from the first sample on. A machine that has
run before is warm by then: h begins at w, the squared command that it was warmed with, one number
for each recording, those that judge too. What the map does is straight in w,
    map(w) = map(0) + w (map(1) - map(0)),
so least squares find it. Begun cold, the best map of a warm machine has the wrong size and leaves
a slow force over, which passes for a drift beside it or in its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.optimize

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.maps.freemodel import (
    Evidence,
    FreeModel,
    FreeScreen,
    evidence,
    held_motion,
    posterior,
)
from ffl.diagnose.maps.terms import Ranges, Term
from ffl.effects import Motion
from ffl.systems.state_space import Array

ROUNDS = 8  # in which map and warmth are found by turns, to first order


def feels_heat(term: Term) -> bool:
    return term.along == "heat"


def hottest(u: Array) -> float:
    """The most that a command like this can have warmed with: its largest square."""
    return float(np.max(u**2, initial=0.0))


def first_warmth(
    screen: FreeScreen, term: Term, place: Place, span: Ranges, motions: Sequence[Motion],
    target: Array, every: int,
) -> tuple[Evidence, list[float]]:  # fmt: skip
    """Evidence of a heat map of which nothing is known yet, with the warmth of each recording under it,
    to first order and from one row in `every`."""
    most = np.array([hottest(m.u) for m in motions])

    def table(warmth: Array) -> Array:
        heated = [
            replace(held_motion(m, place), warm=float(w))
            for m, w in zip(motions, warmth, strict=True)
        ]
        columns = [term.columns(m, span) for m in heated]
        return screen.beyond(screen.through(place, columns))[::every]

    target, count = target[::every], len(most)
    cold = table(np.zeros(count))
    more = np.array([table(most * (np.arange(count) == k)) - cold for k in range(count)])
    alike = [float(np.mean(m.u**2)) for m in motions] / np.maximum(most, 1e-300)
    best, chosen = evidence(term, span, cold, target), np.zeros(count)
    if not np.isfinite(best.gain):  # a table that runs away
        return best, list(chosen)
    for share in (np.zeros(count), alike):
        for _ in range(ROUNDS):
            now = cold + np.tensordot(share, more, 1)
            found = evidence(term, span, now, target)
            if found.gain > best.gain:
                best, chosen = found, share
            if not np.isfinite(found.gain):
                break
            c = posterior([term], [span], [now], [found], target)[0]
            own = np.column_stack([w @ c for w in more])
            share = scipy.optimize.lsq_linear(own, target - cold @ c, (0.0, 1.0)).x
    return best, list(chosen * most)


def warmed(scene: Scene, warmth: Sequence[float]) -> Scene:
    """The scene with recordings that began so; as it is where nothing is said of that."""
    if not any(warmth):
        return scene
    pairs = zip(scene.trials, warmth, strict=True)
    return replace(scene, trials=tuple(replace(t, warm=float(w)) for t, w in pairs))


def with_warmth(scene: Scene, free: FreeModel) -> Scene:
    """The scene with the warmth that each recording shows under the maps; as it is where none of them
    feels heat, or a simulation leaves all bounds."""
    if not any(feels_heat(p.term) for p in free.parts):
        return scene
    trials = []
    for trial, whitener in zip(scene.trials, scene.whiteners, strict=True):
        most = hottest(trial.u if np.all(np.isfinite(trial.u)) else free.model.simulate(trial).u)
        runs = [free.follow(replace(trial, warm=warm)) for warm in (0.0, most)]
        if any(run is None for run in runs):
            return scene
        cold, hot = (run[0].y for run in runs if run)
        a, e = (trial.weighed(whitener(x)) for x in (hot - cold, trial.y - cold))
        share = float(a @ e) / max(float(a @ a), 1e-300)
        trials.append(replace(trial, warm=most * float(np.clip(share, 0.0, 1.0))))
    return replace(scene, trials=tuple(trials))

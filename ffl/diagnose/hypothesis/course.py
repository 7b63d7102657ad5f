"""The course of a slow force: one that settles, a slow sine, a ramp.

Over the recordings that were fitted they are nearly one; in those that judge, later on the same clock,
they part by times of what the force is. The first order that screens them takes whichever fits best
beside what is there so far, and its held-out error then speaks against any slow force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.earning import SHARE
from ffl.diagnose.contest.judging import Judged, judge, raw_residuals
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import point_of
from ffl.diagnose.screen.screen import Screen
from ffl.effects import EFFECTS, Motion
from ffl.effects.drift import KINDS
from ffl.systems.state_space import Array

NAME = "drift"
SHORTEST, LONGEST = 0.1, 16.0  # of the recordings: what settles more slowly is a ramp in them
SETTLINGS = 30
WORTH = 20.0  # log-likelihood below which no kind of drift is worth a look
PART = 0.3  # of what the best rival brings
HALF = 0.5  # of what a further effect must bring


def courses(
    quiet: Scene, held: Scene | None, base: Judged, rivals: Sequence[Judged]
) -> list[Judged]:
    """The drift among `rivals` that fits best in its other kinds, where it does a good part of what any
    of them does beyond `base`."""
    most = max((r.fitted - base.fitted for r in rivals), default=0.0)
    slow = [r for r in rivals if r.model.names[-1] == NAME]
    best = max(slow, key=lambda r: r.fitted, default=None)
    least = max(WORTH, PART * most)
    if base.model.effects:  # its other kinds do much the same there, and must earn a place like any
        least = max(least, HALF * SHARE * len(base.fit.white))
    if best is None or best.fitted - base.fitted < least:
        return []
    return other_courses(quiet, held, best)


def other_courses(quiet: Scene, held: Scene | None, judged: Judged) -> list[Judged]:
    """`judged`, whose last effect is a drift, with that in each of the other kinds, from what is most
    like it in the fitted recordings."""
    return [judge(quiet, held, m, 6, judged.fit) for m in _alike(quiet, judged)]


def _alike(scene: Scene, judged: Judged) -> list[Model]:
    """The model with each other kind of its last effect, with the time constant and the amplitude that
    do in y what comes nearest to what it does, beside the numbers of all others: the two differ by
    little, so that first order tells."""
    model, effect = judged.model, EFFECTS[NAME]
    last = len(model.effects) - 1
    spec, company = model.effects[last], model.without(last)
    kept = [(c.kind, c.effect) != ("effect", last) for c in model.coordinates]
    others = scene.whiten_stacked(judged.fit.columns[:, kept])
    white = scene.whiten(raw_residuals(scene, model))
    screen = Screen(scene, replace(judged.fit, white=white, jacobian=others))
    clocks, place = [_clock(t.t, t.sample_time) for t in scene.trials], point_of(spec)
    newton = model.simulator.force_per_input

    def in_y(forces: Sequence[Array]) -> Array:
        return screen.beyond(screen.through(place, [f.reshape(-1, 1) / newton for f in forces]))

    wanted = screen.residual + in_y([effect.signal(spec, m) for m in clocks])[:, 0]
    longest = max(len(m.t) * m.sample_time for m in clocks)
    out = []
    for kind in KINDS:
        if kind == spec.options.get("kind", KINDS[0]):
            continue
        found = []
        for tau in longest * np.geomspace(SHORTEST, LONGEST, 1 if kind == "ramp" else SETTLINGS):
            column = in_y([effect.regressors(m, time_constant=tau, kind=kind) for m in clocks])[
                :, 0
            ]
            size, along = float(column @ column), float(column @ wanted)
            if size > 0.0:
                values = {"amplitude": along / size, "time_constant": float(tau)}
                found.append((along**2 / size, values))
        if found:
            values = max(found, key=lambda pair: pair[0])[1]
            other = replace(spec, parameters=values, options={**spec.options, "kind": kind})
            out.append(company.with_effect(other))
    return out


def _clock(t: Array, sample_time: float) -> Motion:
    zero = np.zeros(len(t))
    return Motion(t, zero, zero, zero, zero, zero, sample_time)

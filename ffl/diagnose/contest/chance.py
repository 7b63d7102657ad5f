"""Sines of time that noise may have as well: of all the frequencies looked through one is the loudest."""

from __future__ import annotations

import math

from ffl.diagnose.contest.judging import Judged, judge
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.noise.spread import own_error_of

SINE = "periodic_disturbance"
CHANCE = 0.01  # that the loudest of all frequencies of noise is as many of its errors large


def without_chance(held: Scene | None, judged: Judged) -> Judged:
    """`judged` without the sine that noise may have as well, fitted anew; itself where there is none."""
    if SINE not in judged.model.names or not by_chance(judged):
        return judged
    bare = judged.model.without(judged.model.names.index(SINE))
    return judge(judged.scene, held, bare, 8, judged.fit)


def by_chance(standing: Judged) -> bool:
    """Whether the amplitude of a sine of time is as few standard errors large, by what is left as it is,
    as that of the loudest of n/2 frequencies of noise is by `CHANCE`, t^2 = 2 log(n/2 / CHANCE). (Under
    noise taken for white that has a resonance of 45 Hz: a sine of 44.9 Hz, 102 of log-likelihood and
    3.9 errors of its own, for the 5.4 wanted; real ones had 6.4 to 1,355.)"""
    index = standing.model.names.index(SINE)
    spec = standing.model.effects[index]
    error = own_error_of(standing, index, "amplitude")
    samples = sum(len(trial) for trial in standing.scene.trials)
    least = math.sqrt(2.0 * math.log(0.5 * samples / CHANCE))
    return error is not None and abs(float(spec.parameters["amplitude"])) < least * error

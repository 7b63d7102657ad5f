"""Where a friction that falls with speed begins in a loop that sticks and slips.

There a loop hunts: it hangs, its controller winds up, it breaks loose. Free runs let go at other moments
than the machine did, wherever the numbers are not nearly right, and no step leads from a flat level to a
curve: what hunts was told as a stiff bristle, or as a table by position. So curves of several shapes are
begun with; and, as a simulation that is led to what was measured lets go when the machine did, those of
them that leave least when an observer leads it are fitted so first.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from ffl.diagnose.contest.dry import FALLING, level_of
from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.parallel import each
from ffl.diagnose.contest.scene import Scene, is_far
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.ladders import left_by
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.hypothesis.span import orthonormal
from ffl.diagnose.predict.observer import decay_for, led, with_observer
from ffl.diagnose.recorded.trials import Trial, prepared
from ffl.diagnose.screen.candidate import Candidate
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec

# Shares of the level that stands, at speed; of these, at standstill; of the largest speed.
SLIDES, RESTS = (1.0, 0.92, 0.84, 0.7), (1.15, 1.3, 1.6)
FALLS = (0.0015, 0.005, 0.015, 0.05, 0.15)
BEST, ROUNDS = 6, 12  # of those led, and of their fits


def curves(quiet: Scene, current: Judged, index: int, c: Candidate) -> list[EffectSpec]:
    """Stribeck curves to begin with in the place of the dry friction `index`, where `c` is one and what
    stands is far from what was measured; none elsewhere. (9 N that fall to 6 over 5 mm/s, on 20 kg: from a
    level of 7.4 N the curve ended 33 below a bristle, from the curves 4,026 above it, exact.)"""
    level = level_of(current.model.effects[index])
    if c.spec.name != FALLING or level is None or quiet.observed:
        return []
    if not is_far(quiet.cost(current.model), quiet.samples):
        return []
    top = max(float(np.abs(current.model.simulate(trial).v).max()) for trial in quiet.trials)
    if not top > 0.0:
        return []
    begun = [
        replace(
            c.spec,
            parameters={
                "coulomb_level": slides * level,
                "static_level": rests * slides * level,
                "stribeck_velocity": falls * top,
            },
        )
        for slides, rests, falls in product(SLIDES, RESTS, FALLS)
    ]
    return begun + _fitted(quiet, current.model.without(index), begun)


def _fitted(quiet: Scene, company: Model, begun: list[EffectSpec]) -> list[EffectSpec]:
    """The best of `begun` as an observer that leads the simulation to y has them; none where nothing can
    lead it."""
    ground = _led(quiet, company.base)
    if ground is None:
        return []
    scene, base = ground
    like = fit(scene, replace(company, base=base), rounds=0)
    basis = orthonormal(scene.whiten_stacked(like.columns))
    starts = [like.model.with_effect(spec) for spec in begun]
    left = np.array(each(lambda start: left_by(scene, basis, start), starts))
    best = [starts[k] for k in np.argsort(left, kind="stable")[:BEST] if np.isfinite(left[k])]
    found = each(lambda start: fit(scene, start, rounds=ROUNDS).model, best)
    return [model.effects[-1] for model in found]


def _led(quiet: Scene, base: Base) -> tuple[Scene, Base] | None:
    """The recordings of a loop whose controller is stated as those of one whose is not; None where the
    command is not all known, or the sensor lost some of y."""
    known = all(np.all(np.isfinite(t.u)) and t.lost is None and not t.folded for t in quiet.trials)
    if base.plant.controller is None or not known:
        return None
    recordings = [_recording(trial) for trial in quiet.trials]
    bare = replace(base.plant, controller=None)
    plant = with_observer(bare, decay_for(recordings))
    if plant.controller is None:
        return None
    other = replace(base.like(plant), observed=True)
    trials = prepared(other.simulator, led(recordings), quiet.noise.sensor)
    return replace(quiet, loop=other.loop, trials=trials, observed=True), other


def _recording(trial: Trial) -> Recording:
    return Recording(
        trial.t,
        trial.reference,
        trial.feedforward,
        trial.u,
        trial.y,
        trial.load,
        sample_time=trial.sample_time,
        source=trial.name,
    )

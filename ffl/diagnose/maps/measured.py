"""Maps along the motion as it was measured: where no two free runs agree.

A stage that jumps between two states, or drag that falls with speed on a spring, goes its own way from
the first breath of noise. No free run follows it, whatever map it is given, and what is judged by free
runs has no name and no shape there. The force that leads the model where the machine was (`followed`)
is still a function of the motion: a map that draws it in the fitted recordings, and with the same
numbers in those that judge, says what is missing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.scene import Scene, is_far
from ffl.diagnose.hypothesis.fit import Fit
from ffl.diagnose.maps.form import FreeForm
from ffl.diagnose.maps.freeform import bare
from ffl.diagnose.maps.freemodel import FreeModel, FreeScreen, motions_of
from ffl.diagnose.maps.freerank import as_stated, entries_of, measured_view, ranked
from ffl.diagnose.maps.freestep import traces
from ffl.diagnose.maps.known import where_known
from ffl.diagnose.recorded.warmth import feels_heat
from ffl.diagnose.screen.followed import followed
from ffl.systems.state_space import Array

DRAWN = 0.8  # of the squares that the force does to y: what a map draws, fitted and judged alike
SEEN = 0.05  # of the samples, at least, that must lie where the map is known
NEAR = 0.9  # of the best evidence, from which a map is asked what it draws elsewhere


def measured(scene: Scene, held: Scene | None, found: Fit) -> FreeForm | None:
    """The map that draws the force which leads the linear model where the machine was, of those that do so
    the one of fewest variables; None where free runs of what was `found` come near it by themselves,
    no map draws it better, or something was seen directly."""
    if found.model.proven:
        return None
    none = as_stated(replace(found.model, effects=()))
    current = bare(scene, held, none)
    view = None if current is None else measured_view(current, found)
    if current is None or view is None:
        return None
    # Heat that the recordings began with is nobody's to tell along a motion that is led.
    entries = ranked(view, current, [e for e in entries_of(none) if not feels_heat(e[0])])
    if not entries:
        return None
    told = 1.0 - view.scene.cost(found.model) / view.scene.cost(none)
    near = [e for e in entries if e.evidence.gain >= NEAR * entries[0].evidence.gain]
    judging = None if held is None else held.like(view.scene)
    for entry in sorted(near, key=lambda e: len(e.part.term.variables)):
        free = entry.begun
        white, _, drawn = _left(view, free)
        held_white, known, confirmed = _judged(judging, free)
        if drawn > max(DRAWN, told) and confirmed > DRAWN:
            gain = entry.evidence.gain
            return FreeForm(free, view.scene, gain, white, held_white, known, held=held)
    return None


def _judged(held: Scene | None, free: FreeModel) -> tuple[Array, Array, float]:
    """`_left` in the recordings that judge; all is confirmed where there are none, or they hardly show what
    is missing, and nothing where no force leads the model through them, or hardly any of them goes where
    the fitted ones went."""
    model, nothing = free.model, (np.zeros(0), np.zeros(0, bool))
    if held is None or not held.trials or not is_far(held.cost(model), held.samples):
        return *nothing, 1.0
    along = followed(held, model)
    if along is None:
        return *nothing, 0.0
    return _left(FreeScreen(held, FreeModel(model), along), free)


def _left(view: FreeScreen, free: FreeModel) -> tuple[Array, Array, float]:
    """What the map of `free` leaves of what the force does to the whitened y, (N,), where the map is known,
    (N,), and the share of its squares there that it draws."""
    motions = motions_of(FreeModel(view.model), view.along or view.scene, [free.parts[0].place])
    if motions is None:
        return view.wanted, np.ones(len(view.wanted), bool), 0.0
    left = view.wanted - traces(view, free, motions)[0] @ free.parts[0].coefficients
    known = np.concatenate(
        [where_known(free, m[free.parts[0].place].x, view.scene) for m in motions]
    )
    if known.sum() < SEEN * len(known):
        return left, known, 0.0
    return (
        left,
        known,
        1.0 - float(left[known] @ left[known]) / float(np.sum(view.wanted[known] ** 2)),
    )

"""Where two free runs of one machine part, and an observer tells what no free run does.

A machine on a spring that sticks and slips, or hangs within a play, without a controller: force noise
moves the moment at which it lets go, and from there on two runs of it differ, right in every number. Led
to what was measured by a controller of our own (`observer`), the simulation lets go when the machine did.
For a linear machine both ways are one likelihood,

    y - yhat = S (P d + n)  led,   P d + n  free,   log det S = 0,

and whitening gives the same innovations; with such physics in it the observer's is the sharper. What free
runs leave unexplained is therefore looked at again led by an observer, and told by it where it is clearly
likelier in fitted and held-out recordings alike. The figures of the proof stay those of free runs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.random import Generator

from ffl.diagnose.judging import Judged
from ffl.diagnose.model import Model
from ffl.diagnose.prove import prove, run_plant
from ffl.diagnose.result import Diagnosis
from ffl.diagnose.scene import Runs, Scene
from ffl.diagnose.starts import with_starts

CLEAR = 60.0  # log-likelihood, fitted and held out, by which the observer must know better
OPEN = frozenset({"partly_explained", "inconclusive"})


def parts(found: Diagnosis) -> bool:
    """Whether free runs leave open what an observer may tell: of a machine whose command and noise are
    known, nothing of it seen directly, nor predicted or fed past its drive already."""
    judged = found.judged
    if judged is None or judged.held is None or found.verdict not in OPEN:
        return False
    scene, base = judged.scene, judged.model.base
    seen = judged.model.proven or judged.model.behind is not judged.model
    if base.is_process or scene.plain or seen or judged.predicted:
        return False
    known = all(np.all(np.isfinite(t.u)) for t in (*scene.trials, *judged.held.trials))
    return known and found.plant.machine.states_noise and base.plant.system is found.plant.system


def clearer(found: Diagnosis, again: Diagnosis, rng: Generator) -> Diagnosis:
    """`found` by free runs, or `again`, by an observer, where that is likelier by far."""
    if again.verdict in ("nothing_missing", "inconclusive"):
        return found
    gains = [b - a for a, b in zip(_likelihoods(found), _likelihoods(again), strict=True)]
    if not min(gains) > CLEAR:
        return found
    note = (
        "free runs of this machine part, so what is missing was told by an observer that leads the "
        "simulation to y"
    )
    if again.verdict != "unnamed":
        again, note = _freely(found, again, rng), f"{note}; the held-out figures are of free runs"
    return replace(again, notes=(*again.notes, note))


def _likelihoods(found: Diagnosis) -> tuple[float, ...]:
    """Of fitted and held-out recordings, under what was found, names or maps, by noise of the size that
    suits them best."""
    judged, held = _told(found)
    model: Runs = judged.model
    grounds = judged.scene, held
    maps = found.nameless.winner if found.nameless else None
    if maps is not None and maps.held is not None:
        model, grounds = maps.free, (maps.scene, maps.held)
    out = []
    for ground in grounds:
        ground = replace(ground.like(grounds[0]), worth=1.0)
        residuals = ground.residuals(model)
        out.append(-np.inf if residuals is None else ground.likeliest(ground.whiten(residuals)))
    return tuple(out)


def _told(found: Diagnosis) -> tuple[Judged, Scene]:
    """What stands, and the recordings that judge it."""
    judged = found.judged
    if judged is None or judged.held is None:
        raise ValueError("a diagnosis without a contest has nothing to compare")
    return judged, judged.held


def _freely(found: Diagnosis, again: Diagnosis, rng: Generator) -> Diagnosis:
    """`again` with its proof by free runs."""
    (free, judging), (led, _) = _told(found), _told(again)
    quiet = replace(judging, noise=led.scene.noise)
    model = replace(led.model, base=free.model.base)
    held, nominal = with_starts(quiet, model), Model(free.model.base)
    before = [nominal.simulate(trial) for trial in held.trials]
    after = [run_plant(again.augmented, trial) for trial in held.trials]
    return replace(again, proof=prove(held, before, after, quiet, rng, again.augmented))

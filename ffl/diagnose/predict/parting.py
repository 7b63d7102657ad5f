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

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.proof.prove import Proof, prove, run_plant
from ffl.diagnose.recorded.starts import with_clocks, with_starts
from ffl.diagnose.result import Diagnosis
from ffl.recordings import Recording

CLEAR = 60.0  # log-likelihood, fitted and held out, by which the observer must know better
# The same of fitted recordings where it explains all and free runs hold their names to no other: what is
# wrong fits one wave as well as what is right (a hardening spring and a preload, for a gain by position and
# a spring: 40 behind, and 2,354 of the held-out recording).
AS_WELL = 0.0
# The same of either, where it explains all, beside which free runs that are worse than the model's alone
# say nothing: they part. (Cogging that holds a stage here or there, and a mode: 51,600 and 16,900 ahead,
# while free runs of the machine itself leave 1.3 times what the model alone does.)
FAR_AHEAD = 1000.0
UNSETTLED = frozenset({"partly_explained", "inconclusive"})
ASTRAY = 10.0  # times what noise alone leaves: a map that leaves more has not settled it either
NAMED = frozenset({"explained", "partly_explained"})


def parts(found: Diagnosis) -> bool:
    """Whether free runs leave open what an observer may tell: of a machine without a controller whose
    command and noise are known, nothing of it seen directly."""
    judged = found.judged
    if judged is None or found.plant.controller is not None or not _commanded(found):
        return False
    if found.verdict not in UNSETTLED and not _astray(found):
        return False
    return not judged.model.base.is_process and found.plant.machine.states_noise


def hunts(found: Diagnosis) -> bool:
    """Whether the command may tell what free runs of a loop whose controller is stated did not hold to. (A
    valve that sticks makes its level swing for ever: with all numbers right a free run swings as well, and
    soon out of step. It was refused; along the command as recorded it is 1.5994 % of 1.6.)"""
    unheld = found.verdict == "inconclusive" and found.plant.controller is not None
    return unheld and _commanded(found)


def _commanded(found: Diagnosis) -> bool:
    """Whether what stands was judged by the plant file's own linear part in noise that a filter describes,
    its command known and nothing of it seen directly."""
    judged = found.judged
    if judged is None or judged.held is None or judged.scene.plain or judged.model.proven:
        return False
    known = all(np.all(np.isfinite(t.u)) for t in (*judged.scene.trials, *judged.held.trials))
    return known and judged.model.base.plant.system is found.plant.system


def opened(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings of a loop as those of the plant alone, driven by the command as recorded."""
    return [replace(r, r=np.zeros_like(r.r), f=r.u, missing=r.missing | {"r"}) for r in recordings]


def _astray(found: Diagnosis) -> bool:
    """Maps were named for want of a better one, along the motion as measured or such that free runs of them
    go their own way; or none was, and what is left comes in bursts: one lets go here, another there."""
    proof, nameless = found.proof, found.nameless
    if found.verdict != "unnamed" or proof is None or nameless is None:
        return False
    if proof.nrmse_with_map is None:
        return nameless.led or not proof.nrmse_after < proof.nrmse_before
    return nameless.led or proof.nrmse_with_map > ASTRAY * proof.noise_floor


def clearer(found: Diagnosis, again: Diagnosis, rng: Generator) -> Diagnosis:
    """`found` by free runs, or `again`, by an observer, where its names are likelier by far and free runs
    of them no worse than of the model alone, or these have nothing to say beside it."""
    if again.verdict not in NAMED or again.judged is None or again.judged.predicted:
        return found
    fitted, held = (b - a for a, b in zip(_likelihoods(found), _likelihoods(again), strict=True))
    if not (held > CLEAR and fitted > (AS_WELL if again.verdict == "explained" else CLEAR)):
        return found
    proof = _free_proof(found, again, rng)
    drawn = None if found.proof is None else found.proof.nrmse_with_map
    asked = again.verdict != "explained" or min(fitted, held) < FAR_AHEAD
    if asked and not proof.nrmse_after < (proof.nrmse_before if drawn is None else drawn):
        return found
    way = "by an observer that leads the simulation to y"
    if found.plant.controller is not None:
        way = "along the command as recorded"
    note = (
        f"free runs of this machine part, so what is missing was told {way}; the held-out figures are of "
        "free runs"
    )
    return replace(again, proof=proof, notes=(*again.notes, note))


def _likelihoods(found: Diagnosis) -> tuple[float, ...]:
    """Of fitted and held-out recordings, under what stands, by noise of the size that suits them best."""
    judged, held = _told(found)
    out = []
    for ground in (judged.scene, held.like(judged.scene)):
        ground = replace(ground, worth=1.0)
        residuals = ground.residuals(judged.model)
        out.append(-np.inf if residuals is None else ground.likeliest(ground.whiten(residuals)))
    return tuple(out)


def _told(found: Diagnosis) -> tuple[Judged, Scene]:
    """What stands, and the recordings that judge it."""
    judged = found.judged
    if judged is None or judged.held is None:
        raise ValueError("a diagnosis without a contest has nothing to compare")
    return judged, judged.held


def _free_proof(found: Diagnosis, again: Diagnosis, rng: Generator) -> Proof:
    """The proof of `again` by free runs, from starts and on clocks of its own."""
    (free, judging), (led, _) = _told(found), _told(again)
    quiet = replace(judging, noise=led.scene.noise)
    model, nominal = replace(led.model, base=free.model.base), Model(free.model.base)
    held = with_starts(with_clocks(quiet, model, 0), model)
    before = [nominal.simulate(trial) for trial in held.trials]
    after = [run_plant(again.augmented, trial) for trial in held.trials]
    return prove(held, before, after, quiet, rng, again.augmented)

"""The machine as it went: the model under the force that takes it where it was measured.

A regressor of an effect is a signal along the motion. Along the motion that a wrong model makes it is
wrong as well: a limit that the simulated command never reaches has none, two strong effects hide one
another. Far from what was measured the motion is therefore also taken from the recording itself: a
force beside the command, found by Wiener's two-sided filter, leads the simulation, every point of the
machine with it, to y. It follows noise too, so that what is seen along it starts a fit and decides
nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import Fit
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.wiener import Wiener
from ffl.diagnose.recorded.trials import Trial

OFF = 0.01  # of the travel: a simulation further off is elsewhere than the machine
OTHERWISE = 0.1  # of the power of the command: one that differs by more is another one
STEPS = 4  # times the force is corrected: beside effects the loop answers it as no linear one does
NEAR = (
    0.1  # of the sum of squares: what a force leaves that takes a machine anywhere from elsewhere
)
DONE = 0.5  # of what the last step left: a smaller gain ends it


def strays(scene: Scene, fitted: Fit) -> bool:
    """Whether what was `fitted` is far from what was measured and goes elsewhere by itself; an observer
    leads it back."""
    return not scene.observed and fitted.far and astray(scene, fitted.model)


def astray(scene: Scene, model: Model) -> bool:
    """Whether `model` moves, or commands, otherwise than the machine did."""
    for trial in scene.trials:
        run = model.attempt(trial)
        if run is None:
            return False
        if np.std(trial.y - run.y) > OFF * np.ptp(trial.y):
            return True
        if np.all(np.isfinite(trial.u)):
            power = float(np.sum((trial.u - run.u) ** 2))
            if power > OTHERWISE * float(np.sum(trial.u**2)):
                return True
    return False


def followed(scene: Scene, model: Model) -> Scene | None:
    """`scene` with a load in every recording that takes `model` to its y, None where none does."""
    trials = []
    for trial in scene.trials:
        led = _led(scene, model, trial)
        if led is None:
            return None
        trials.append(led)
    return replace(scene, trials=tuple(trials))


def _led(scene: Scene, model: Model, trial: Trial) -> Trial | None:
    """The trial under the force that leaves least of its y."""
    run = model.attempt(trial)
    if run is None:
        return None
    wiener, left = Wiener(scene, len(trial)), trial.y - run.y
    command = trial.u if np.all(np.isfinite(trial.u)) else trial.feedforward
    size, whole = float(np.mean(command**2)), float(left @ left)
    own = np.zeros(len(trial)) if trial.load is None else trial.load
    best, least, force = replace(trial, load=own), whole, np.zeros(len(trial))
    for _ in range(STEPS):
        force = force + wiener(left, size, slow=None)
        size = float(np.mean(force**2))
        led = replace(trial, load=own + force)
        run = model.attempt(led)
        left = np.full(len(trial), np.inf) if run is None else trial.y - run.y
        if float(left @ left) > DONE * least:
            break
        best, least = led, float(left @ left)
    there = np.sqrt(least / len(trial)) < OFF * np.ptp(trial.y)
    return best if there or least < NEAR * whole else None

"""Where a machine whose output is a speed began: a force that comes again along the way tells it.

The integral of a measured speed begins at 0 with every recording, wherever the rotor stood. A force that
repeats, as cogging does, has one amplitude and one period in all recordings, and a phase of its own in
each, which is where it began. With that known it is one force in all of them, and is named as one.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.optimize

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.noise.least import least_noise
from ffl.diagnose.recorded.trials import Trial
from ffl.diagnose.screen.kinds import AROUND
from ffl.diagnose.screen.scan import periods
from ffl.diagnose.screen.screen import Screen
from ffl.effects import EFFECTS
from ffl.systems.state_space import Array

WORTH = 50.0  # sum of squares that a sine and a cosine must take off every recording, with its own phase
SHARE = 0.05  # of what is left there, the same
UNLIKE = 1.5  # times the smallest amplitude of a recording, that the largest may be
NEAR = 0.5  # of a turn over the whole way: how far the period that was scanned may be off
FORCE = Place("force", "motor")


def with_angles(scene: Scene, held: Scene, model: Model) -> tuple[Scene, Scene, float] | None:
    """The recordings, each with where it began (`Trial.place`; the first one at 0), and the period that
    tells it; None where the output is no speed, or nothing repeats along the way in all of them."""
    everything = [*scene.trials, *held.trials]
    if model.simulator.mechanics.place is None or model.base.is_process or scene.observed:
        return None
    if len(everything) < 2 or any(t.goes_on or t.lost is not None for t in everything):
        return None
    together = replace(scene, trials=tuple(everything), doubt=None)
    found = fit(together, model)
    left = together.residuals(found.model)
    if left is None:
        return None
    quiet = replace(together, noise=least_noise(together, found.model, left))
    view = Screen(quiet, fit(quiet, found.model))
    best = max(
        (_phases(view, entry["period"]) for entry in _tried(view)),
        key=lambda one: float(one[1].sum()),
        default=None,
    )
    if best is None:
        return None
    period, gains, waves = _refined(view, best[0])
    sizes = np.abs(waves)
    pieces = np.split(view.residual, np.cumsum([len(t) for t in everything])[:-1])
    least = [max(WORTH, SHARE * float(piece @ piece)) for piece in pieces]
    if np.any(gains < least) or sizes.max() > UNLIKE * sizes.min():
        return None
    turns = np.angle(waves / waves[0]) / (2.0 * np.pi)
    placed = [replace(t, place=float(k * period)) for t, k in zip(everything, turns, strict=True)]
    n = len(scene.trials)
    fitted, judging = tuple(placed[:n]), tuple(placed[n:])
    return replace(scene, trials=fitted), replace(held, trials=judging), period


def _tried(view: Screen) -> Sequence[dict[str, float]]:
    """Periods worth a closer look: of each recording by itself, since their phases differ."""
    out: list[dict[str, float]] = []
    lengths = np.cumsum([len(t) for t in view.scene.trials])[:-1]
    pieces = np.split(view.residual, lengths)
    for k in range(len(pieces)):
        own = np.concatenate([piece if i == k else 0.0 * piece for i, piece in enumerate(pieces)])
        out += [dict(one) for one in periods(_with(view, own), EFFECTS[AROUND], FORCE)]
    return out


def _refined(view: Screen, period: float) -> tuple[float, Array, Array]:
    """The period about there of which most is explained, as `_phases` tells it."""
    turns = max(m.span for m in view.motions(FORCE)) / period
    near = NEAR / turns
    found = scipy.optimize.minimize_scalar(
        lambda log: -float(_phases(view, period * float(np.exp(log)))[1].sum()),
        bounds=(-near, near), method="bounded", options={"xatol": 1e-3 * near},
    )  # fmt: skip
    return _phases(view, period * float(np.exp(found.x)))


def _way(trial: Trial) -> Array:
    """The way made since the first sample, as measured, in the middle of each: a simulation without the
    force that is sought goes another one, by a share of a turn."""
    step = trial.sample_time
    return step * (np.cumsum(trial.y) - 0.5 * trial.y[0])


def _with(view: Screen, residual: Array) -> Screen:
    other = copy.copy(view)
    other.residual = residual
    return other


def _phases(view: Screen, period: float) -> tuple[float, Array, Array]:
    """(period, what it takes off each recording, amplitude exp(i phase) of each)."""
    effect = EFFECTS[AROUND]
    tables = [
        view.columns_of(effect, replace(m, x=_way(trial)), {"period": period}, FORCE)
        for m, trial in zip(view.motions(FORCE, effect), view.scene.trials, strict=True)
    ]
    columns = view.beyond(view.through(FORCE, tables))
    cuts = np.cumsum([len(t) for t in tables])[:-1]
    gains, waves = [], []
    for x, e in zip(np.split(columns, cuts), np.split(view.residual, cuts), strict=True):
        weights = np.linalg.lstsq(x, e, rcond=None)[0]
        gains.append(float(e @ e - np.sum((e - x @ weights) ** 2)))
        waves.append(complex(weights[0], weights[1]))
    return period, np.array(gains), np.array(waves)

"""Where the machine answers noise louder than a linear loop would.

The filter that whitens a residual knows the linear loop. A machine that sticks is another one while it
does: a motor whose load is held by friction rings on the shaft under noise that hardly moves it when
both run, and a play is shaken through and through. Such stretches are noise, predicted by running the
machine as it is named with noise drawn (`imitate`), and count for as little as they are loud:
    w_t = v_t / sqrt(max(1, p_t)),  p_t the power of v, the whitened answer to noise, around t,
a standard deviation over draws above their mean: a ring holds few independent samples.
On two masses whose load sticks p is 176 at standstill and 0.4 in motion; unweighted, friction tables
and contacts that yield are fitted to the ring.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.ndimage

from ffl.diagnose.contest.earning import borne_out
from ffl.diagnose.contest.judging import QUIET, Judged, mean_square, raw_error, raw_residuals
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.span import orthonormal
from ffl.diagnose.noise.imitate import imitated
from ffl.diagnose.recorded.trials import Trial
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

DRAWS = 8
WINDOW = 64  # samples over which power is averaged
CLEAR = 2.5  # power from which it is more than chance and a filter that is a little wrong
NOISY = 8.0  # times what noise alone brings in the mean: less is what it may bring once
HALF = 0.5  # of the held-out sum of squares: less is left by no chance
LITTLE = 0.01  # of the held-out sum of squares of y itself
PASSES = 2  # noise read from what is left of the calm stretches, and again


def with_unrest(scene: Scene, model: Model) -> Scene:
    """`scene`, recordings that are fitted, with what every sample counts for under `model`; noise is read
    anew from the calm stretches."""
    calm = scene = without_unrest(scene)
    run = _run(calm, model)
    if run is None:
        return calm
    for _ in range(PASSES):
        scene = _weighed(without_unrest(scene), *run)
        scene = scene.with_noise_of(raw_residuals(scene, model), coloured=False, quantile=QUIET)
    return scene


def unrest_of(scene: Scene, model: Model) -> Scene:
    """The same with the noise that `scene` has."""
    calm = without_unrest(scene)
    run = _run(calm, model)
    return calm if run is None else _weighed(calm, *run)


def _run(calm: Scene, model: Model) -> tuple[Plant, tuple[Trial, ...]] | None:
    """The machine that may stick and what it is run on: one with effects whose noise goes round a loop that
    is known; no process sticks."""
    if calm.plain or calm.observed or model.base.is_process:
        return None
    machine, sent = model.judged_on(calm.trials)
    return (machine.plant(), tuple(sent)) if machine.effects else None


def _weighed(calm: Scene, machine: Plant, sent: tuple[Trial, ...]) -> Scene:
    alike = imitated(machine, sent, calm.noise, np.random.default_rng(0), DRAWS)
    if not alike:
        return calm
    power = np.array([calm.whiten(one.y) ** 2 for one in alike])
    cuts = np.cumsum([len(t) for t in calm.trials])[:-1]
    trials = [
        replace(trial, unrest=_loudness(own))
        for trial, own in zip(calm.trials, np.split(power, cuts, axis=1), strict=True)
    ]
    return replace(calm, trials=tuple(trials))


def without_unrest(scene: Scene) -> Scene:
    """Every sample counts for the same."""
    if all(t.unrest is None for t in scene.trials):
        return scene
    return replace(scene, trials=tuple(replace(t, unrest=None) for t in scene.trials))


def _loudness(power: Array) -> Array | None:
    """sqrt(max(1, p)), or None where nothing is loud."""
    around = scipy.ndimage.uniform_filter1d(power, WINDOW, axis=1, mode="nearest")
    smooth = around.mean(axis=0) + around.std(axis=0)
    loud = np.where(smooth > CLEAR, smooth, 1.0)
    return np.sqrt(loud) if np.any(loud > 1.0) and np.all(np.isfinite(loud)) else None


def _seen_through(rival: Judged, base: Judged) -> bool:
    """Whether `rival` leaves next to nothing of what `base` leaves of the held-out y; of a process, which
    integrates whatever comes in, that proves nothing (a constant load took an outflow's place)."""
    if rival.held is None or base.held is None or base.model.base.is_process:
        return False
    return raw_error(rival.held, rival.model) < LITTLE * raw_error(base.held, base.model)


def louder_than_noise(base: Judged, rivals: Sequence[Judged]) -> list[Judged]:
    """Those of `rivals` that bring much more than noise alone does to their numbers in the machine as
    `base` names it: with play, stick or a dead zone it answers noise with slow motions of its own, in
    which a spring or a load finds hundreds of nats. A draw that is louder than all that the rival leaves
    counts for as much less: no noise of this recording was (a saturated loop that goes unstable parts
    from itself by a thousand times that, or by hardly anything). What leaves less than `HALF` of the
    held-out sum of squares, where chance knows nothing of it, needs no such proof; nor what leaves next to
    nothing of y, whatever the noise that the structure in `base` asks for (17 times a motor's own, where
    nobody stated it: friction that left a millionth of the held-out error was no louder); nor what
    held-out recordings bear out (a spring beside a hysteresis that had stood for both brought 1,085 where
    noise as that left it brings 170, and 107 of the 153 it promised on what judges)."""
    scene, model = base.scene, base.model
    machine, sent = model.judged_on(scene.trials)
    alike = imitated(machine.plant(), sent, scene.noise, np.random.default_rng(0))
    out = []
    for rival in rivals:
        last = ("effect", len(model.effects))
        own = np.array([(c.kind, c.effect) == last for c in rival.model.coordinates])
        j = rival.fit.jacobian
        whole, without = orthonormal(j), orthonormal(j[:, ~own])
        drawn = [rival.scene.whiten(one.y) for one in alike]
        left = float(np.sum(rival.fit.white**2))
        shares = [min(1.0, left / max(float(np.sum(e**2)), 1e-300)) for e in drawn]
        brought = [
            0.5 * share * float(np.sum((whole.T @ e) ** 2) - np.sum((without.T @ e) ** 2))
            for e, share in zip(drawn, shares, strict=True)
        ]
        usual = float(np.mean(brought)) if brought else 0.0
        halved = mean_square(rival) < HALF * mean_square(base)
        if (
            halved
            or _seen_through(rival, base)
            or borne_out(rival, base)
            or rival.fitted - base.fitted > NOISY * usual
            or usual < np.sum(own)
        ):
            out.append(rival)
    return out

"""A sensor that is blind to the sign: the linear part is learned anew through it.

A linear model that was identified from |y| is none of the machine: its poles stand for the folds
(coupled drives: a mode at 0.7 Hz for one at 4 Hz). No correction of its numbers leads back, so where a
recording looks folded the linear part is fitted again with |x| for y, from starts all over the band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.optimize
import scipy.signal

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.first_state import in_motion_from
from ffl.diagnose.recorded.signs import NEAR
from ffl.diagnose.recorded.trials import Trial, prepare
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array
from ffl.systems.zpk import Zpk

RECTIFIED = EffectSpec("sensor_nonlinearity", {"kind": "rectified", "level": 0.0})
MOST = 3000  # samples that the search looks at
RESONANCES = 8
ROUNDS = 400
TURNS = 20  # most between the signs of an output and its start
# As a source: identified (`Plant.is_identified`), so that its numbers are corrected at any size.
LEARNED = "ffl identify linear, through a sensor blind to the sign"
FIRST = 0.7  # of a recording: what each start is fitted to


def learned_anew(plant: Plant, recordings: Sequence[Recording]) -> Plant | None:
    """`plant` with a linear part of the same order whose magnitude fits `recordings`: of all converged
    starts, each fitted to the first `FIRST` of every recording, the one that foretells the rest best
    (what fits best may only imitate the folds), fitted to all of them then."""
    order = len(plant.system.poles)
    step = plant.sample_time
    signals = [(r.u[:MOST], r.y[:MOST]) for r in recordings]

    def errors(theta: Array, begin: float, end: float) -> Array:
        """Between these shares of every recording."""
        b, a = _polynomials(theta, order, step)
        with np.errstate(all="ignore"):
            parts = [np.abs(scipy.signal.lfilter(b, a, u)) - y for u, y in signals]
        rows = [p[round(begin * len(p)) : round(end * len(p))] for p in parts]
        return np.nan_to_num(np.concatenate(rows), nan=1e6, posinf=1e6, neginf=-1e6)

    def refined(theta: Array, end: float) -> Array:
        return scipy.optimize.least_squares(
            errors, theta, method="lm", max_nfev=ROUNDS, args=(0.0, end)
        ).x

    starts = _starts(order, step, max(len(u) for u, _ in signals), signals)
    found = [refined(start, FIRST) for start in starts]
    best = min(found, key=lambda theta: np.mean(errors(theta, FIRST, 1.0) ** 2))
    theta = refined(best, 1.0)
    padded, _ = _polynomials(theta, order, step)
    numerator = np.trim_zeros(padded, "f")
    system = Zpk(np.roots(numerator), _poles(theta, order, step), float(numerator[0]), step)
    if np.abs(system.poles).max() >= 1.0:
        return None
    kept = tuple(e for e in plant.effects if e.name != "constant_load")
    return replace(plant, system=system, effects=kept, source=f"{LEARNED}; before: {plant.source}")


def folded_scenes(
    plant: Plant, scene: Scene, recordings: Sequence[Recording], validation: Sequence[Recording]
) -> tuple[Scene, Scene]:
    """Fitted and held-out recordings under the plant learned anew, each from where it began."""
    simulator = Base.of(plant).simulator
    made = [
        tuple(folded_trial(simulator, r, scene.noise.sensor) for r in listed)
        for listed in (recordings, validation)
    ]
    blind = Noise(scene.noise.sensor, 1e-6 * scene.noise.force)
    # Force noise would change its sign with the output: no filter whitens it.
    folded = replace(scene, loop=plant.loop, trials=made[0], noise=blind, plain=True)
    return folded, replace(folded, trials=made[1])


def folded_trial(simulator: Simulator, recording: Recording, noise: float) -> Trial:
    """The trial from rest, its drive off until then, where its clock and its output begin at zero. Cut out
    of a longer recording it may pass zero at speed: then, as elsewhere, from a start that the signs of
    its output tell otherwise."""
    trial = prepare(simulator, recording, noise)
    if trial.start_time > 0.0 or trial.y[0] > NEAR * trial.y.max():
        return _signed(simulator, trial, recording, noise)
    nothing = np.zeros_like
    return replace(trial, start=nothing(trial.start), doubt=nothing(trial.doubt), off=True)


def _signed(simulator: Simulator, trial: Trial, recording: Recording, noise: float) -> Trial:
    """`trial` from the start in motion that foretells |y| best: with the signs of y known a start is least
    squares, and a start tells the signs, in turns, beginning with either sign and with those that the
    command alone makes."""

    driven = simulator.run((), feedforward=trial.u).y
    found = []
    for own in (np.ones(len(trial)), -np.ones(len(trial)), np.where(driven < 0.0, -1.0, 1.0)):
        for _ in range(TURNS):
            start, doubt = in_motion_from(simulator, replace(recording, y=own * trial.y), noise)
            run = simulator.run((), feedforward=trial.u, start=start).y
            found.append((float(np.sum((np.abs(run) - trial.y) ** 2)), start, doubt))
            last, own = own, np.where(run < 0.0, -1.0, 1.0)
            if np.array_equal(own, last):
                break
    _, start, doubt = min(found, key=lambda one: one[0])
    return replace(trial, start=start, doubt=doubt, at_rest=False)


def _poles(theta: Array, order: int, step: float) -> np.ndarray:
    """theta: logarithms of (frequency in rad/s, damping) per pair, of a time constant if odd."""
    poles: list[complex] = []
    for k in range(order // 2):
        w, zeta = np.exp(np.clip(theta[2 * k : 2 * k + 2], -20.0, 20.0))
        poles += list(np.exp(np.roots([1.0, 2.0 * zeta * w * step, (w * step) ** 2])))
    if order % 2:
        poles.append(np.exp(-step / np.exp(np.clip(theta[order - 1], -20.0, 20.0))))
    return np.array(poles, complex)


def _polynomials(theta: Array, order: int, step: float) -> tuple[Array, Array]:
    """Numerator (strictly proper, free) and denominator; the order is the search's, low."""
    return np.append(0.0, theta[order:]), np.real(np.poly(_poles(theta, order, step)))


def _starts(order: int, step: float, samples: int, signals: Sequence[tuple[Array, Array]]):  # type: ignore[no-untyped-def]
    """Resonances all over the band, lags of three lengths; the gain from the sizes of u and y."""
    gain = float(np.mean([np.sqrt(np.mean(y**2) / max(np.mean(u**2), 1e-300)) for u, y in signals]))
    top, low = 0.3 * np.pi / step, 2.0 * np.pi * 2.0 / (samples * step)
    lags = np.geomspace(4 * step, samples * step / 10, 3) if order % 2 else [0.0]
    bands = np.geomspace(low, top, RESONANCES) if order > 1 else [1.0]
    for w in bands:
        for lag in lags:
            theta = []
            for k in range(order // 2):
                theta += [np.log(w * 3.0**k), np.log(0.15)]
            if order % 2:
                theta.append(np.log(lag))
            whole = np.array([*theta, *np.zeros(order)])
            _, a = _polynomials(whole, order, step)
            whole[order:] = gain * a.sum() / order
            yield whole

"""A sensor that stands at its limit: the same value again and again while the drive goes on.

A likelihood gives no credit for that: its noise is the loop's, and a sensor at its limit shows only its
own. A smooth curve that bends at the top fits the rest as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.recorded.trials import Trial
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array

RUN = 8  # samples at the limit in a row
MOVES = 0.01  # of its range: what the linear model must move meanwhile
REMEMBERS = 1.0 - 1e-6  # magnitude of a pole beyond which it integrates
WIDE = 8.0  # standard deviations of the stated sensor noise that count as one value
# A machine that sticks where it turns stands still there too, and so does one seen through a play, but
# they arrive slowly, and at another place every time.
VISITS = 2  # at least, at one value within the sensor's noise; to the last digit one of the three is enough
LASTS = 0.02  # of all samples: together at its limit
SUDDEN = 0.3  # of the RMS speed at arrival, in the median
# Samples of a single stay that would have gone on, before it and after it: a machine comes to rest at a
# stop, or where friction holds it, and leaves it from rest. (Friction on a spring: 21 samples, reached at
# half of the RMS speed, which the step after would have ended.)
ONCE = 20
# Standard deviations of the sensor's noise that all of them scatter by at most: more, and each went its own
# way. (A flow behind a sticking valve, highest for 23 and 29 samples: 1.9, and "clips" with 0.97.)
SCATTER = 1.6
BOTH, BELOW = "clipping", "clipping_below"
# What is largest at each kind of limit.
ENDS: dict[str, Callable[[Array], Array]] = {
    BOTH: np.abs,
    "clipping_above": np.asarray,
    BELOW: np.negative,
}


def clipping(plant: Plant, recordings: Sequence[Recording]) -> EffectSpec | None:
    """The clipping that an open-loop output shows by standing at one largest magnitude, the same in
    all recordings that reach it, or, again and again and for long, at the end that it reaches one way; None
    where none does. (An arm's angle ended at 24 deg, and went to -38.)"""
    if plant.controller is not None:
        return None
    return next(filter(None, (_at_limit(plant, recordings, kind) for kind in ENDS)), None)


def _at_limit(plant: Plant, recordings: Sequence[Recording], kind: str) -> EffectSpec | None:
    """The limit of this kind, if y stands at one."""
    top = max(float(ENDS[kind](r.y).max()) for r in recordings)
    resolution = plant.machine.encoder_resolution
    width = WIDE * plant.machine.sensor_noise + resolution
    noise = float(np.hypot(plant.machine.sensor_noise, 0.5 * resolution))
    for wide in (0.0, width):
        stood, speeds, on = [], [], []
        for r in recordings:
            if np.all(np.isfinite(r.u)):
                seen = ENDS[kind](r.y)
                for values, speed, carried in _visits(seen, _without_limit(plant, r), top - wide):
                    stood.append(values)
                    speeds.append(speed)
                    on.append(carried)
        again, sudden = len(stood) >= VISITS, bool(stood) and np.median(speeds) >= SUDDEN
        once = len(stood) == 1 and len(stood[0]) >= ONCE and sudden and on[0] >= SUDDEN
        lasts = sum(map(len, stood)) >= LASTS * sum(map(len, recordings))
        clips = ((again and sudden) or once) if wide else (again or sudden or lasts)
        if kind != BOTH:  # any machine is at its farthest one way somewhere
            clips = again and sudden and lasts
        if not clips or (wide and float(np.std(np.concatenate(stood))) > SCATTER * noise):
            continue
        level = top if not wide else float(np.mean(np.concatenate(stood)))
        limit = {"kind": kind, "level": -level if kind == BELOW else level}
        return EffectSpec("sensor_nonlinearity", limit)
    return None


def shown(trials: Sequence[Trial], stands: EffectSpec | None, plant: Plant) -> tuple[Trial, ...]:
    """`trials` with what a sensor that clips as `stands` has it could not show: whoever is right about the
    machine need not explain that."""
    if stands is None:
        return tuple(trials)
    width = WIDE * plant.machine.sensor_noise + plant.machine.encoder_resolution
    kind, level = stands.parameters["kind"], float(stands.parameters["level"])
    least = (-level if kind == BELOW else level) - width
    return tuple(replace(trial, lost=ENDS[kind](trial.y) >= least) for trial in trials)


def _without_limit(plant: Plant, r: Recording) -> Array:
    """What the linear model does where the sensor has no limit; where it integrates, and drifts away, what
    drives it. (A stage rings on under a command that stands; a quick one stands where its command does.)"""
    if np.abs(plant.system.poles).max(initial=0.0) > REMEMBERS:
        return r.u
    return plant.system.filter(r.u - r.u[0])


def _visits(size: Array, moved: Array, least: float) -> list[tuple[Array, float, float]]:
    """What was `size` in every stay at `least` or more of RUN samples in which without a limit it would
    have `moved`, the speed of arrival over the RMS one, and the least that it would have gone on with, at
    arrival and, backwards in time, at leaving."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (size >= least).astype(int), [0]])))
    usual = float(np.sqrt(np.mean(np.diff(size) ** 2))) or 1.0
    out = []
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        if b - a >= RUN and np.ptp(moved[a:b]) > MOVES * np.ptp(moved):
            arrival = abs(float(size[a - 1] - size[a - 2])) / usual if a > 1 else 0.0
            carried = min(_carried(size[:a]), _carried(size[b:][::-1])) / usual
            out.append((size[a:b], arrival, carried))
    return out


def _carried(size: Array) -> float:
    """The step that the last three samples of `size` lead to, slowing as they do; 0 of fewer."""
    return float(size[-3] - 3.0 * size[-2] + 2.0 * size[-1]) if len(size) > 2 else 0.0

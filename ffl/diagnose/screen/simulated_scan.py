"""All periods of a cogging by simulation beside stick and slip.

Filtered regressors take the loop as linear. Where friction holds the machine for a part of the time, a
force along the position moves it only while it slides, and shifts the moment at which it stops; a small
cogging simulated with the friction in place shows both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ffl.diagnose.contest.calibrate import Freedom, free_running
from ffl.machines import Simulator
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec, Plant

FEWEST, MOST, STEP = 3.0, 60.0, 0.25  # periods over the positions travelled
SMALL = 0.03  # of the command's RMS: amplitude that is simulated


def cogging_of(
    plant: Plant, recordings: Sequence[Recording], options: Mapping[str, Any]
) -> list[EffectSpec]:
    """Cogging at the peaks of what each period would take off the sum of squares of the free-running
    error beside every number of the calibration, best first; `options` say where it acts. Periods
    from a third to a sixtieth of the positions travelled."""
    y = np.concatenate([r.y for r in recordings])
    u = np.concatenate([r.u for r in recordings])
    span = max(float(np.ptp(y)), 1e-300)
    amount = SMALL * float(np.sqrt(np.mean(u**2))) * Simulator(plant).force_per_input
    freedom = Freedom.of(plant, recordings)
    target = freedom.beyond(freedom.error)
    found: list[tuple[float, EffectSpec]] = []
    for number in np.arange(FEWEST, MOST, STEP):
        waves = [_wave(amount, span / number, phase, options) for phase in (0.0, np.pi / 2)]
        moved = [free_running(_with(plant, w), recordings) - freedom.error for w in waves]
        if not np.all(np.isfinite(moved)):
            found.append((0.0, waves[0]))
            continue
        columns = freedom.beyond(np.column_stack(moved))
        turn, *_ = np.linalg.lstsq(columns, -target, rcond=None)
        gain = float(target @ target - np.sum((target + columns @ turn) ** 2))
        size, phase = amount * float(np.hypot(*turn)), float(np.arctan2(turn[1], turn[0]))
        found.append((gain, _wave(size, span / number, phase, options)))
    gains = np.array([gain for gain, _ in found])
    inner = np.flatnonzero((gains[1:-1] >= gains[:-2]) & (gains[1:-1] > gains[2:])) + 1
    return [found[k][1] for k in inner[np.argsort(-gains[inner])]]


def _wave(amount: float, period: float, phase: float, options: Mapping[str, Any]) -> EffectSpec:
    numbers = {"amplitude": amount, "period": float(period), "phase": phase}
    return EffectSpec("cogging", numbers, dict(options))


def _with(plant: Plant, effect: EffectSpec) -> Plant:
    return replace(plant, effects=(*plant.effects, effect))

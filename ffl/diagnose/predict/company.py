"""Recordings as a machine sees them that lies between effects of its drive and of its scale.

What limits, delays or bends the command does so to the command as recorded; what the scale adds it adds
by the position, which y is but for as much. Taken out of a recording, the rest can be predicted
from sample to sample by a plant without them.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from ffl.diagnose.recorded.trials import Trial
from ffl.effects import EFFECTS, Effect, Motion
from ffl.machines.simulator import Simulator
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array
from ffl.systems.zpk import Zpk

# What an effect of the drive alone depends on.
BY_COMMAND = frozenset({"command", "history", "time"})
# Forces along the motion: where a machine is and how fast it goes, a little noise does not matter.
ALONG = frozenset(
    {"cogging", "hardening_spring", "preloaded_spring", "gravity_torque", "hysteresis",
     "presliding_friction", "quadratic_drag", "drift", "periodic_disturbance"}
)  # fmt: skip
BY_POSITION = frozenset({"encoder_ripple", "position_dependent_gain"})  # sums of their regressors


def separable(spec: EffectSpec) -> bool:
    """Whether `without` can take the effect out of a recording; not a gain by the position of a motor that
    moves otherwise than the sensor."""
    by_position = spec.name in BY_POSITION and spec.options.get("mass_ratio") is None
    return _drives(EFFECTS[spec.name]) or by_position


def along(spec: EffectSpec) -> bool:
    """Whether `forces_along` tells the effect's force from the motion as measured."""
    return spec.name in ALONG


def forces_along(trial: Trial, effects: Sequence[EffectSpec], aside: float = 0.0) -> list[Array]:
    """(N,) the force of each of `effects`, physical units, along the motion as measured, or so far `aside`
    of it, in the middle of every sample."""
    if not effects:
        return []
    motion = _motion(trial).mid_sample
    motion = replace(motion, x=motion.x + aside)
    return [EFFECTS[spec.name].signal(spec, motion) for spec in effects]


def without(trial: Trial, effects: Sequence[EffectSpec]) -> Trial:
    """The trial with the command that reaches the machine, through one effect after the other, and the
    position that the scale saw; what is not separable stays."""
    u, y = trial.u, trial.y
    own = [spec for spec in effects if separable(spec)]
    for driven, group in itertools.groupby(own, lambda spec: _drives(EFFECTS[spec.name])):
        if driven:
            run = _drive(trial.sample_time).run(list(group), feedforward=u, before=trial.before)
            u = u + run.contribution.sum(axis=1)
            continue
        for spec in group:
            effect = EFFECTS[spec.name]
            added = effect.signal(spec, _motion(replace(trial, u=u)))
            u, y = (u + added, y) if effect.port == "command" else (u, y - added)
    return replace(trial, u=u, y=y)


def _drives(effect: Effect) -> bool:
    return effect.port == "command" and set(effect.depends_on) <= BY_COMMAND


@lru_cache(maxsize=4)
def _drive(sample_time: float) -> Simulator:
    """A drive by itself: the mass behind it is of no matter to what the command becomes."""
    mass = Zpk(np.array([-1.0]), np.array([1.0, 1.0]), 1.0, sample_time)
    return Simulator(Plant("drive", mass), open_loop=True)


def _motion(trial: Trial) -> Motion:
    """As measured."""
    v = np.gradient(trial.y, trial.sample_time)
    return Motion(trial.t, trial.reference, trial.u, trial.y, v, 0.0 * v, trial.sample_time)

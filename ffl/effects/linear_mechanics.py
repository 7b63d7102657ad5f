"""The linear mechanics of a plant together with the effects that belong to its linear part."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ffl.effects.base import Effect, Setting
from ffl.effects.mechanics import Mechanics
from ffl.effects.modal import is_speed, mechanics_of
from ffl.errors import InputError
from ffl.systems.plant import EffectSpec, Plant

SAME = 1e-8  # of the largest number of a machine's matrix
IN_SERIES = {"actuator_lag": "time_constant", "input_delay": "delay"}  # what makes a command late


def times_of(effects: Sequence[EffectSpec], name: str) -> list[float]:
    """The positive times of all effects of this name, one of `IN_SERIES`."""
    from ffl.effects import effect_of

    values = [effect_of(e).check(e)[IN_SERIES[name]] for e in effects if e.name == name]
    return [value for value in values if value > 0]


def mechanics_with_effects(plant: Plant) -> Mechanics:
    """Continuous-time mechanics of `plant.system`, changed in turn by every effect that has a
    `modify` (mass, damping, stiffness, a hung mode); the rest of the effects leave it alone."""
    mechanics = mechanics_of(plant.system, is_speed(plant.output_unit))
    for k in _turns(plant.effects):
        mechanics = _with(mechanics, plant, plant.effects[k])
    return mechanics


def in_turn(catalogue: Sequence[Effect], effects: Sequence[EffectSpec]) -> list[int]:
    """Places of `effects`, each of its effect of the `catalogue`, in the order in which they change the
    linear part: whatever order they are in, where a mass changes in all parts (`Effect.turn`)."""
    turns = [effect.turn(spec) for effect, spec in zip(catalogue, effects, strict=True)]
    places = range(len(turns))
    return sorted(places, key=turns.__getitem__) if 1 in turns else list(places)


def _turns(effects: Sequence[EffectSpec]) -> list[int]:
    from ffl.effects import effect_of

    return in_turn([effect_of(spec) for spec in effects], effects)


def as_seen(plant: Plant, count: int) -> Plant:
    """`plant` with the first `count` of its effects told by the numbers that are seen from outside
    (`Effect.seen`), as far as the machine stays the same by them."""
    from ffl.effects import effect_of

    mechanics = mechanics_of(plant.system, is_speed(plant.output_unit))
    told = list(plant.effects)
    for k in _turns(plant.effects[:count]):
        spec = told[k]
        whole = _with(mechanics, plant, spec)
        other = effect_of(spec).seen(spec, whole)
        if other is not spec:
            with suppress(InputError):
                same = _with(mechanics, plant, other)
                if np.allclose(same.a, whole.a, rtol=SAME, atol=SAME * np.abs(whole.a).max()):
                    spec, whole = other, same
        told[k] = spec
        mechanics = whole
    return replace(plant, effects=tuple(told))


def _with(mechanics: Mechanics, plant: Plant, spec: EffectSpec) -> Mechanics:
    from ffl.effects import effect_of

    effect = effect_of(spec)
    setting = Setting(plant.physics.motor_constant or 1.0, mechanics, spec.options)
    return effect.modify(mechanics, effect.check(spec), setting)

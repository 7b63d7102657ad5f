"""The linear mechanics of a plant together with the effects that belong to its linear part."""

from __future__ import annotations

from ffl.effects.base import Setting
from ffl.effects.mechanics import Mechanics
from ffl.effects.modal import is_speed, mechanics_of
from ffl.systems.plant import Plant


def mechanics_with_effects(plant: Plant) -> Mechanics:
    """Continuous-time mechanics of `plant.system`, changed in turn by every effect that has a
    `modify` (mass, damping, stiffness, a hung mode); the rest of the effects leave it alone."""
    from ffl.effects import effect_of

    mechanics = mechanics_of(plant.system, is_speed(plant.output_unit))
    for spec in plant.effects:
        effect = effect_of(spec)
        setting = Setting(plant.physics.motor_constant or 1.0, mechanics, spec.options)
        mechanics = effect.modify(mechanics, effect.check(spec), setting)
    return mechanics

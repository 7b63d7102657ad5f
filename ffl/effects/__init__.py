"""Physics beside the linear plant: the catalogue of effects, each written once."""

from __future__ import annotations

from ffl.effects.actuator_lag import ActuatorLag
from ffl.effects.asymmetric_friction import AsymmetricFriction
from ffl.effects.backlash import Backlash
from ffl.effects.base import Effect, Motion, Parameter, Setting
from ffl.effects.cogging import Cogging
from ffl.effects.constant_load import ConstantLoad
from ffl.effects.coulomb_friction import CoulombFriction
from ffl.effects.dead_zone import DeadZone
from ffl.effects.drift import Drift
from ffl.effects.encoder_ripple import EncoderRipple
from ffl.effects.flexible_mode import FlexibleMode
from ffl.effects.gravity_torque import GravityTorque
from ffl.effects.hardening_spring import HardeningSpring
from ffl.effects.hysteresis import Hysteresis
from ffl.effects.input_delay import InputDelay
from ffl.effects.linear_stiffness import LinearStiffness
from ffl.effects.logarithmic_friction import LogarithmicFriction
from ffl.effects.mass_change import MassChange
from ffl.effects.mechanics import Mechanics
from ffl.effects.modal import is_speed, mechanics_of
from ffl.effects.outflow import Outflow
from ffl.effects.overflow import Overflow
from ffl.effects.periodic_disturbance import PeriodicDisturbance
from ffl.effects.point import Point
from ffl.effects.position_dependent_friction import PositionDependentFriction
from ffl.effects.position_dependent_gain import PositionDependentGain
from ffl.effects.preloaded_spring import PreloadedSpring
from ffl.effects.presliding_friction import PreslidingFriction
from ffl.effects.quadratic_drag import QuadraticDrag
from ffl.effects.saturation import Saturation
from ffl.effects.sensor_bend import SensorBend
from ffl.effects.sensor_lead import SensorLead
from ffl.effects.sensor_nonlinearity import SensorNonlinearity
from ffl.effects.slew_limit import SlewLimit
from ffl.effects.spill import Spill
from ffl.effects.stribeck_friction import StribeckFriction
from ffl.effects.valve_stiction import ValveStiction
from ffl.effects.viscous_friction import ViscousFriction
from ffl.errors import InputError
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.plant_file import suggest

EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        CoulombFriction(),
        AsymmetricFriction(),
        ViscousFriction(),
        StribeckFriction(),
        PreslidingFriction(),
        PositionDependentFriction(),
        LogarithmicFriction(),
        ConstantLoad(),
        Cogging(),
        LinearStiffness(),
        HardeningSpring(),
        PreloadedSpring(),
        GravityTorque(),
        PositionDependentGain(),
        QuadraticDrag(),
        Backlash(),
        Hysteresis(),
        Saturation(),
        DeadZone(),
        SlewLimit(),
        ValveStiction(),
        InputDelay(),
        ActuatorLag(),
        FlexibleMode(),
        MassChange(),
        EncoderRipple(),
        SensorNonlinearity(),
        SensorBend(),
        SensorLead(),
        PeriodicDisturbance(),
        Drift(),
        Outflow(),
        Overflow(),
        Spill(),
    )
}


def effect_of(spec: EffectSpec) -> Effect:
    """The catalogue's entry for `spec`, or `InputError` with a suggestion."""
    if spec.name not in EFFECTS:
        raise InputError(f"unknown effect '{spec.name}'; {suggest(spec.name, list(EFFECTS))}")
    return EFFECTS[spec.name]


def check_effects(plant: Plant) -> None:
    """Raises `InputError`, naming the entry, where an effect of the plant file is not sound."""
    for index, spec in enumerate(plant.effects):
        try:
            effect_of(spec).check(spec)
        except InputError as error:
            raise InputError(f"plant {plant.name}: effects[{index}]: {error}") from None


__all__ = [
    "EFFECTS",
    "Effect",
    "EffectSpec",
    "Mechanics",
    "Motion",
    "Parameter",
    "Point",
    "Setting",
    "check_effects",
    "effect_of",
    "is_speed",
    "mechanics_of",
]

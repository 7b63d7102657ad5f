"""Forms of one dry friction, and where one begins in the place of another."""

from __future__ import annotations

from dataclasses import replace

from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import POINT, placed, point_of
from ffl.diagnose.screen.candidate import Candidate
from ffl.effects.linear_mechanics import IN_SERIES
from ffl.systems.plant import EffectSpec

DRY = frozenset(  # forms of one and the same friction: rivals, never company
    {
        "coulomb_friction",
        "asymmetric_friction",
        "stribeck_friction",
        "presliding_friction",
        "hysteresis",
        "position_dependent_friction",
        "logarithmic_friction",
    }
)

# Of these one that holds nothing at rest, and damps: to first order dry friction beside a damping that is
# off, which is looked for first. Tried in the place of a friction that stands, and only where the linear
# part was identified, its damping bent by the friction: beside a stated damping the slope of dry friction
# passes for it (two of nine development cases with dry friction were named so).
CREEPING = frozenset({"logarithmic_friction"})

# Forms of which a constant load beside them makes one with a level for each direction, and what of them
# is the level at speed.
LEVEL = {
    "coulomb_friction": "level",
    "stribeck_friction": "coulomb_level",
    "presliding_friction": "level",
}

# And of forms that vary, in the mean: what the plainest begins from.
PLAINEST = "coulomb_friction"
MEAN = {"hysteresis": "force", "position_dependent_friction": "level"}

# So many free numbers that they imitate two plain effects at once, or a tank's outflow: tried once
# no plain one earns more, and only where plain dry friction, their mean, has earned its place.
PLIABLE = frozenset({"position_dependent_friction"})

# Who is tried in the place of levels by direction in the end alone: before all the company is there a curve
# that falls with speed takes over what is missing still, and with it goes where no plainer form follows.
# (Stribeck friction of 0.16 and 0.09 N beside a spring and a delay was told as levels of 0.11 and 0.10 N.)
BY_DIRECTION, FALLING = "asymmetric_friction", "stribeck_friction"


def excluded(model: Model) -> set[str]:
    """Effects that cannot be added: those there, and other forms of the dry friction there."""
    names = {spec.name for spec in model.acting}
    return names | (DRY if names & DRY else set())


def as_it_stands(spec: EffectSpec, c: Candidate) -> list[EffectSpec]:
    """Starts of a challenger that take over what stands: the same effect elsewhere its numbers, harmonics
    among them; a form of dry friction its level at speed. (Beside no friction at all a motion is
    another, and so is the level read there: dry friction in the place of a stiff bristle ended 178 below
    it, and 3,900 above from the bristle's own level.)"""
    if c.spec.name == spec.name:
        kept = {k: v for k, v in spec.options.items() if k not in POINT}
        return [replace(spec, options={**kept, **c.place.options})]
    if spec.name in IN_SERIES and c.spec.name in IN_SERIES:  # as late
        late = spec.parameters[IN_SERIES[spec.name]]
        return [replace(c.spec, parameters={IN_SERIES[c.spec.name]: late})]
    level = spec.parameters.get(LEVEL.get(spec.name, ""))
    if c.spec.name == PLAINEST:
        level = level_of(spec)
    if level is None or c.spec.name not in LEVEL:
        return []
    known = {LEVEL[c.spec.name]: level}
    if "static_level" in c.spec.parameters:
        known["static_level"] = level
    return [replace(c.spec, parameters={**c.spec.parameters, **known})]


def level_of(spec: EffectSpec) -> float | None:
    """The level at speed of a form of dry friction, in the mean of both directions; None of others."""
    if spec.name == "asymmetric_friction":
        return 0.5 * sum(float(spec.parameters[f"level_{way}"]) for way in ("positive", "negative"))
    level = spec.parameters.get({**LEVEL, **MEAN}.get(spec.name, ""))
    return None if level is None else float(level)


def plain_form(spec: EffectSpec) -> EffectSpec | None:
    """The plainest form of a dry friction, with its level in the mean, where that acts; None of the
    plainest itself, and of what is no such friction."""
    level = level_of(spec) if spec.name in DRY - {PLAINEST} else None
    if level is None:
        return None
    options = placed(spec)
    return EffectSpec(PLAINEST, {LEVEL[PLAINEST]: level}, options)


def contact_of(spec: EffectSpec) -> EffectSpec | None:
    """The contact that a hysteresis is as stiff as. (1.4 N on 95 N/mm: no screen proposed it.)"""
    force, way = (spec.parameters.get(name, 0.0) for name in ("force", "displacement"))
    if spec.name != "hysteresis" or way <= 0.0:
        return None
    values = {"level": force, "stiffness": force / way, "micro_damping": 0.0}
    return EffectSpec("presliding_friction", values, point_of(spec).options)


def levels_of(friction: EffectSpec, load: EffectSpec) -> EffectSpec | None:
    """Levels by direction that are a dry `friction` beside a constant `load` in one; None where they
    are not: a load above the level pushes even what slides its way."""
    level = friction.parameters.get(LEVEL.get(friction.name, ""))
    if load.name != "constant_load" or level is None:
        return None
    force = load.parameters["force"]
    if abs(force) >= level:
        return None
    levels = {"level_positive": level - force, "level_negative": level + force}
    options = placed(friction)
    return EffectSpec("asymmetric_friction", levels, options)

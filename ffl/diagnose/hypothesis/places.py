"""Where an effect may act on a plant: the distinct points of its mechanics, the stages of a process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffl.diagnose.hypothesis.model import Model
from ffl.effects import EFFECTS, Effect
from ffl.effects.cascade import BETWEEN, OUT, lags
from ffl.effects.mechanics import HUNG
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

# What may act on a load that hangs on a spring which an effect has brought; drag there cost Silverbox 4 %.
BEHIND = frozenset(
    {
        "coulomb_friction",
        "asymmetric_friction",
        "stribeck_friction",
        "presliding_friction",
    }
)
SAME = 1e-6  # of the largest: points nearer than this are one
POINT = ("side", "mass_ratio")  # options that say where a force acts


@dataclass(frozen=True)
class Place:
    """Where an effect acts: port, and for forces the point of the mechanics."""

    port: str
    side: str = "sensor"
    mass_ratio: float | None = None

    @property
    def options(self) -> dict[str, Any]:
        out: dict[str, Any] = {}
        if self.side != "sensor":
            out["side"] = self.side
        if self.mass_ratio is not None:
            out["mass_ratio"] = self.mass_ratio
        return out

    @property
    def words(self) -> str:
        """Where a signal enters, for a reader."""
        if self.port == "force":
            return "a force" if self.side == "sensor" else f"a force at the {self.side}"
        return {"command": "beside the command", "output": "at the sensor"}[self.port]


def mass_is_corrected(model: Model) -> bool:
    """Whether a change of mass is a correction by another name: of an identified model at any size, and
    of a machine that has only one, whose mass is free (it crosses the line at the end if it must)."""
    free = any(c.name == "mass" for c in model.base.corrections) and "mass" not in model.held
    return model.base.plant.is_identified or (free and len(places_of(model)) == 1)


def places_of(model: Model) -> list[Place]:
    """The distinct points at which forces may act on this plant."""
    mechanics = model.simulator.mechanics
    if len(mechanics.modes) < 2:
        return [Place("force")]
    opposite = any(mode.sign < 0 for mode in mechanics.modes)
    several = len(mechanics.modes) > 2
    ratio = (model.mass_ratio or 1.0) if opposite or several else None
    if opposite:
        out = [Place("force", side, ratio) for side in ("motor", "load", "sensor")]
        if several:  # moving equally far in every mode: no one ratio says it
            out.append(Place("force", "motor"))
    else:
        out = [Place("force", "motor"), Place("force", "load")]
        if several:  # measured in step with the drive in every mode, and yet elsewhere
            out += [Place("force", "motor", ratio), Place("force", "sensor", ratio)]
    kept: list[Place] = []
    shapes: list[Array] = []
    for place in out:
        point = mechanics.point(place.side, place.mass_ratio)
        if not point.mobility > 0:
            continue
        shape = np.concatenate([point.force / np.abs(point.force).max(), point.position])
        if all(np.abs(shape - other).max() > SAME for other in shapes):
            kept.append(place)
            shapes.append(shape)
    return kept


def hangs(model: Model) -> bool:
    """Whether an effect hangs a load on a spring at a machine of one body: forces may act there as well."""
    whole = model.base.simulator.mechanics.modes
    return len(whole) == 1 and any(spec.name == HUNG for spec in model.acting)


def behind_a_mode(model: Model, name: str) -> list[Place]:
    """Where the effect `name` may act besides, if it may: the load that a mode hangs there."""
    return [Place("force", "load")] if name in BEHIND and hangs(model) else []


def of_the_machine(model: Model) -> list[Place]:
    """Places where a force may act but that of the sensor, which it is only where there is no other."""
    places = places_of(model)
    return [place for place in places if place.side != "sensor"] or places


def drive_places(model: Model) -> list[Place]:
    """Where the drive may feel the motion that changes its force: where it pushes. With more than two modes
    the ratio by which they share the motor's motion is no number of the plant file, and may be another."""
    out = [Place("command")]
    if len(model.simulator.mechanics.modes) > 2:
        ratios = {p.mass_ratio for p in places_of(model) if p.side == "motor"}
        out += [Place("command", "motor", ratio) for ratio in ratios if ratio is not None]
    return out


def distinct_forces(model: Model, places: Sequence[Place]) -> list[Place]:
    """Those of `places` that differ in what they drive, whatever they feel: without a mass ratio where
    one may be left out."""
    kept: list[Place] = []
    forces: list[Array] = []
    for place in sorted(places, key=lambda p: p.mass_ratio is not None):
        force = model.simulator.mechanics.point(place.side, place.mass_ratio).force
        if all(np.abs(force - f).max() > SAME * np.abs(f).max() for f in forces):
            kept.append(place)
            forces.append(force)
    return kept


def point_of(spec: EffectSpec) -> Place:
    """Where a force acts."""
    side = str(spec.options.get("side", EFFECTS[spec.name].default_side))
    return Place("force", side, spec.options.get("mass_ratio"))


def placed(spec: EffectSpec) -> dict[str, Any]:
    """The options of an effect that say where it acts, as far as it has any: for another in its place."""
    return {k: v for k, v in spec.options.items() if k in POINT}


def points_of(model: Model) -> set[Place]:
    """Where the forces of `model` act, those of its effects."""
    return {point_of(spec) for spec in model.effects if EFFECTS[spec.name].port == "force"}


def flow_places(model: Model, effect: Effect) -> list[Place]:
    """The stages of a plant that is a row of real lags and drives no known mass: either lag may be
    the upper stage, and is for all effects alike. What overflows or empties is a tank for all of them."""
    count = len(lags(model.base.simulator.mechanics))
    if count < effect.stages or not model.base.is_process:
        return []
    if count == 1:
        return [Place("flow", OUT[0])]
    known = {str(e.options.get("side", "")) for e in model.acting if EFFECTS[e.name].port == "flow"}
    upper = {side.removeprefix("after_") for side in known}
    sides = [s for s in effect.sides if not upper or s.removeprefix("after_") in upper]
    if known & set(BETWEEN):  # the upper stage is a tank as well as the lower one
        sides = [s for s in sides if s in BETWEEN] or sides
    return [Place("flow", side) for side in sides]

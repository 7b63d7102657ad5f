"""A free number of a hypothesis: what it belongs to, its bounds, and the steps it is fitted with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ffl.effects import EFFECTS
from ffl.systems.plant import EffectSpec, Plant

if TYPE_CHECKING:
    from ffl.diagnose.hypothesis.model import Base

REACH = {"displacement": 1.6, "period": 0.05, "frequency": 0.3, "exponent": 0.9}  # logarithms
DAMPED = 0.05  # of critical: a change of a contact's damping that matters
PLACE = 0.1  # of the travel: a change of place that matters
LOBE = 0.5  # of a period over the travel: how far a start may be from the period it stands for
# Below one half Bouc and Wen's force gives back more than it took on a closed path (at 0 it forgets the
# path and is a spring that gives way: gravity on a joint passed for it).
PASSIVE = {("hysteresis", "beta"): 0.5}
# Above one it is stiffer on the way back than ever on the way out, which is what hardens, not saturates.
MOST_BACK = 1.0
# Presliding friction and hysteresis are one law at two lengths: a contact that gives way over a
# small part of the travel before it slides, a force that remembers the path over a large one.
CONTACT = 0.025  # of the travel
ROOM = 0.9  # of the mass at a point that may hang on a spring
STEP = 2e-3  # of a coordinate's scale: difference step; stick-slip makes smaller ones noisy
INSIDE = (1.0 + 1e-12, 1.0 - 1e-12)  # bounds that a logarithm, and its exponential, do not cross
LOG_STEP = 4e-3
NEAR = 0.3  # of its logarithm: what a stated number may be off at least
TENTH = 0.1  # of a sample: the contract's line between a delay and a correction of the model
# The same of a linear part that was identified: its zeros came from recordings that the missing physics
# bent, and they hold what a delay within one sample does.
IDENTIFIED = 1.0
TURN = 0.05  # rad: by which a difference step of a period or a frequency may move the last wave


@dataclass(frozen=True)
class Coordinate:
    """One free number: `kind` ('correction', 'given', 'effect', 'option'), where it sits, how it is
    stepped.

    'given' numbers belong to the effects that the plant file itself states. `log` coordinates are
    fitted as logarithms. `place` is the index within a table.
    """

    kind: str
    name: str
    effect: int = -1
    place: tuple[str, int] | None = None
    scale: float = 1.0
    lower: float = -np.inf
    upper: float = np.inf
    log: bool = False
    doubt: float = np.inf  # standard deviation of what is believed of it, about zero
    finest: float = np.inf  # most that a difference step may be

    @property
    def key(self) -> tuple[str, str, int, tuple[str, int] | None]:
        """What it is the number of."""
        return self.kind, self.name, self.effect, self.place

    @property
    def step(self) -> float:
        return min(LOG_STEP if self.log else STEP * self.scale, self.finest)


def slightest(plant: Plant) -> float:
    """Seconds below which a delay, lag or lead is a correction of `plant`."""
    return (IDENTIFIED if plant.is_identified else TENTH) * plant.sample_time


def number_of(  # type: ignore[no-untyped-def]
    base: Base, kind: str, i: int, spec: EffectSpec, parameter, value: float
) -> Coordinate:
    """A parameter of effect `i` of its kind, with its bounds and steps."""
    lower, upper = parameter.lower, parameter.upper
    if not parameter.linear and lower >= 0 and value > 0:
        at = float(np.log(value))
        reach = REACH.get(parameter.name, 3.0)
        if parameter.name == "period":  # half of the lobe that so many periods make
            travel = base.travel or np.inf
            reach = float(np.clip(LOBE * value / travel, reach, 0.3))
            upper = max(min(upper, travel), value)  # what does not come again is no period
        low = max(np.log(lower * INSIDE[0]), at - reach) if lower > 0 else at - reach
        own = (spec.name, parameter.name, spec.options.get("kind", "saturating"))
        upper = MOST_BACK if own == ("hysteresis", "beta", "saturating") else upper
        high = min(np.log(upper * INSIDE[1]), at + reach)
        low = max(low, _shortest(base, spec, parameter.name))
        if spec.name == "saturation":
            low = max(low, float(np.log(max(base.passing[0], lower))))
        least = PASSIVE.get((spec.name, parameter.name), 0.0)
        low = max(low, np.log(least)) if least else low
        high = max(high, low + 0.1)
        if kind == "given":  # as stated, wherever it would be looked for
            low, high = min(low, at - NEAR), max(high, at + NEAR)
        waves = _waves(base, spec, parameter.name, value)
        finest = TURN / (2.0 * np.pi * max(waves, 1e-3))
        return Coordinate(kind, parameter.name, i, None, 1.0, low, high, True, finest=finest)
    alike = [
        abs(float(spec.parameters[p.name]))
        for p in EFFECTS[spec.name].parameters
        if p.unit == parameter.unit and isinstance(spec.parameters.get(p.name), int | float)
    ]
    scale = max(abs(value), 0.3 * max(alike, default=0.0), 1e-12)
    if parameter.unit == "rad":
        scale = 1.0
    if parameter.unit == "x" and lower == -np.inf:  # a place: 0 is one like any other
        scale = max(scale, PLACE * base.travel)
    if parameter.name == "micro_damping":
        moved = base.simulator.mechanics.moving_mass * base.simulator.force_per_input
        critical = 2.0 * float(np.sqrt(spec.parameters["stiffness"] * moved))
        scale = max(scale, DAMPED * critical)
    if parameter.name == "lead" and kind == "effect":  # what comes earlier still is no lead
        upper = INSIDE[1] * slightest(base.plant)
    if parameter.name == "half_width":
        upper = min(upper, base.passing[1])
    if parameter.name == "mass_fraction":
        upper = min(upper, ROOM * _mass_at(base, spec))
        upper = max(upper, value) if kind == "given" else upper
    return Coordinate(kind, parameter.name, i, None, scale, lower, upper)


def _waves(base: Base, spec: EffectSpec, name: str, value: float) -> float:
    """Waves of this period over the travel, or of this frequency until the last sample; 0: no wave."""
    if name == "period":
        return base.travel / value
    over_time = EFFECTS[spec.name].scan == "time" and name == "frequency"
    return base.until * value if over_time else 0.0


def _mass_at(base: Base, spec: EffectSpec) -> float:
    """Mass at the effect's point over the moving mass: more cannot be cut off there."""
    mechanics = base.simulator.mechanics
    side = str(spec.options.get("side", EFFECTS[spec.name].default_side))
    mobility = mechanics.point(side, spec.options.get("mass_ratio")).mobility
    return 1.0 / (mobility * mechanics.moving_mass) if mobility > 0 else 1.0


def _shortest(base: Base, spec: EffectSpec, name: str) -> float:
    """Logarithm of the least value that keeps presliding friction and hysteresis apart. (A loop of 1.98 mm
    learned from moves over 34 was none beside one over 135 that judged.)"""
    length = CONTACT * min(base.learned, base.travel)
    if length > 0 and (spec.name, name) == ("hysteresis", "displacement"):
        return float(np.log(length))
    level = spec.parameters.get("level", 0.0)  # 0: begun where the level at speed had vanished
    if min(length, level) > 0 and (spec.name, name) == ("presliding_friction", "stiffness"):
        return float(np.log(level / (1.4 * length)))
    return -np.inf

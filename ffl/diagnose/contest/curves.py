"""Two effects of speed in the place of two others.

Dry and viscous friction, or dry friction and drag, draw one curve of force over speed together. Another
pair may draw it better where neither half may be exchanged alone: beside a Stribeck curve drag is worth
nothing, beside drag no Stribeck curve is missed. (A fan with 0.38 V of dry friction and drag was told as
Stribeck and viscous friction, 0.97 each, from one recording; its own pair is ahead, with a number less.)
Levels by direction beside drag or a damper may be a Stribeck curve beside a constant load: with levels and
load in one, what falls with speed is left to a negative damping that drag makes up for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.optimize

from ffl.diagnose.contest.dry import BY_DIRECTION, FALLING
from ffl.diagnose.contest.judging import Judged, credible, judge, levelled
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.amounts import claims, effect_values, sizes
from ffl.diagnose.hypothesis.places import placed
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

PLAIN = frozenset({"coulomb_friction", BY_DIRECTION, FALLING})
VISCOUS, DRAG, LOAD = "viscous_friction", "quadratic_drag", "constant_load"
STEEPER = (1.0, 0.4)  # of the velocity over which a curve falls
NEAR = 20.0  # score by which a pair may be behind under the noise of the one that stands
# Of a Stribeck curve to begin with: static over level, its speed in RMS speeds.
RISE, EARLY = 1.3, 0.1


def two_for_two(
    quiet: Scene, held: Scene | None, current: Judged, say: Callable[[str], None]
) -> Judged | None:
    """The best pair that comes within `NEAR` of `current`: drag for viscous friction, or viscous friction
    for drag, beside any plain form of the dry friction; drag for damping of its own beyond the contract's
    line with fewer numbers alone, or beside a Stribeck curve that falls over less; a Stribeck curve and a
    load for levels by direction and one of the two.
    None where none does: under its own noise it may yet be ahead."""
    model = current.model
    dry = next((spec for spec in model.effects if spec.name in PLAIN), None)
    smooth = [spec for spec in model.effects if spec.name in (VISCOUS, DRAG)]
    if dry is None or len(smooth) > 1 or model.proven & {dry.name, *(s.name for s in smooth)}:
        return None
    if not smooth and not claims("damping", sizes(quiet, model).get("damping", 0.0)):
        return None
    own = smooth[0] if smooth else EffectSpec(VISCOUS, effect_values(model, "damping"), dry.options)
    company = model
    for spec in (dry, *smooth):
        company = company.without(company.names.index(spec.name))
    near, bare = [], {k: v for k, v in model.corrections.items() if k != "damping"}
    speed = np.abs(np.concatenate([model.simulate(trial).v for trial in quiet.trials]))
    usual = float(np.sqrt(np.mean(speed**2))) or 1.0
    pairs = [(company, pair) for pair in _pairs(speed, usual, dry, own)]
    if smooth and dry.name == BY_DIRECTION and LOAD not in model.names:
        pairs.append((replace(company, corrections=bare), _with_load(usual, dry)))
    if not smooth and dry.name == FALLING:
        within = replace(company, corrections=bare)
        pairs += [(within, pair) for pair in _steeper(speed, usual, dry, own)]
    for other, pair in pairs:
        for spec in pair:
            other = other.with_effect(spec)
        more = not smooth and len(other.coordinates) >= len(model.coordinates)
        if more and "damping" in other.corrections:
            continue  # one effect more, which must earn its place as others do
        rival = judge(quiet, held, other, 8)
        if not credible(rival):
            continue
        ahead, stands = levelled([rival, current])
        gained = ahead.score - stands.score
        say(f"  {pair[0].name} and {pair[1].name} for {dry.name} and {own.name}: {gained:+.1f}")
        if not more or gained > 0.0:
            near.append((gained, rival))
    best = max(near, key=lambda way: way[0], default=None)
    return best[1] if best is not None and best[0] > -NEAR else None


def _pairs(
    speed: Array, usual: float, dry: EffectSpec, smooth: EffectSpec
) -> list[tuple[EffectSpec, EffectSpec]]:
    """The pairs with the other smooth form, nearest to the same force over each `speed`, at the same
    places; `usual`: the RMS speed."""
    power = {VISCOUS: 1.0, DRAG: 2.0}
    drawn = _dry(dry, speed) + smooth.parameters["coefficient"] * speed ** power[smooth.name]
    other = DRAG if smooth.name == VISCOUS else VISCOUS
    table = np.column_stack([np.ones(len(speed)), (speed / usual) ** power[other]])
    level, most = scipy.optimize.nnls(table, drawn)[0]
    places = placed(smooth)
    beside = EffectSpec(other, {"coefficient": most / usual ** power[other]}, places)
    forms = {
        "coulomb_friction": {"level": level},
        BY_DIRECTION: {"level_positive": level, "level_negative": level},
        FALLING: _falling(level, usual),
    }
    options = placed(dry)
    return [(EffectSpec(form, values, options), beside) for form, values in forms.items()]


def _steeper(
    speed: Array, usual: float, dry: EffectSpec, smooth: EffectSpec
) -> list[tuple[EffectSpec, EffectSpec]]:
    """Stribeck curves that fall over less, each beside drag, nearest to the same force over each `speed`.
    (A curve that a damper pulls down falls too slowly and too far; no step on the way to drag helps.)"""
    values, out = dry.parameters, []
    drawn = _dry(dry, speed) + smooth.parameters["coefficient"] * speed
    options = placed(dry)
    for share in STEEPER:
        velocity = share * values["stribeck_velocity"]
        falling = np.exp(-((speed / velocity) ** 2))
        table = np.column_stack([np.ones(len(speed)), falling, (speed / usual) ** 2])
        level, rise, most = scipy.optimize.nnls(table, drawn)[0]
        curve = {
            "coulomb_level": level,
            "static_level": level + rise,
            "stribeck_velocity": velocity,
        }
        drag = EffectSpec(DRAG, {"coefficient": most / usual**2}, options)
        out.append((EffectSpec(FALLING, curve, options), drag))
    return out


def _with_load(usual: float, dry: EffectSpec) -> tuple[EffectSpec, EffectSpec]:
    """A Stribeck curve that ends at the mean of the levels by direction, and a load of half of what they
    differ by, at the same place; `usual`: the RMS speed."""
    options = placed(dry)
    ways = dry.parameters["level_positive"], dry.parameters["level_negative"]
    curve = _falling(0.5 * sum(ways), usual)
    load = EffectSpec(LOAD, {"force": 0.5 * (ways[1] - ways[0])}, options)
    return EffectSpec(FALLING, curve, options), load


def _falling(level: float, usual: float) -> dict[str, float]:
    """A Stribeck curve to begin with, that falls to `level`; `usual`: the RMS speed."""
    return {
        "coulomb_level": level,
        "static_level": RISE * level,
        "stribeck_velocity": EARLY * usual,
    }


def _dry(spec: EffectSpec, speed: Array) -> Array:
    """Level of a plain form at each `speed`, the mean of both directions."""
    values = spec.parameters
    if spec.name == BY_DIRECTION:
        return np.full(len(speed), 0.5 * (values["level_positive"] + values["level_negative"]))
    if spec.name == "coulomb_friction":
        return np.full(len(speed), values["level"])
    rise = values["static_level"] - values["coulomb_level"]
    return values["coulomb_level"] + rise * np.exp(-((speed / values["stribeck_velocity"]) ** 2))

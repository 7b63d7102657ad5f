"""What an effect has no share in: levels by direction, a gain taken for 1, a mass that nobody feels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ffl.diagnose.contest.judging import Judged, is_another, judge
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import LOAD, TABLE, Model
from ffl.diagnose.recorded.trials import Trial
from ffl.systems.plant import EffectSpec

GAIN = "position_dependent_gain"
SLIGHT = 0.08  # of the mass: what a gain by position may hold of it
AS_STATED = 0.005  # of the mass: nearer to it a careful engineer's model is not
TIE = 4.0  # score that a simpler name may cost
KEPT = 20.0  # score that the stated mass may


def about_a_centre(held: Scene | None, judged: Judged) -> Judged:
    """Friction that differs by direction beside a spring with a centre is even friction about another
    centre: half the difference is a constant force, and so is a move of the centre."""
    model = judged.model
    if not {"asymmetric_friction", "linear_stiffness"} <= set(model.names):
        return judged
    at, spring = (model.names.index(n) for n in ("asymmetric_friction", "linear_stiffness"))
    dry, values = model.effects[at], dict(model.effects[spring].parameters)
    up, down = (float(dry.parameters[f"level_{way}"]) for way in ("positive", "negative"))
    values["centre"] -= 0.5 * (up - down) / values["stiffness"]
    even = EffectSpec("coulomb_friction", {"level": 0.5 * (up + down)}, dry.options)
    effects = tuple(even if k == at else e for k, e in enumerate(model.effects))
    plainer = replace(model, effects=effects).with_parameters(spring, values)
    tried = judge(judged.scene, held, plainer, 8)
    judged = judge(judged.scene, held, model, 4, judged.fit)  # by the same noise
    return tried if tried.score > judged.score - TIE else judged


def beside_a_load(held: Scene | None, judged: Judged) -> Judged:
    """A table whose levels by direction differ is a table and a constant load, and no recording tells one
    from the other: beside a load that stands the levels are the same both ways in the mean, and it has a
    size of its own. (Levels of 2.4 and 8.2 mV, at their end of 0 in places, beside a load of 2.9 mV: 5.3 mV
    and a load of 5.6.)"""
    model = judged.model
    if not {TABLE, LOAD} <= set(model.names) or LOAD in model.held:
        return judged
    even = replace(_even(model), held=model.held | {LOAD})
    tried = judge(judged.scene, held, even, 8)
    tried = judge(tried.scene, held, _even(tried.model), 0)  # the same motion
    judged = judge(judged.scene, held, model, 4, judged.fit)  # by the same noise
    return tried if tried.score > judged.score - TIE else judged


def balanced(table: Mapping[str, Sequence[float]]) -> tuple[dict[str, Any], float]:
    """(`table` with the same mean level both ways, half of what its means differed by, which is a constant
    force): levels are magnitudes, and end at 0."""
    up, down = (np.asarray(table[key], float) for key in ("positive", "negative"))
    half = 0.5 * float(np.mean(down) - np.mean(up))
    sides = (np.maximum(up + half, 0.0).tolist(), np.maximum(down - half, 0.0).tolist())
    return {**table, **dict(zip(("positive", "negative"), sides, strict=True))}, half


def _even(model: Model) -> Model:
    index, load = model.names.index(TABLE), model.names.index(LOAD)
    values = model.effects[index].parameters
    table, more = balanced(values["table"])
    force = float(model.effects[load].parameters["force"]) + more
    return model.with_parameters(index, {**values, "table": table}).with_parameters(
        load, {"force": force}
    )


def recentred(held: Scene | None, judged: Judged) -> Judged:
    """`judged` with its gain by position told from another place, where the mass is as stated."""
    other = of_no_mass(judged.model, judged.scene.trials)
    if other is None:
        return judged
    tried = judge(judged.scene, held, other, 8)
    judged = judge(judged.scene, held, judged.model, 4, judged.fit)  # by the same noise
    return tried if tried.score > judged.score - TIE else judged


def of_no_mass(model: Model, trials: Sequence[Trial]) -> Model | None:
    """A gain by position is told from where it is taken for 1, and what it is there goes into mass, damping
    and all forces alike: a mass other than stated that it reaches somewhere in the travel is none of the
    machine's. (2.8 % more mass beside a gain about 67 mm: none about 91. Of 1.8 %, within the line, a load
    of 1.411 N was 1.436 +- 0.002.) The `model` about that place; None where there is none."""
    mass = model.corrections.get("mass", 0.0)
    if GAIN not in model.names or not AS_STATED < abs(mass) < SLIGHT:
        return None
    index = model.names.index(GAIN)
    values = dict(model.effects[index].parameters)
    slope, bend = float(values["linear_coefficient"]), float(values["quadratic_coefficient"])
    y = np.concatenate([trial.y for trial in trials])
    roots = np.roots([bend, slope, -mass])
    away = [
        float(z.real) for z in roots if not z.imag and y.min() < values["centre"] + z.real < y.max()
    ]
    if not away:
        return None
    step = min(away, key=abs)
    moved = {
        "centre": float(values["centre"]) + step,
        "linear_coefficient": (slope + 2.0 * bend * step) / (1.0 + mass),
        "quadratic_coefficient": bend / (1.0 + mass),
    }
    corrections = {k: v for k, v in model.corrections.items() if k != "mass"}
    return replace(model, corrections=corrections).with_parameters(index, {**values, **moved})


def of_its_mass(held: Scene | None, judged: Judged) -> Judged:
    """`judged`, or with the stated mass, held, where a fraction of it was fitted and is worth little: a
    stage that its spring drives hardly feels its mass. (Hysteresis in noise was no rival of a presliding
    friction, 147 nats ahead of it, for 92 % less mass.)"""
    if not (judged.model.effects and is_another(judged.model)):
        return judged
    kept = {k: v for k, v in judged.model.corrections.items() if k != "mass"}
    stated = replace(judged.model, corrections=kept, held=judged.model.held | {"mass"})
    tried = judge(judged.scene, held, stated, 12)
    return tried if tried.score > judged.score - KEPT else judged

"""Dry friction that is the same both ways: what its levels differ by is said by something else."""

from __future__ import annotations

from dataclasses import replace

from ffl.diagnose.contest.judging import Judged, judge
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import EVEN, TABLE, balanced
from ffl.systems.plant import EffectSpec

LOAD = "constant_load"
TIE = 4.0  # score that a simpler name may cost


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
    if not {TABLE, LOAD} <= set(model.names) or EVEN in model.held:
        return judged
    index, load = model.names.index(TABLE), model.names.index(LOAD)
    spec = model.effects[index]
    table, more = balanced(spec.parameters["table"])
    even = replace(model, held=model.held | {EVEN})
    even = even.with_parameters(index, {**spec.parameters, "table": table})
    force = float(even.effects[load].parameters["force"])
    even = even.with_parameters(load, {"force": force + more})
    tried = judge(judged.scene, held, even, 12)
    judged = judge(judged.scene, held, model, 4, judged.fit)  # by the same noise
    return tried if tried.score > judged.score - TIE else judged

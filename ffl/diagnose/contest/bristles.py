"""A hysteresis that is a bristle: Bouc-Wen's law with both of its shapes at 1 is LuGre's contact."""

from __future__ import annotations

from dataclasses import replace

from ffl.diagnose.contest.evenly import TIE
from ffl.diagnose.contest.judging import Judged, judge, levelled
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.places import placed
from ffl.diagnose.noise.spread import error_of
from ffl.effects.hysteresis import KINDS
from ffl.systems.plant import EffectSpec

LOOP, CONTACT, BRISTLE = "hysteresis", "presliding_friction", "lugre"
SHAPES = ("exponent", "beta")
ROUND = 0.05  # of 1: how near both are, and how well told, by as much of a standard error


def as_bristle(held: Scene | None, judged: Judged, outcome: Outcome) -> tuple[Judged, Outcome]:
    """(`judged`, or the same with presliding friction of one bristle in the place of its hysteresis;
    `outcome` with it among the contenders). dz/dt = v/d (1 - |z|^n (beta sign(v z) + 1 - beta)) is the
    bristle's law at n = beta = 1, and friction is the plainer name. (A disk's pivot, LuGre of 3 mA over
    40 um without micro damping: n = 0.9997, beta = 1.000, told as hysteresis at 0.97.)"""
    model = judged.model
    index = next((k for k, e in enumerate(model.effects) if e.name == LOOP), None)
    if index is None or judged.predicted or not _is_one(judged, index):
        return judged, outcome
    loop = model.effects[index]
    force, way = (float(loop.parameters[name]) for name in ("force", "displacement"))
    options = placed(loop) | {"kind": BRISTLE}
    values = {"level": force, "stiffness": force / way, "micro_damping": 0.0}
    bristle = EffectSpec(CONTACT, values, options)
    effects = tuple(bristle if k == index else e for k, e in enumerate(model.effects))
    again = judge(judged.scene, held, model, 4, judged.fit)  # by the same noise
    tried, again = levelled([judge(judged.scene, held, replace(model, effects=effects), 8), again])
    if not tried.score > again.score - TIE:
        return judged, outcome
    others = [pair for pair in outcome.contenders.get(LOOP, ()) if pair[0] not in (LOOP, CONTACT)]
    pairs = [(CONTACT, tried), *others]  # the loop is the same law, with two numbers more
    return tried, replace(outcome, contenders={**outcome.contenders, CONTACT: pairs})


def _is_one(judged: Judged, index: int) -> bool:
    spec = judged.model.effects[index]
    if spec.options.get("kind", KINDS[0]) != KINDS[0]:
        return False
    pairs = [(float(spec.parameters[n]), error_of(judged, index, n)) for n in SHAPES]
    return all(abs(x - 1.0) < ROUND and (e or 0.0) < ROUND for x, e in pairs)

"""Starts where first orders have nothing to propose."""

from __future__ import annotations

from dataclasses import replace

from ffl.diagnose.fit import fit
from ffl.diagnose.judging import judge
from ffl.diagnose.ladders import overlooked
from ffl.systems.plant import EffectSpec


def test_a_limit_that_the_simulation_never_reaches_is_tried(stage, record, scenes):
    machine = replace(stage, effects=(EffectSpec("saturation", {"limit": 0.8}),))
    scene, held, model = scenes(record(machine))
    base, like = judge(scene, held, model, 0), fit(scene, model, rounds=0)
    (found,) = overlooked(scene, base, like, [], [])
    assert 0.6 < found.spec.parameters["limit"] < 1.05
    assert overlooked(scene, base, like, [], [], taken={"saturation"}) == []


def test_nothing_is_overlooked_where_the_simulation_is_near(stage, record, scenes):
    scene, held, model = scenes(record(stage))
    base = judge(scene, held, model)
    assert overlooked(scene, base, base.fit, [], []) == []

"""Starts where first orders have nothing to propose."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

from ffl.diagnose.fit import fit
from ffl.diagnose.judging import judge
from ffl.diagnose.ladders import overlooked
from ffl.systems.plant import EffectSpec


def test_a_limit_that_the_simulation_never_reaches_is_tried(stage, record, scenes):
    machine = replace(stage, effects=(EffectSpec("saturation", {"limit": 1.3}),))
    scene, _, model = scenes(record(machine))
    like = fit(scene, model, rounds=0)
    base = SimpleNamespace(fit=like)
    (found,) = overlooked(scene, base, like, [], [])
    assert 1.1 < found.spec.parameters["limit"] < 1.5
    assert overlooked(scene, base, like, [], [], taken={"saturation"}) == []


def test_nothing_is_overlooked_where_the_simulation_is_near(stage, record, scenes):
    scene, held, model = scenes(record(stage))
    base = judge(scene, held, model)
    assert overlooked(scene, base, base.fit, [], []) == []

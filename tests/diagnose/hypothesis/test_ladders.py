"""Starts where first orders have nothing to propose."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest

from ffl.diagnose.contest.judging import judge
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.ladders import overlooked, with_best_start
from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.screen.candidate import Candidate
from ffl.diagnose.screen.screen import Screen, _deepest
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


LIGHT = {"frequency": 33.0, "damping": 0.01, "mass_fraction": 0.04}


def test_a_light_mode_begins_in_its_own_valley(stage, record, scenes):
    """First order in its mass sees a slow mode of half the machine before it, where the damping stands
    in for what rings."""
    machine = replace(stage, effects=(EffectSpec("flexible_mode", LIGHT),))
    scene, _, model = scenes(record(machine))
    like = fit(scene, model)
    (seen,) = Screen(scene, like).candidates(["flexible_mode"])
    begun = with_best_start(scene, seen).effects[-1].parameters
    assert begun["frequency"] == pytest.approx(LIGHT["frequency"], rel=0.1)
    astray = replace(seen, spec=replace(seen.spec, parameters=LIGHT | {"frequency": 300.0}))
    there = replace(astray, valleys=(EffectSpec("flexible_mode", LIGHT, seen.spec.options),))
    begun = with_best_start(scene, there).effects[-1].parameters
    assert begun["frequency"] == LIGHT["frequency"]


def test_every_peak_of_the_gain_is_a_valley_of_the_cost():
    gains = {10.0: 1.0, 20.0: 50.0, 30.0: 2.0, 40.0: 90.0, 50.0: 3.0, 60.0: 40.0}
    tops = {
        f: Candidate(EffectSpec("flexible_mode", {"frequency": f}), gain, 1, Place("force"), None)
        for f, gain in gains.items()
    }
    best = _deepest(tops)
    assert best.spec.parameters["frequency"] == 40.0
    assert [spec.parameters["frequency"] for spec in best.valleys] == [20.0, 60.0]

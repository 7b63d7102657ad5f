"""Effects that hide one another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.dry import DRY
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.together import sets, starts, together
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.screen.candidate import with_coefficients
from ffl.diagnose.screen.screen import Screen
from ffl.systems.plant import EffectSpec

FRICTION = EffectSpec("coulomb_friction", {"level": 6.0})
DRIFT = EffectSpec("drift", {"time_constant": 1.2, "amplitude": 9.0})


def views(scene, model):
    screen = Screen(scene, fit(scene, model, rounds=0))
    seen = [c for c in screen.candidates() if c.spec.name != "position_dependent_friction"]
    return screen, seen


def test_first_orders_find_the_pair(stage, record, scenes):
    scene, _, model = scenes(record(replace(stage, effects=(FRICTION, DRIFT))))
    screen, seen = views(scene, model)
    pair = sets(screen, seen)[0]
    assert {"drift"} < {spec.name for spec in pair.specs}
    (friction,) = {spec.name for spec in pair.specs} - {"drift"}
    assert friction in DRY
    assert pair.like is screen.fit
    assert pair.left < 0.2 * float(screen.residual @ screen.residual)


def test_one_effect_makes_no_pair(stage, record, scenes):
    scene, _, model = scenes(record(replace(stage, effects=(FRICTION,))))
    screen, seen = views(scene, model)
    assert not [p for p in sets(screen, seen) if {s.name for s in p.specs} <= DRY]


def test_both_come_in_at_once(stage, record, scenes):
    machine = replace(stage, effects=(FRICTION, DRIFT))
    scene, held, model = scenes(record(machine))
    base = judge(scene, held, model)
    said: list[str] = []
    screen, seen = views(scene, model)
    found = together(scene, held, base, starts(base, [(screen, seen)], 2), 20.0, said.append)
    assert found is not None
    assert "drift" in found.model.names
    assert len(found.model.effects) == 2
    assert said


def test_near_what_was_measured_one_comes_after_the_other(stage, record, scenes):
    scene, held, model = scenes(record(stage))
    base = judge(scene, held, model)
    assert starts(base, [views(scene, model)], 2) == []


def test_a_candidate_keeps_what_its_columns_are(stage, record, scenes):
    scene, _, model = scenes(record(replace(stage, effects=(FRICTION,))))
    screen, seen = views(scene, model)
    best = next(c for c in seen if c.spec.name == "coulomb_friction")
    table = screen.table_of(best)
    gain, coefficients = screen.gain(table, positive=True)
    assert np.isclose(gain, best.gain)
    assert with_coefficients(best, coefficients).parameters == best.spec.parameters

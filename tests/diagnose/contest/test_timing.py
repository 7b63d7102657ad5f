"""A delay and a mode are found from the delay where a lag and a mode stand in their place."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffl.diagnose.contest import timing
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.timing import begun_late, late_otherwise
from ffl.systems.plant import EffectSpec

DELAY = EffectSpec("input_delay", {"delay": 0.0021})
MODE = EffectSpec("flexible_mode", {"frequency": 110.0, "damping": 0.02, "mass_fraction": 0.2})
LAG = EffectSpec("actuator_lag", {"time_constant": 0.002})
FRICTION = EffectSpec("coulomb_friction", {"level": 2.0})
OTHER = replace(MODE, parameters={**MODE.parameters, "frequency": 45.0, "damping": 0.3})


def quiet(line):
    pass


@pytest.fixture(scope="module")
def late(stage, record, scenes):
    return scenes(record(replace(stage, effects=(DELAY, MODE)), 0))


def test_a_delay_is_told_where_a_lag_and_another_mode_stand(late):
    scene, held, model = late
    standing = judge(scene, held, replace(model, effects=(LAG, OTHER)), 6)
    said = []
    found = begun_late(scene, held, standing, said.append)
    assert found.model.names == ("input_delay", "flexible_mode")
    assert found.model.effects[0].parameters["delay"] == pytest.approx(0.0021, rel=0.02)
    assert found.model.effects[1].parameters["frequency"] == pytest.approx(110.0, rel=0.1)
    assert found.score > standing.score + 100.0
    assert any(
        "input_delay, then flexible_mode, for actuator_lag and flexible_mode" in x for x in said
    )


def test_a_mode_is_begun_where_first_order_sees_none(late, monkeypatch):
    scene, held, model = late
    standing = judge(scene, held, replace(model, effects=(LAG, OTHER)), 6)
    monkeypatch.setattr(timing.Screen, "candidates", lambda *_: [])
    found = begun_late(scene, held, standing, quiet)
    assert found.model.names == ("input_delay", "flexible_mode")
    true = judge(scene, held, replace(model, effects=(DELAY, MODE)), 6)
    assert found.score > standing.score + 100.0
    assert found.score > true.score - 3.0


def test_what_stands_is_found_again_and_no_more(late):
    scene, held, model = late
    standing = judge(scene, held, replace(model, effects=(DELAY, MODE)), 6)
    found = begun_late(scene, held, standing, quiet)
    assert found is None or found.score < standing.score + 3.0


@pytest.mark.parametrize("effects", [(DELAY,), (MODE,), (FRICTION, DELAY)])
def test_one_of_them_alone_is_no_pair(late, effects):
    scene, held, model = late
    standing = judge(scene, held, replace(model, effects=effects), 2)
    assert begun_late(scene, held, standing, quiet) is None


def test_a_lag_is_held_against_a_delay_once_a_mass_stands_beside_it(stage, record, scenes):
    heavy = EffectSpec("mass_change", {"change": 0.08})
    scene, held, model = scenes(record(replace(stage, effects=(DELAY, heavy)), 0))
    beside = replace(model, effects=(LAG, heavy), held=frozenset({"mass"}))
    standing = judge(scene, held, beside, 6)
    outcome = Outcome(standing, [], held, {})
    found, after = late_otherwise(held, standing, outcome, ("actuator_lag",))
    assert found.model.names == ("input_delay", "mass_change")
    assert found.model.effects[0].parameters["delay"] == pytest.approx(0.0021, rel=0.05)
    assert [name for name, _ in after.contenders["input_delay"]] == ["input_delay", "actuator_lag"]
    assert late_otherwise(held, standing, outcome, standing.model.names) == (standing, outcome)

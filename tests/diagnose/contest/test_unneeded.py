"""Who is within its errors of nothing, and missed by nobody, goes in the end."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffl.diagnose.contest import unneeded
from ffl.diagnose.contest.earning import stays
from ffl.diagnose.contest.judging import PER_NUMBER, judge, levelled
from ffl.diagnose.contest.line import crosses
from ffl.diagnose.contest.unneeded import sureness, without_unneeded
from ffl.systems.plant import EffectSpec

FRICTION = EffectSpec("coulomb_friction", {"level": 2.0})
LOAD = EffectSpec("constant_load", {"force": 0.5})
NOTHING = EffectSpec("quadratic_drag", {"coefficient": 1e-3})


@pytest.fixture(scope="module")
def seen(stage, scenes, record):
    """(scene, held, model) of a stage with friction and a constant force."""
    return scenes(record(replace(stage, effects=(FRICTION, LOAD))))


def test_who_is_not_needed_goes_and_nobody_else(seen):
    scene, held, model = seen
    found = judge(scene, held, replace(model, effects=(NOTHING, FRICTION, LOAD)), 10)
    assert sureness(found, 0) < unneeded.ASKED < sureness(found, 1)
    left = without_unneeded(held, found)
    assert left.model.names == (FRICTION.name, LOAD.name)
    assert left.score >= found.score
    assert without_unneeded(held, left) is left


def test_luck_on_what_judges_keeps_nobody(seen):
    """Who brings less on the fitted recordings than its numbers cost would not come in, whatever the others
    seem to gain."""
    scene, held, model = seen
    found = judge(scene, held, replace(model, effects=(NOTHING, FRICTION, LOAD)), 10)
    lucky = replace(found, held_white=0.97 * found.held_white)
    bare = judge(scene, held, replace(model, effects=(FRICTION, LOAD)), 10)
    whole, left = levelled([lucky, bare])
    assert whole.score > left.score
    assert without_unneeded(held, lucky).model.names == (FRICTION.name, LOAD.name)


@pytest.mark.parametrize(("fitted", "who_stays"), [(6.0, True), (2.0, False)])
def test_who_is_told_a_little_by_both_stays(seen, fitted, who_stays):
    """Half of what coming in asks is enough to stay, not less: 8 nats of both are asked of who comes."""
    scene, held, model = seen
    found = judge(scene, held, replace(model, effects=(NOTHING, FRICTION, LOAD)), 10)
    bare = judge(scene, held, replace(model, effects=(FRICTION, LOAD)), 10)
    charged = PER_NUMBER * (found.freedom - bare.freedom)
    told = replace(found, fitted=bare.fitted + charged + fitted, held_white=0.97 * found.held_white)
    assert not stays(told, bare, 0.0)
    assert (without_unneeded(held, told) is told) == who_stays


def test_one_stays_in_any_case_and_so_does_what_was_seen_directly(seen):
    scene, held, model = seen
    alone = judge(scene, held, model.with_effect(NOTHING), 10)
    assert without_unneeded(held, alone) is alone
    proven = replace(model, effects=(NOTHING, FRICTION, LOAD), proven=frozenset({NOTHING.name}))
    found = judge(scene, held, proven, 10)
    assert without_unneeded(held, found) is found


def test_who_is_unsure_and_missed_stays(seen, monkeypatch):
    """A size in doubt, as beside one that goes alike, is no reason by itself."""
    scene, held, model = seen
    found = judge(scene, held, replace(model, effects=(FRICTION, LOAD)), 10)
    monkeypatch.setattr(unneeded, "sureness", lambda judged, index: 1.0)
    assert without_unneeded(held, found).model.names == found.model.names


def test_who_has_not_come_to_rest_is_fitted_on_first(seen, monkeypatch):
    """As it stands a friction three times too large is worse than none; nobody asked who is left out
    whether it had come to rest."""
    scene, held, model = seen
    large = replace(FRICTION, parameters={"level": 6.0})
    found = judge(scene, held, replace(model, effects=(large, LOAD)), 0)
    bare = judge(scene, held, model.with_effect(LOAD), 8)
    assert bare.score > found.score
    monkeypatch.setattr(unneeded, "sureness", lambda judged, index: 1.0)
    left = without_unneeded(held, found)
    assert left.model.names == found.model.names
    assert left.model.effects[0].parameters["level"] == pytest.approx(2.0, rel=0.02)


def test_levels_of_a_table_are_no_one_size(seen):
    scene, held, model = seen
    levels = [2.0, 2.0, 2.0]
    table = {"grid": [-0.1, 0.0, 0.1], "positive": levels, "negative": levels}
    spec = EffectSpec("position_dependent_friction", {"table": table, "level": 2.0})
    found = judge(scene, held, replace(model, effects=(spec, LOAD)), 4)
    assert sureness(found, 0) == float("inf")


def test_what_the_models_own_number_would_say_beyond_the_line_stays(stage, scenes, record):
    """A damper beside the model's own, free as well: without it that goes beyond the line, which is no
    correction."""
    damper = EffectSpec("viscous_friction", {"coefficient": 20.0})
    scene, held, model = scenes(record(replace(stage, effects=(FRICTION, damper))))
    found = judge(scene, held, replace(model, effects=(FRICTION, damper)), 10)
    bare = judge(scene, held, replace(model, effects=(FRICTION,)), 10)
    assert crosses(bare.scene, bare)
    assert sureness(found, 1) < unneeded.ASKED
    assert without_unneeded(held, found).model.names == found.model.names


def test_a_number_beyond_the_line_already_keeps_nobody(seen, monkeypatch):
    """Some stay a little beyond it, and are none of who leaves."""
    scene, held, model = seen
    found = judge(scene, held, replace(model, effects=(NOTHING, FRICTION, LOAD)), 10)
    monkeypatch.setattr(unneeded, "crosses", lambda *_: True)
    assert without_unneeded(held, found).model.names == (FRICTION.name, LOAD.name)

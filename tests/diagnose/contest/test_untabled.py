"""A friction by position is held against plain friction and a force by position, once others stand."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest import untabled as taken_apart
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.untabled import _repeats, _yielding, untabled
from ffl.systems.plant import EffectSpec

PLACES = np.linspace(-0.005, 0.055, 7)
COULOMB = EffectSpec("coulomb_friction", {"level": 2.0})
COGGING = EffectSpec("cogging", {"amplitude": 0.6, "period": 0.03, "phase": 0.2})
BY_DIRECTION = EffectSpec("asymmetric_friction", {"level_positive": 2.6, "level_negative": 1.6})
TEETH = {"amplitude": 0.9, "phase": 0.2, "period": 0.02, "amplitude_2": 0.3, "phase_2": 1.0}
TWO_TEETH = EffectSpec("cogging", TEETH)
FORCE = 0.9 * np.sin(2.0 * np.pi * PLACES / 0.02 + 0.2)
VISCOUS = EffectSpec("viscous_friction", {"coefficient": 12.0})


def table(up, down, places=PLACES):  # type: ignore[no-untyped-def]
    levels = {"grid": places.tolist(), "positive": up.tolist(), "negative": down.tolist()}
    return EffectSpec(
        "position_dependent_friction", {"table": levels, "level": float(np.mean([up, down]))}
    )


BOTH_WAYS = table(2.0 + 10.0 * PLACES, 2.0 + 10.0 * PLACES)  # no force by position is in it
HALVES = table(2.0 - 0.6 * np.sin(200.0 * PLACES), 2.0 + 0.6 * np.sin(200.0 * PLACES))


@pytest.mark.parametrize(
    ("true", "stood", "names"),
    [
        ((COULOMB, COGGING, VISCOUS), HALVES, {"viscous_friction", "coulomb_friction", "cogging"}),
        ((BOTH_WAYS, VISCOUS), BOTH_WAYS, None),
    ],
)
def test_two_for_a_table_where_they_do_as_much(stage, record, scenes, true, stood, names):  # type: ignore[no-untyped-def]
    runs = record(replace(stage, effects=true))
    scene, held, model = scenes(runs)
    standing = judge(scene, held, model.with_effect(stood).with_effect(VISCOUS), 10)
    found = untabled(scene, held, standing, lambda line: None)
    assert (found and set(found.model.names)) == names


def test_alone_it_is_left_where_it_does(stage, record, scenes):  # type: ignore[no-untyped-def]
    """Then the two were held against it when it came."""
    scene, held, model = scenes(record(replace(stage, effects=(BOTH_WAYS,))))
    standing = judge(scene, held, model.with_effect(BOTH_WAYS), 2)
    assert untabled(scene, held, standing, lambda line: None) is None


def test_alone_it_is_taken_apart_where_it_leaves_much(stage, record, scenes, monkeypatch):  # type: ignore[no-untyped-def]
    """Levels by direction, and a cogging that no screen sees beside corrections bent in its place."""
    monkeypatch.setattr(taken_apart, "TRIED", 0)
    scene, held, model = scenes(record(replace(stage, effects=(BY_DIRECTION, TWO_TEETH))))
    up, down = 2.6 - FORCE, 1.6 + FORCE
    standing = judge(scene, held, model.with_effect(table(up, down)), 10)
    assert standing.fit.far
    found = untabled(scene, held, standing, lambda line: None)
    assert set(found.model.names) == {"asymmetric_friction", "cogging"}
    cogging = found.model.effects[found.model.names.index("cogging")].parameters
    assert cogging["period"] == pytest.approx(0.02, rel=0.01)
    assert cogging["amplitude_2"] == pytest.approx(0.3, rel=0.05)


def test_what_repeats_is_read_off_the_table():
    places = np.linspace(-0.06, 0.05, 33)
    force = 0.2 * np.sin(2.0 * np.pi * places / 0.026 + 0.7)
    read = _repeats(table(0.39 - force, 0.27 + force, places))
    assert read.name == "cogging"
    assert read.parameters["period"] == pytest.approx(0.026, rel=0.02)
    assert read.parameters["amplitude"] == pytest.approx(0.2, rel=0.05)
    assert _repeats(table(0.39 - force[:3], 0.27 + force[:3], places[:3])) is None


def test_a_table_that_yields_may_be_a_contact_of_its_mean_level():
    table = {"grid": [0.0, 0.1], "positive": [20.0, 22.0], "negative": [14.0, 16.0]}
    rigid = EffectSpec("position_dependent_friction", {"level": 18.0, "table": table})
    assert _yielding(rigid) is None
    spec = _yielding(replace(rigid, parameters={**rigid.parameters, "stiffness": 9e4}))
    assert spec.name == "presliding_friction"
    assert spec.parameters == {"level": 18.0, "stiffness": 9e4, "micro_damping": 0.0}

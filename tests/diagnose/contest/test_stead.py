"""One effect in the place of all that stand for it."""

from dataclasses import replace

import pytest

from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.rounds import Step
from ffl.diagnose.contest.stead import in_their_stead
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.screen.screen import Screen
from ffl.systems.plant import EffectSpec

SINE = EffectSpec("periodic_disturbance", {"frequency": 7.3, "amplitude": 0.4, "phase": 0.5})


@pytest.fixture(scope="module")
def standing(stage, record, scenes):  # type: ignore[no-untyped-def]
    """A load and more mass for a sine, all rounds, and what the stated numbers show."""
    scene, held, model = scenes(record(replace(stage, effects=(SINE,))))
    nothing = judge(scene, held, model)
    (seen,) = Screen(scene, fit(scene, model, rounds=0)).candidates([SINE.name])[:1]
    load = EffectSpec("constant_load", {"force": 0.1})
    current = judge(scene, held, replace(model, corrections={"mass": 0.02}).with_effect(load))
    steps = [Step(nothing, (), (current,), current), Step(current, (seen,), (), None)]
    return steps, scene, held, current, seen


def test_what_the_stated_numbers_show_is_tried_alone(standing):
    *known, _ = standing
    said: list[str] = []
    found = in_their_stead(*known, said.append)
    assert found is not None
    assert found.model.names == (SINE.name,)
    assert found.model.effects[0].parameters["frequency"] == pytest.approx(7.3, rel=1e-3)
    assert "periodic_disturbance alone" in said[0]


def test_only_who_promises_much_beside_other_numbers_is_tried(standing):
    (first, last), scene, held, current, seen = standing
    said: list[str] = []

    def tried(**changed):  # type: ignore[no-untyped-def]
        step = replace(last, screened=(replace(seen, **changed),))
        return in_their_stead([first, step], scene, held, current, said.append)

    assert tried(gain=1.0) is None
    assert tried(like=current.fit) is None
    assert tried(spec=current.model.effects[0]) is None
    assert in_their_stead([], scene, held, current, said.append) is None
    assert in_their_stead([first], scene, held, current, said.append) is None
    assert said == []

"""Other ways to go on from what stands: a spring whose middle no recording came near."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffl.diagnose.contest.forks import within_the_travel
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.hypothesis.amounts import undone
from ffl.diagnose.hypothesis.places import places_of
from ffl.systems import EffectSpec

SPRING = EffectSpec("hardening_spring", {"centre": 0.03, "cubic_coefficient": 2.0e5})


@pytest.fixture(scope="module")
def sprung(stage, record, scenes):  # type: ignore[no-untyped-def]
    """A spring that hardens about the middle of the travel, and a load."""
    load = EffectSpec("constant_load", {"force": -6.0})
    return scenes(record(replace(stage, effects=(SPRING, load))))


def test_a_spring_whose_middle_no_recording_came_near_is_one_within_beside_a_load(sprung):  # type: ignore[no-untyped-def]
    scene, held, model = sprung
    far = replace(SPRING, parameters={"centre": -0.4, "cubic_coefficient": 50.0})
    stands = judge(scene, held, model.with_effect(far), 0)
    said: list[str] = []
    found = within_the_travel(scene, held, stands, said.append)
    assert found is not None
    assert said == [s for s in said if s.startswith("  hardening_spring within the travel")] != []
    spring, load = found.model.effects
    assert spring.parameters["centre"] == pytest.approx(0.03, abs=5e-4)
    assert spring.parameters["cubic_coefficient"] == pytest.approx(2.0e5, rel=0.03)
    assert load.name == "constant_load"
    assert load.parameters["force"] == pytest.approx(-6.0, rel=0.03)


def test_a_spring_about_a_place_that_was_passed_stays(sprung):  # type: ignore[no-untyped-def]
    scene, held, model = sprung
    stands = judge(scene, held, model.with_effect(SPRING), 0)
    assert within_the_travel(scene, held, stands, pytest.fail) is None
    beside = model.with_effect(replace(SPRING, parameters={**SPRING.parameters, "centre": 9.0}))
    loaded = beside.with_effect(EffectSpec("constant_load", {"force": 1.0}))
    assert within_the_travel(scene, held, judge(scene, held, loaded, 0), pytest.fail) is None


@pytest.mark.parametrize(
    ("change", "own", "said"),
    [
        (0.48, -0.27, True),
        (0.48, -0.1, False),  # a part of it: the model's own mass is off besides
        (0.48, 0.27, False),  # both say more
        (0.05, -0.019, False),  # within the line
    ],
)
def test_a_change_of_mass_that_the_model_takes_back_is_none(sprung, change, own, said):  # type: ignore[no-untyped-def]
    _, _, model = sprung
    place = places_of(model)[0]
    heavier = EffectSpec("mass_change", {"change": change}, place.options)
    model = replace(model, corrections={"mass": own}).with_effect(heavier)
    assert undone(model) is said
    assert not undone(replace(model, effects=()))

"""What stands is put to the test: one effect where two halves of it stand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose.contest import settle as settling
from ffl.diagnose.contest.dry import PLIABLE, as_it_stands, levels_of
from ffl.diagnose.contest.judging import between, judge
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.settle import challengers, one_for_two, settle
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import Simulator
from ffl.systems import EffectSpec

NOISE = Noise(1e-7, 2e-3)
LEVEL = EffectSpec("coulomb_friction", {"level": 3.0}, {"side": "motor"})
LOAD = EffectSpec("constant_load", {"force": 0.5})


def test_a_level_beside_a_load_is_a_level_for_each_direction(stage):  # type: ignore[no-untyped-def]
    reference = 0.01 * (1.0 - np.cos(np.arange(4000) * 2e-3))
    simulator = Simulator(stage)
    two = simulator.run((LEVEL, LOAD), reference).y
    one = simulator.run((levels_of(LEVEL, LOAD),), reference).y
    np.testing.assert_allclose(one, two, atol=1e-9 * np.abs(two).max())


def test_a_load_above_the_level_stays_a_load() -> None:
    assert levels_of(LEVEL, replace(LOAD, parameters={"force": -3.5})) is None
    assert levels_of(LEVEL, EffectSpec("viscous_friction", {"damping": 1.0})) is None
    assert levels_of(EffectSpec("hysteresis", {"force": 1.0}), LOAD) is None


@pytest.mark.parametrize(
    ("friction", "one"),
    [
        (LEVEL, True),
        (EffectSpec("stribeck_friction", {"coulomb_level": 3.0, "static_level": 5.0,
                                          "stribeck_velocity": 0.02}, {"side": "motor"}), False),
    ],
)  # fmt: skip
def test_two_halves_are_one_unless_the_friction_says_more(stage, record, friction, one):  # type: ignore[no-untyped-def]
    recordings = record(replace(stage, effects=(friction, LOAD)))
    base = Base.of(stage, max(float(np.ptp(r.y)) for r in recordings))
    trials = tuple(prepare(base.simulator, r, 1e-7) for r in recordings)
    scene = Scene(stage.loop, trials, NOISE)
    lines: list[str] = []
    judged = judge(scene, None, replace(Model(base), effects=(friction, LOAD)), rounds=4)
    found = one_for_two(scene, None, judged, lines.append).model
    assert any("asymmetric_friction" in line for line in lines)
    if not one:
        assert found.names == judged.model.names
        return
    assert found.names == ("asymmetric_friction",)
    levels = found.effects[0].parameters
    assert levels["level_positive"] == pytest.approx(2.5, rel=0.02)
    assert levels["level_negative"] == pytest.approx(3.5, rel=0.02)


def test_forms_of_one_friction_begin_from_the_level_that_stands() -> None:
    def begun(spec, name, **values):  # type: ignore[no-untyped-def]
        return as_it_stands(spec, SimpleNamespace(spec=EffectSpec(name, values)))  # type: ignore[arg-type]

    stuck = {"coulomb_level": 9.0, "static_level": 9.5, "stribeck_velocity": 0.02}
    (stribeck,) = begun(LEVEL, "stribeck_friction", **stuck)
    assert stribeck.parameters == {**stuck, "coulomb_level": 3.0, "static_level": 3.0}
    bristle = EffectSpec("presliding_friction", {"level": 3.0, "stiffness": 1e6})
    (plain,) = begun(bristle, "coulomb_friction", level=9.0)
    assert plain.parameters == {"level": 3.0}
    assert begun(LOAD, "coulomb_friction", level=9.0) == []
    assert begun(LEVEL, "hysteresis", force=9.0) == []


def test_what_acts_late_begins_as_late_as_what_stands() -> None:
    """A screen beside friction that was fitted with a delay of 1.3 ms saw a lag of 0.2 ms, truth 2.2 ms."""

    def begun(spec, other):  # type: ignore[no-untyped-def]
        return as_it_stands(spec, SimpleNamespace(spec=other))  # type: ignore[arg-type]

    delay, lag = (EffectSpec(*one) for one in LATE)
    assert begun(delay, EffectSpec("actuator_lag", {"time_constant": 2e-4})) == [lag]
    assert begun(lag, EffectSpec("input_delay", {"delay": 2e-4})) == [delay]
    assert begun(lag, EffectSpec("coulomb_friction", {"level": 1.0})) == []
    assert begun(LEVEL, EffectSpec("input_delay", {"delay": 2e-4})) == []


@pytest.mark.parametrize("source", ["", "ffl identify linear of a long recording"])
def test_friction_that_creeps_comes_in_the_place_of_dry_friction_beside_a_model_that_was_identified(
    stage, record, source
):  # type: ignore[no-untyped-def]
    plant = replace(stage, source=source)
    recordings = record(replace(plant, effects=(LEVEL,)))
    base = Base.of(plant, max(float(np.ptp(r.y)) for r in recordings))
    scene = Scene(plant.loop, tuple(prepare(base.simulator, r, 1e-7) for r in recordings), NOISE)
    judged = judge(scene, None, replace(Model(base), effects=(LEVEL,)), rounds=1)
    asked = frozenset({"logarithmic_friction", "stribeck_friction"})
    found = {c.spec.name for c in challengers(scene, judged, 0, [], frozenset(), asked)}
    assert "stribeck_friction" in found
    assert ("logarithmic_friction" in found) == bool(source)


def test_plain_friction_is_tried_whatever_a_screen_sees_of_it(with_friction, monkeypatch):  # type: ignore[no-untyped-def]
    """Without friction a loop at its limit may run away: no column beside that says anything."""
    scene, _, model = with_friction
    skewed = {"level_positive": 2.9, "level_negative": 3.1}
    other = EffectSpec("asymmetric_friction", skewed, {"side": "load"})
    judged = judge(scene, None, replace(model, effects=(other,)), rounds=1)
    monkeypatch.setattr(settling.Screen, "candidates", lambda *_: [])
    (only,) = challengers(scene, judged, 0, [], frozenset())
    assert (only.spec.name, only.spec.options) == ("coulomb_friction", {"side": "load"})
    levels = judged.model.effects[0].parameters
    mean = 0.5 * (levels["level_positive"] + levels["level_negative"])
    assert only.spec.parameters == {"level": pytest.approx(mean)}
    assert challengers(scene, judged, 0, [], frozenset({"coulomb_friction"})) == []


def test_the_contact_that_a_hysteresis_is_as_stiff_as_is_tried(with_friction, monkeypatch):  # type: ignore[no-untyped-def]
    scene, _, model = with_friction
    values = {"force": 3.0, "displacement": 2e-5, "exponent": 1.0, "beta": 0.5}
    other = EffectSpec("hysteresis", values, {"side": "load"})
    judged = judge(scene, None, replace(model, effects=(other,)), rounds=1)
    found = judged.model.effects[0].parameters
    monkeypatch.setattr(settling.Screen, "candidates", lambda *_: [])
    begun = {c.spec.name: c.spec for c in challengers(scene, judged, 0, [], frozenset())}
    contact = begun["presliding_friction"]
    assert contact.options == {"side": "load"}
    assert contact.parameters == {
        "level": pytest.approx(found["force"]),
        "stiffness": pytest.approx(found["force"] / found["displacement"]),
        "micro_damping": 0.0,
    }
    assert "presliding_friction" not in [
        c.spec.name for c in challengers(scene, judged, 0, [], frozenset({"presliding_friction"}))
    ]


RIPPLE = EffectSpec("encoder_ripple", {"amplitude": 1e-9, "period": 4e-3, "phase": 0.0})

LATE = (("input_delay", {"delay": 1.3e-3}), ("actuator_lag", {"time_constant": 1.3e-3}))


@pytest.fixture(scope="module")
def with_friction(stage, record):  # type: ignore[no-untyped-def]
    """(fitted, held-out scene, model without effects) of a machine with dry friction."""
    recordings = record(replace(stage, effects=(LEVEL,)))
    base = Base.of(stage, max(float(np.ptp(r.y)) for r in recordings))
    scenes = [Scene(stage.loop, (prepare(base.simulator, r, 1e-7),), NOISE) for r in recordings[:2]]
    return *scenes, Model(base)


def test_what_only_the_recordings_that_judge_gain_by_goes(with_friction, monkeypatch):  # type: ignore[no-untyped-def]
    """Free runs that go their own way: without the ripple the held-out one leaves a tenth more."""
    scene, held, model = with_friction
    real = settling.judge

    def chance(scene, held, model, *rest):  # type: ignore[no-untyped-def]
        found = real(scene, held, model, *rest)
        return found if RIPPLE.name in model.names else replace(
            found, held_white=1.1 * found.held_white
        )  # fmt: skip

    monkeypatch.setattr(settling, "judge", chance)
    both = real(scene, held, replace(model, effects=(LEVEL, RIPPLE)), 1)
    left, _ = settle(scene, held, both, [], PLIABLE, lambda line: None, {})
    assert left.model.names == (LEVEL.name,)


def test_friction_in_a_wrong_form_makes_room_for_the_right_one(with_friction):  # type: ignore[no-untyped-def]
    scene, held, model = with_friction
    skewed = {"level_positive": 1.5, "level_negative": 4.5}
    off = EffectSpec("asymmetric_friction", skewed, {"side": "motor"})
    current = judge(scene, held, replace(model, effects=(off, RIPPLE)), 0)
    without = judge(scene, held, current.model.without(0), 4)
    found = settling._in_another_form(scene, held, current, without, 0, [], lambda line: None)
    assert found.model.names == (RIPPLE.name, "coulomb_friction")
    assert found.model.effects[1].parameters["level"] == pytest.approx(3.0, rel=0.02)
    plain = judge(scene, held, current.model.without(1), 4)
    gone = settling._in_another_form(scene, held, current, plain, 1, [], lambda line: None)
    assert gone is plain  # nothing but dry friction has forms


def test_a_rival_that_did_as_well_before_is_still_named_beside_what_stands(with_friction):  # type: ignore[no-untyped-def]
    scene, held, model = with_friction
    own = judge(scene, held, replace(model, effects=(LEVEL,)), 4)
    rival = replace(own, fitted=own.fitted + 1.0)  # of as many numbers, a little ahead by chance
    tried = {LEVEL.name: [(LEVEL.name, own), ("asymmetric_friction", rival)]}
    _, contenders = settle(scene, held, own, [], PLIABLE, lambda line: None, tried)
    assert "asymmetric_friction" in {name for name, _ in next(iter(contenders.values()))}


def test_what_came_by_substitution_meets_its_own_siblings(stage, record, scenes):  # type: ignore[no-untyped-def]
    """Levels by direction gave way to one level, against which no form that falls with speed had stood."""
    falling = EffectSpec(
        "stribeck_friction",
        {"coulomb_level": 2.0, "static_level": 4.0, "stribeck_velocity": 0.02},
        {"side": "motor"},
    )
    scene, held, model = scenes(record(replace(stage, effects=(falling,))))
    levels = EffectSpec("asymmetric_friction", {"level_positive": 3.0, "level_negative": 3.0})
    plain = judge(scene, held, model.with_effect(LEVEL))
    two = judge(scene, held, model.with_effect(levels))
    tried = {LEVEL.name: [(levels.name, two), (LEVEL.name, plain)]}
    found, _ = settle(scene, held, plain, [], frozenset(), lambda line: None, tried)
    assert found.model.names == (falling.name,)
    assert found.model.effects[0].parameters["static_level"] == pytest.approx(4.0, rel=0.05)


def test_between_two_of_as_many_numbers_what_is_open_decides_nothing(stage, record, scenes):
    """Friction 2 standard errors off loses on recordings that judge; with them granted it does not."""
    dry = EffectSpec("coulomb_friction", {"level": 3.0})
    scene, held, model = scenes(record(replace(stage, effects=(dry,))))
    own = judge(scene, held, model.with_effect(dry))
    moved = own.model.at(own.model.theta + 2.0 * own.fit.spread)
    off = replace(own, fit=replace(own.fit, model=moved), held_out=own.held_out - 80.0)
    wrong = own.model.with_parameters(0, {"level": 4.0})
    far = replace(own, fit=replace(own.fit, model=wrong), held_out=own.held_out - 1000.0)
    near = replace(far, held_out=own.held_out - 1.0)
    same, less, no_worse = between(scene, own, [off, far, near])
    assert same.held_out == pytest.approx(own.held_out, abs=8.0)
    assert less.held_out < own.held_out - 80.0
    assert no_worse.held_out == near.held_out  # who is ahead is not more so by what is granted
    more = judge(scene, held, own.model.with_effect(EffectSpec("constant_load", {"force": 0.0})))
    assert between(scene, own, [more]) == [more]

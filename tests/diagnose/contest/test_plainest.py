"""Plain friction that goes by another name."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose.contest import plainest as plainest_forms
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.plainest import _flat, plainest
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.systems import EffectSpec


def scene_of(plant, recordings):  # type: ignore[no-untyped-def]
    base = Base.of(plant, max(float(np.ptp(r.y)) for r in recordings))
    trials = tuple(prepare(base.simulator, r, 1e-7) for r in recordings)
    return Scene(plant.loop, trials, Noise(1e-7, 2e-3)), Model(base)


def told(plant, record, machine, stood):  # type: ignore[no-untyped-def]
    """(found, outcome) of what `machine` did, told as `stood` has it."""
    scene, model = scene_of(plant, record(replace(plant, effects=(machine,))))
    judged = judge(scene, None, model.with_effect(stood), rounds=0)
    held = replace(scene, trials=scene.trials[:1])
    contenders = {stood.name: [(stood.name, judged)]}
    return plainest(held, judged, Outcome(judged, [], held, contenders))


@pytest.mark.parametrize(
    ("machine", "said"),
    [
        (EffectSpec("coulomb_friction", {"level": 3.0}), "coulomb_friction"),
        (
            EffectSpec(
                "stribeck_friction",
                {"coulomb_level": 2.0, "static_level": 4.0, "stribeck_velocity": 0.02},
            ),
            "stribeck_friction",
        ),
    ],
)
def test_two_levels_that_no_recording_tells_apart_are_one(stage, record, machine, said):  # type: ignore[no-untyped-def]
    falling = EffectSpec(
        "stribeck_friction", {"coulomb_level": 2.8, "static_level": 3.2, "stribeck_velocity": 0.02}
    )
    scene, model = scene_of(stage, record(replace(stage, effects=(machine,))))
    judged = judge(scene, None, model.with_effect(falling), rounds=30)
    outcome = Outcome(judged, [], None, {"stribeck_friction": [("stribeck_friction", judged)]})
    found, after = plainest(None, judged, outcome)
    assert found.model.names == (said,)
    if said == "coulomb_friction":
        assert found.model.effects[0].parameters["level"] == pytest.approx(3.0, rel=0.02)
        assert [name for name, _ in after.contenders[said]] == [said, "stribeck_friction"]


@pytest.mark.parametrize(
    ("apart", "said"), [(0.01, "coulomb_friction"), (0.8, "position_dependent_friction")]
)
def test_a_table_of_one_level_is_plain_friction(stage, record, apart, said):  # type: ignore[no-untyped-def]
    def table(apart):  # type: ignore[no-untyped-def]
        levels = [3.0 - apart, 3.0, 3.0 + apart]
        values = {"grid": [-0.1, 0.0, 0.1], "positive": levels, "negative": levels}
        return EffectSpec("position_dependent_friction", {"table": values, "level": 3.0})

    found, after = told(stage, record, table(apart), table(apart))
    assert found.model.names == (said,)
    if said == "coulomb_friction":
        assert found.model.effects[0].parameters["level"] == pytest.approx(3.0, rel=0.01)
        assert [name for name, _ in after.contenders[said]] == [said]


def test_a_table_of_one_level_either_way_is_friction_by_direction(stage, record):  # type: ignore[no-untyped-def]
    machine = EffectSpec("asymmetric_friction", {"level_positive": 3.5, "level_negative": 2.5})
    values = {
        "grid": [-0.1, 0.0, 0.1],
        "positive": [3.51, 3.49, 3.5],
        "negative": [2.49, 2.5, 2.51],
    }
    name = "position_dependent_friction"
    table = EffectSpec(name, {"table": values, "level": 3.0})
    found, after = told(stage, record, machine, table)
    assert found.model.names == ("asymmetric_friction",)
    levels = found.model.effects[0].parameters
    assert levels["level_positive"] == pytest.approx(3.5, rel=0.01)
    assert levels["level_negative"] == pytest.approx(2.5, rel=0.01)
    assert [each for each, _ in after.contenders["asymmetric_friction"]] == ["asymmetric_friction"]


GRID = np.linspace(-1.0, 1.0, 5)


@pytest.mark.parametrize(
    ("up", "down", "one"),
    [
        (7.0 - 0.7 * GRID, 7.0 + 0.7 * GRID, True),  # a spring beside it
        (6.5 + 0.0 * GRID, 7.5 + 0.0 * GRID, True),  # a load
        (7.0 - 0.7 * GRID, 7.0 - 0.7 * GRID, False),  # more at one end
        (7.0 - 0.7 * GRID**2, 7.0 + 0.7 * GRID**2, False),  # no straight line
    ],
)
def test_a_spring_or_a_load_beside_one_level_is_no_friction_by_position(up, down, one):
    table = {"grid": GRID.tolist(), "positive": up.tolist(), "negative": down.tolist()}
    spec = EffectSpec("position_dependent_friction", {"table": table})
    judged = SimpleNamespace(model=SimpleNamespace(effects=(spec,)))
    assert _flat(judged, 0) is one


@pytest.mark.parametrize(
    ("apart", "beside", "said"),
    [
        (0.01, "drift", "coulomb_friction"),  # a drift that is a little off holds the difference
        (0.01, None, "asymmetric_friction"),
        (0.4, "drift", "asymmetric_friction"),
    ],
)
def test_levels_that_a_force_beside_them_holds_are_one(stage, record, apart, beside, said):  # type: ignore[no-untyped-def]
    slow = EffectSpec("drift", {"amplitude": 2.0, "time_constant": 2.0})
    levels = {"level_positive": 3.0 + apart, "level_negative": 3.0 - apart}
    machine = (EffectSpec("asymmetric_friction", levels), *([slow] if beside else []))
    scene, model = scene_of(stage, record(replace(stage, effects=machine)))
    judged = judge(scene, None, replace(model, effects=machine), rounds=10)
    name = "asymmetric_friction"
    found, _ = plainest(None, judged, Outcome(judged, [], None, {name: [(name, judged)]}))
    assert said in found.model.names


@pytest.mark.parametrize(
    ("displacement", "said"), [(1.0, "linear_stiffness"), (2e-3, "hysteresis")]
)
def test_a_hysteresis_that_never_slides_is_a_spring(stage, record, displacement, said):  # type: ignore[no-untyped-def]
    """What slides within the travel keeps its name."""
    values = {"force": 400.0 * displacement, "displacement": displacement}
    loop = EffectSpec("hysteresis", {**values, "exponent": 1.0, "beta": 0.5})
    spring = EffectSpec("linear_stiffness", {"stiffness": 400.0, "centre": 0.0})
    machine = loop if said == "hysteresis" else spring
    found, after = told(stage, record, machine, loop)
    assert found.model.names == (said,)
    if said == "linear_stiffness":
        assert found.model.effects[0].parameters["stiffness"] == pytest.approx(400.0, rel=0.05)
        assert [name for name, _ in after.contenders[said]] == [said]


def test_a_hardening_loop_of_no_known_size_is_a_spring(stage, record):  # type: ignore[no-untyped-def]
    """Only the slope of it shows: over 5 m it hardens by nothing."""
    spring = EffectSpec("linear_stiffness", {"stiffness": 400.0, "centre": 0.0})
    values = {"force": 2000.0, "displacement": 5.0, "exponent": 2.0, "beta": 1.0}
    loop = EffectSpec("hysteresis", values, {"kind": "hardening"})
    found, _ = told(stage, record, spring, loop)
    assert found.model.names == ("linear_stiffness",)


@pytest.mark.parametrize(
    ("velocity", "error", "says"),
    [(0.5e-4, 0.3e-4, True), (0.5e-4, 0.1e-4, False), (4e-4, 2e-4, False), (4e-4, 5e-4, True)],
)
def test_a_fall_that_no_sensor_shows_says_nothing(monkeypatch, velocity, error, says):
    """Of noise of 0.1 um in samples of 1 ms."""
    monkeypatch.setattr(plainest_forms, "error_of", lambda *_: error)
    spec = EffectSpec("stribeck_friction", {"stribeck_velocity": velocity})
    base = SimpleNamespace(plant=SimpleNamespace(sample_time=1e-3))
    model = SimpleNamespace(effects=(spec,), base=base)
    scene = SimpleNamespace(noise=SimpleNamespace(sensor=1e-7))
    judged = SimpleNamespace(model=model, scene=scene)
    assert plainest_forms._falls_nowhere(judged, 0) is says  # type: ignore[arg-type]


def test_a_fall_over_no_known_velocity_is_plain_friction(stage, record):  # type: ignore[no-untyped-def]
    """A curve that falls far above all speeds takes up what rounds of a fit have left."""
    machine = EffectSpec("coulomb_friction", {"level": 3.0})
    values = {"coulomb_level": 1.0, "static_level": 3.0, "stribeck_velocity": 40.0}
    falling = EffectSpec("stribeck_friction", values)
    found, _ = told(stage, record, machine, falling)
    assert found.model.names == ("coulomb_friction",)
    assert found.model.effects[0].parameters["level"] == pytest.approx(3.0, rel=0.02)

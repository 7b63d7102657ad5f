"""Faults of a recording are told apart, and named before any physics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.recorded.commands import feedback_of
from ffl.diagnose.recorded.sound import soundness
from ffl.machines import SimulatedMachine
from ffl.recordings import Recording
from ffl.systems import Controller, EffectSpec
from ffl.systems.zpk import as_state_space


@pytest.fixture(scope="module")
def clean(stage, record):  # type: ignore[no-untyped-def]
    return record(stage)[0]


def _with(recording: Recording, **columns) -> Recording:  # type: ignore[no-untyped-def]
    return replace(recording, **columns)


def test_sound_recording_is_consistent_to_rounding(stage, clean):  # type: ignore[no-untyped-def]
    found = soundness(stage, [clean])
    assert not found.faults
    assert found.consistency[0] < 1e-6


def test_lost_samples_are_said_before_any_physics(stage, clean):  # type: ignore[no-untyped-def]
    """In the middle of a move, their time counted on: the controller's own check hardly sees it."""
    at = int(np.argmax(np.abs(np.diff(clean.r))))
    kept = np.ones(len(clean), bool)
    kept[at : at + 30] = False
    columns = {k: getattr(clean, k)[kept] for k in "rfuy"}
    spoilt = _with(clean, **columns, t=clean.t[: kept.sum()])
    (fault,) = soundness(stage, [spoilt]).faults
    assert fault.kind == "samples_missing"
    assert "jump together" in fault.where
    assert diagnose(stage, [spoilt]).answer()["verdict"] == "inconclusive"


@pytest.mark.parametrize(
    ("kind", "spoil"),
    [
        ("unit", lambda r: {"u": 1000.0 * r.u}),
        ("unit", lambda r: {"y": 0.001 * r.y}),
        ("sign", lambda r: {"u": -r.u}),
        ("sign", lambda r: {"y": -r.y}),
        ("shift", lambda r: {"y": np.concatenate([np.full(7, r.y[0]), r.y[:-7]])}),
        ("shift", lambda r: {"y": np.concatenate([r.y[9:], np.full(9, r.y[-1])])}),
        ("shift", lambda r: {"u": np.concatenate([[r.u[0]], r.u[:-1]])}),
        ("shift", lambda r: {"u": np.concatenate([r.u[3:], np.full(3, r.u[-1])])}),
        ("columns", lambda r: {"u": r.y, "y": r.u}),
        ("columns", lambda r: {"r": r.y, "y": r.r}),
        ("clipped_sensor", lambda r: {"y": np.minimum(r.y, 0.8 * r.y.max())}),
        ("frozen_sensor", lambda r: {"y": np.where(np.arange(len(r)) // 400 == 2, r.y[800], r.y)}),
    ],
)
def test_fault_is_named(stage, clean, kind, spoil):  # type: ignore[no-untyped-def]
    found = soundness(stage, [_with(clean, **spoil(clean))])
    assert [f.kind for f in found.faults] == [kind]


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda r: {"y": r.r - r.y}, ("error r - y,", "y as r minus that", "scale = -1 }] }")),
        (lambda r: {"y": r.y - r.r}, ("error y - r,", "y as r plus that", "scale = 1 }] }")),
    ],
)
@pytest.mark.parametrize("level", [0.0, 4.0])
def test_the_following_error_is_told_from_the_position(stage, record, spoil, said, level):  # type: ignore[no-untyped-def]
    friction = (EffectSpec("coulomb_friction", {"level": level}),) if level else ()
    run = record(replace(stage, effects=friction))[0]
    (fault,) = soundness(stage, [_with(run, **spoil(run))]).faults
    assert fault.kind == "columns"
    assert all(words in fault.mend for words in said)


def test_a_reference_that_did_not_act_makes_no_error_of_y(stage, references):  # type: ignore[no-untyped-def]
    """u = f - C y, y as it is: r + y would satisfy the controller's equation with r, but is no motion."""
    rng = np.random.default_rng(5)
    f = 0.5 * np.sin(2 * np.pi * 3.0 * stage.sample_time * np.arange(len(references[0])))
    run = SimulatedMachine(stage).run(0.0 * references[0], f, rng)
    (fault,) = soundness(stage, [_with(run, r=references[0])]).faults
    assert "following error" not in fault.mend


def test_a_controller_that_takes_its_time_is_told_from_a_late_output(stage, clean):  # type: ignore[no-untyped-def]
    late = _with(clean, u=np.concatenate([[clean.u[0]] * 2, clean.u[:-2]]))
    assert (
        "u is what the controller gives 2 samples later" in soundness(stage, [late]).faults[0].mend
    )
    late = _with(clean, y=np.concatenate([[clean.y[0]] * 2, clean.y[:-2]]))
    assert "y is 2 samples late" in soundness(stage, [late]).faults[0].mend


def test_a_reference_logged_late_is_told_from_an_output_logged_early(stage, clean):  # type: ignore[no-untyped-def]
    late = _with(clean, r=np.concatenate([[clean.r[0]], clean.r[:-1]]))
    assert "r is 1 sample late against u and y" in soundness(stage, [late]).faults[0].mend
    early = _with(clean, y=np.concatenate([clean.y[2:], [clean.y[-1]] * 2]))
    said = soundness(stage, [early]).faults[0].mend
    assert "y is 2 samples early against u and r" in said
    assert "reaches the controller 2 samples late" in said


@pytest.fixture(scope="module")
def fed(stage, references):  # type: ignore[no-untyped-def]
    """A recording with a feedforward, which u holds too."""
    push = 0.4 * np.sin(2 * np.pi * 1.7 * np.arange(len(references[0])) * stage.sample_time)
    return SimulatedMachine(stage).run(references[0], push, np.random.default_rng(0))


@pytest.mark.parametrize(("by", "word"), [(6, "late"), (-6, "early")])
def test_command_and_feedforward_logged_beside_the_rest_are_a_time_base(stage, fed, by, word):  # type: ignore[no-untyped-def]
    moved = {name: np.roll(getattr(fed, name), by) for name in "uf"}
    fault = soundness(stage, [_with(fed, **moved)]).faults[0]
    assert fault.kind == "shift"
    assert f"u with f is 6 samples {word} against r and y" in fault.mend


def test_command_and_feedforward_of_the_other_sign_are_no_controller(stage, fed):  # type: ignore[no-untyped-def]
    fault = soundness(stage, [_with(fed, u=-fed.u, f=-fed.f)]).faults[0]
    assert fault.kind == "sign"
    assert "flip both" in fault.mend


def test_a_clipped_sensor_beside_a_large_feedforward_is_no_gain(stage, references):  # type: ignore[no-untyped-def]
    """20270130/0034: of a y that had stopped feedback was 5 % of u at any gain, and r and y 82 times."""
    r = references[0]
    push = np.gradient(np.gradient(r, stage.sample_time), stage.sample_time)
    push *= stage.physics.mass / stage.physics.motor_constant
    led = SimulatedMachine(stage).run(r, push, np.random.default_rng(0))
    assert not soundness(stage, [led]).faults
    assert np.std(led.u - led.f) < 0.05 * np.std(led.u)
    (fault,) = soundness(stage, [_with(led, y=np.minimum(led.y, 0.5 * led.y.max()))]).faults
    assert fault.kind == "clipped_sensor"


def test_a_machine_at_rest_is_no_frozen_sensor(stage, record):  # type: ignore[no-untyped-def]
    """Where the stated controller is another one everywhere, and friction holds y between the moves."""
    rests = replace(stage, effects=(EffectSpec("coulomb_friction", {"level": 6.0}),),
                    machine=replace(stage.machine, encoder_resolution=2e-5, sensor_noise=1e-7))  # fmt: skip
    run = record(rests)[0]
    still = np.convolve(np.diff(run.y) == 0.0, np.ones(60), "valid")
    assert still.max() == 60.0
    c = stage.controller.reference
    other = Controller.of_error(replace(c, zeros=1.0 - 1.35 * (1.0 - c.zeros)))
    assert [f.kind for f in soundness(replace(stage, controller=other), [run]).faults] == [
        "controller"
    ]


def test_other_controller_is_named_with_its_factor(stage, clean):  # type: ignore[no-untyped-def]
    c = stage.controller.reference
    other = replace(stage, controller=Controller.of_error(replace(c, gain=c.gain / 1.25)))
    fault = soundness(other, [clean]).faults[0]
    assert fault.kind == "controller"
    assert "1.25 times" in fault.mend


@pytest.mark.parametrize("scale", [1.0 / 0.6, 0.3])
def test_a_command_in_another_unit_is_no_gain_of_the_controller(stage, clean, scale):  # type: ignore[no-untyped-def]
    """A torque in per cent of 60 N m: y moves as much less as u is more than the controller gives."""
    fault = soundness(stage, [_with(clean, u=scale * clean.u)]).faults[0]
    assert (fault.kind, fault.where) == ("unit", "the unit of u")
    assert f"scale = {1.0 / scale:.4g}" in fault.mend


@pytest.mark.parametrize(("noise", "said"), [(0.0, True), (3e-3, False)])
def test_its_gain_is_told_where_feedback_is_little_of_the_command(stage, clean, noise, said):  # type: ignore[no-untyped-def]
    """Of the blind run 20270125, case 0037: f was 99 % of u, a controller of 0.8 times the stated gain left
    1 % of it, and passed for sound. Where u is measured in noise as large it may be that."""
    c = stage.controller.reference
    other = replace(stage, controller=Controller.of_error(replace(c, gain=c.gain / 0.8)))
    rng = np.random.default_rng(0)
    large = 30.0 * np.std(clean.u) * np.sin(0.05 * np.arange(len(clean)))
    shaken = noise * np.std(large) * rng.standard_normal(len(clean))
    fed = _with(clean, f=clean.f + large, u=clean.u + large + shaken)
    found = soundness(other, [fed])
    assert 1e-4 < found.consistency[0] < 0.02
    assert [f.kind for f in found.faults] == ["controller"] * said
    assert all("0.8 times the stated gain" in f.mend for f in found.faults)


@pytest.mark.parametrize(("moved", "said"), [(0.0, True), (6.0, False)])
def test_a_machine_that_never_moved_tells_nothing(stage, clean, moved, said):  # type: ignore[no-untyped-def]
    """y is its sensor's noise: a stage that friction held was a hardening spring, explained with 0.87."""
    noise = stage.machine.sensor_noise
    assert noise > 0.0
    y = noise * np.random.default_rng(3).standard_normal(len(clean))
    y += moved * noise * np.sin(0.01 * np.arange(len(clean)))
    found = soundness(replace(stage, controller=None), [_with(clean, y=y)])
    assert ["unmoved"] * said == [f.kind for f in found.faults]
    large = replace(stage.machine, sensor_noise=2.0 * float(np.std(clean.y)))  # a unit mistaken
    smooth = replace(stage, controller=None, machine=large)
    assert not soundness(smooth, [_with(clean, y=0.5 * clean.y)]).faults
    both = soundness(replace(stage, controller=None), [_with(clean, y=y), clean])
    assert not both.faults  # another recording tells


def test_fault_ends_the_diagnosis(stage, clean):  # type: ignore[no-untyped-def]
    answer = diagnose(stage, [_with(clean, u=-clean.u)]).answer()
    assert answer["verdict"] == "inconclusive"
    assert answer["effects"] == []
    assert "sign of u" in answer["location"]["where"]
    assert answer["advice"]


def test_constant_output_and_too_few_samples_are_inconclusive(stage, clean):  # type: ignore[no-untyped-def]
    still = _with(clean, y=np.zeros(len(clean)))
    assert diagnose(stage, [still]).answer()["verdict"] == "inconclusive"
    assert diagnose(stage, [clean[300:350]]).answer()["verdict"] == "inconclusive"


@pytest.fixture(scope="module")
def held(stage, record):  # type: ignore[no-untyped-def]
    """The stage with a drive that sends no more than half of what is asked for, as made and recorded."""
    limit = 0.5 * float(np.abs(record(stage)[0].u).max())
    limited = replace(stage, machine=replace(stage.machine, command_limit=limit))
    return limited, record(limited)


def test_a_stated_limit_of_the_command_is_no_fault(held):  # type: ignore[no-untyped-def]
    limited, runs = held
    found = soundness(limited, runs)
    assert not found.faults
    assert max(found.consistency) < 1e-6


def test_a_limit_that_nobody_stated_is_said_with_its_mend(stage, held):  # type: ignore[no-untyped-def]
    limited, runs = held
    limit = limited.machine.command_limit
    other = replace(stage, machine=replace(stage.machine, command_limit=1.2 * limit))
    for model in (stage, other):
        (fault,) = soundness(model, runs[:1]).faults
        assert fault.kind == "limit"
        assert f"state command_limit = {limit:.6g} in [machine]" in fault.mend


def test_a_command_recorded_before_the_limit_is_sound_too(held):  # type: ignore[no-untyped-def]
    limited, (run, _) = held
    _, fed_back = feedback_of(limited.controller, run, limited.machine.command_limit)
    assert not soundness(limited, [replace(run, u=run.f + fed_back)]).faults


@pytest.mark.parametrize(
    ("kind", "spoil"),
    [
        ("sign", lambda r: {"y": -r.y}),
        ("unit", lambda r: {"u": 1000.0 * r.u}),
        ("unit", lambda r: {"y": 0.001 * r.y}),
        ("shift", lambda r: {"y": np.concatenate([np.full(7, r.y[0]), r.y[:-7]])}),
    ],
)
def test_faults_are_named_at_the_limit_too(held, kind, spoil):  # type: ignore[no-untyped-def]
    limited, (run, _) = held
    assert [f.kind for f in soundness(limited, [_with(run, **spoil(run))]).faults] == [kind]


def test_controller_states_are_told_by_what_is_below_the_limit(held):  # type: ignore[no-untyped-def]
    """Of a recording that begins at it; what is forgotten before it leaves it counts for nothing."""
    limited, (run, _) = held
    limit = limited.machine.command_limit
    run = run[int(np.argmax(np.abs(run.u) >= limit)) :]
    _, fed_back = feedback_of(limited.controller, run, limit)
    below = np.abs(run.u) < limit
    assert np.sum(~below[:20]) > 10
    assert np.abs(fed_back - run.u)[below].max() < 1e-6 * limit


def test_a_limit_that_is_stated_is_not_found_as_missing(stage, held, record):  # type: ignore[no-untyped-def]
    """What stands behind it is, and is told as large as it is."""
    limited, runs = held
    runs = [run[:2150] for run in runs]
    answer = diagnose(limited, runs[:1], runs[1:]).answer()
    assert (answer["verdict"], answer["effects"]) == ("nothing_missing", [])
    dead = EffectSpec("dead_zone", {"half_width": 0.05})
    runs = [run[:2150] for run in record(replace(limited, effects=(dead,)))]
    answer = diagnose(limited, runs[:1], runs[1:]).answer()
    assert answer["verdict"] == "explained"
    (effect,) = answer["effects"]
    assert effect["name"] == "dead_zone"
    assert effect["parameters"]["half_width"]["value"] == pytest.approx(0.05, rel=0.02)


@pytest.mark.parametrize("late", [0, 1, 3])
def test_a_delay_too_short_for_a_fault_is_noted(stage, late):  # type: ignore[no-untyped-def]
    """Of slow motion a few samples are less than 2 % of the command."""
    t = stage.sample_time * np.arange(6000)
    r = 0.05 * np.sin(2 * np.pi * 0.2 * t) ** 3
    y = np.convolve(r, np.ones(20) / 20)[: len(r)]
    given = as_state_space(stage.controller.reference).filter(r).ravel()
    given = given - as_state_space(stage.controller.output).filter(y).ravel()
    u = np.concatenate([np.zeros(late), given[: len(given) - late]])
    run = Recording.from_signals(stage.sample_time, u=u, y=y, r=r, source="slow.csv")
    found = soundness(stage, [run, run])
    assert not found.faults
    notes = found.notes
    assert len(notes) == (late > 0)
    if late:
        assert f"{late} sample{'s'[: late > 1]} later" in notes[0]
        assert f"{late} pole{'s'[: late > 1]} at 0 more" in notes[0]
    assert not soundness(replace(stage, controller=None), [run]).notes

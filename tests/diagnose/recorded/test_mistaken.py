"""Units, signs and columns that no controller tells are said before any physics."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.hypothesis.corrections import corrections, times_as_much
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.recorded.compared import factor_of
from ffl.diagnose.recorded.mistaken import ALIKE, _held_beside, mistakes, too_large
from ffl.machines import SimulatedMachine
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording
from ffl.systems import EffectSpec, Move, moves
from ffl.systems.plant_file import plant_from_dict

STEP = 0.01
MOTOR = {
    "name": "motor",
    "sample_time": STEP,
    "units": {"input": "V", "output": "rad/s"},
    "plant": {"form": "czpk", "zeros": [], "poles": [-250.0, -4.0], "gain": 20000.0},
}


@pytest.fixture(scope="module")
def motor():
    return plant_from_dict(MOTOR)


@pytest.fixture(scope="module")
def driven(motor):
    """A motor with Coulomb friction and noise, driven in open loop."""
    rng = np.random.default_rng(1)
    u = 3.0 * np.repeat(rng.uniform(-1.0, 1.0, 60), 40)
    y = motor.system.filter(u - 0.01 * np.sign(u)) + 0.05 * rng.standard_normal(len(u))
    return Recording.from_signals(STEP, u=u, y=y, source="run.csv")


@pytest.mark.parametrize(
    ("kind", "spoil", "mend"),
    [
        (None, lambda r: {}, ""),
        ("sign", lambda r: {"y": -r.y}, "flip"),
        ("sign", lambda r: {"u": -r.u}, "flip"),
        ("unit", lambda r: {"y": r.y * 30 / np.pi}, "rpm for rad/s"),
        ("unit", lambda r: {"u": 1e3 * r.u}, "a thousand"),
        ("columns", lambda r: {"y": r.u, "u": r.y}, "exchange u and y"),
    ],
)
def test_open_loop(motor, driven, kind, spoil, mend):
    found = mistakes(motor, [replace(driven, **spoil(driven))])
    assert [f.kind for f in found] == ([kind] if kind else [])
    assert all(mend in f.mend for f in found)


def test_a_factor_is_told_without_the_friction_in_it_and_no_finer_than_it_is_known():
    """Dry friction makes less of y than the inches for metres do, which are 39.4 times as many."""
    made = plant_from_dict(
        {
            "name": "slide",
            "sample_time": STEP,
            "units": {"input": "N", "output": "m"},
            "plant": {"form": "czpk", "zeros": [], "poles": [0.0, -1.75], "gain": 0.125},
            "physics": {"mass": 8.0, "motor_constant": 1.0},
        }
    )
    t, rng = STEP * np.arange(3000), np.random.default_rng(3)
    u = sum(a * np.sin(2 * np.pi * f * t + f) for a, f in ((14.0, 0.31), (9.0, 0.83), (7.0, 1.7)))
    y = Simulator(made).run((EffectSpec("coulomb_friction", {"level": 5.0}),), feedforward=u).y
    y = (y + 1e-6 * rng.standard_normal(len(u))) / 0.0254
    run = Recording.from_signals(STEP, u=u, y=y, source="run.csv")
    alone, left = factor_of(made, u, y)
    assert alone < 33.0
    assert left < ALIKE
    (fault,) = mistakes(made, [run])
    assert "inches for metres?" in fault.mend
    said = fault.mend.split("y is ")[1].split(" times")[0].removeprefix("about ")
    assert float(said) == pytest.approx(39.4, rel=0.05)
    assert "about 23 times" in too_large(23.42, 0.0315)
    assert "about" not in too_large(39.53, 8e-6)
    assert "39.5 times" in too_large(39.53, 8e-6)


def test_what_is_merely_nonlinear_is_no_mistake(motor, driven):
    for y in (np.abs(driven.y), np.clip(driven.y, -20.0, 20.0), 2.2 * driven.y):
        assert not mistakes(motor, [replace(driven, y=y)])


LOST = EffectSpec("dead_zone", {"half_width": 10.0})


@pytest.fixture(scope="module", params=[(), (LOST,)], ids=["drag", "and dead zone"])
def dive(request):
    """85 kg under water and recordings of it: drag makes a fourth of y what the model alone would."""
    made = plant_from_dict(
        {
            "name": "vehicle",
            "sample_time": 0.05,
            "units": {"input": "N", "output": "m"},
            "plant": {"form": "czpk", "zeros": [], "poles": [0.0, -0.35], "gain": 1 / 85.0},
            "physics": {"mass": 85.0, "motor_constant": 1.0},
        }
    )
    drag = EffectSpec("quadratic_drag", {"coefficient": 160.0})
    t = 0.05 * np.arange(3000)
    tones = ((40.0, 0.031, 0.2), (30.0, 0.083, 1.1), (30.0, 0.17, 2.3))
    u = sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in tones)
    rng = np.random.default_rng(0)
    y = Simulator(made).run((*request.param, drag), feedforward=u).y + 0.002 * rng.standard_normal(
        len(u)
    )
    return made, Recording.from_signals(0.05, u=u, y=y, source="dive.csv")


def test_drag_is_no_wrong_gain(dive):
    """0.3 times what the model makes of u, and out of proportion: y hardly grows where u does."""
    made, run = dive
    factor, left = factor_of(made, run.u, run.y)
    assert factor < 1 / 3
    assert left < ALIKE
    assert not mistakes(made, [run])


@pytest.mark.parametrize("spoil", [lambda r: {"u": 1e3 * r.u}, lambda r: {"y": 1e-3 * r.y}])
def test_a_wrong_unit_beside_drag_is_one(dive, spoil):
    made, run = dive
    assert [f.kind for f in mistakes(made, [replace(run, **spoil(run))])] == ["unit"]


def test_units_of_the_header_against_those_of_the_plant_file(stage, record):  # type: ignore[no-untyped-def]
    clean = record(stage)[0]
    for units, said in (
        ({"y": "mm", "r": "mm"}, "y and r in mm, the plant file in m: give scale = 0.001"),
        ({"u": "mA"}, "u in mA, the plant file in A: give scale = 0.001"),
        ({"y": "m", "u": "A"}, ""),
        ({"y": "counts", "u": "V"}, ""),
    ):
        found = mistakes(stage, [replace(clean, units=units)])
        assert len(found) == bool(said)
        assert all(said in f.mend for f in found)


def test_a_gain_no_machine_is_off_by_is_no_mass(stage, record):  # type: ignore[no-untyped-def]
    """The controller is right and the loop stable: only the plant's gain is ten times too large."""
    runs = record(stage)
    system = replace(stage.system, gain=8.0 * stage.system.gain)
    answer = diagnose(replace(stage, system=system), runs[:1], runs[1:]).answer()
    assert answer["verdict"] == "inconclusive"
    assert answer["effects"] == []
    assert "the plant's gain" in answer["location"]["where"]
    assert "y is 0.125 times what the model makes of u: check the gain" in answer["advice"][0]


def test_what_a_mass_and_its_change_come_to(stage):  # type: ignore[no-untyped-def]
    base = Base.of(stage, 0.1)
    change = EffectSpec("mass_change", {"change": 1.0})
    model = Model(base, corrections={"mass": 0.25}, effects=(change,))
    assert times_as_much(SimpleNamespace(model=model)) == pytest.approx(0.4)
    assert times_as_much(SimpleNamespace(model=Model(base))) == 1.0


def test_a_number_at_its_bound_is_no_measurement(stage):  # type: ignore[no-untyped-def]
    base = Base.of(stage, 0.1)
    model = Model(base)
    mass = next(c for c in model.coordinates if c.name == "mass")
    for value, error in ((mass.lower, None), (0.5, 0.01)):
        standing = SimpleNamespace(
            model=replace(model, corrections={"mass": value}),
            spread=np.full(len(model.theta), 0.01),
        )
        (found,) = corrections(standing)
        assert (found.name, found.relative, found.std_error) == ("mass", value, error)


@pytest.mark.parametrize("limit", [0.1, 0.4])
def test_a_drive_behind_which_the_controller_winds_up_is_no_wrong_unit(stage, record, limit):  # type: ignore[no-untyped-def]
    """The command goes to 130 A and more, of which the drive lets 0.1 through: y is a thousandth of what
    the model makes of u. A wrong unit of y leaves nothing else (20261216/0021)."""
    narrow = replace(stage, effects=(EffectSpec("saturation", {"limit": limit}),))
    run, _ = record(narrow)
    factor, _ = factor_of(stage, run.u, run.y)
    assert factor < 0.01
    assert mistakes(stage, [run]) == ()
    plain, _ = record(stage)
    (fault,) = mistakes(stage, [replace(plain, y=1e-3 * plain.y)])
    assert fault.kind == "unit"


def test_a_bearing_that_pushes_is_no_wrong_unit(stage, record):  # type: ignore[no-untyped-def]
    """The command holds what the magnets push: y is a tenth, or less, of what the model makes of it. Such
    a machine is named (a reviewer's magnetic bearing was refused)."""
    push = EffectSpec("linear_stiffness", {"stiffness": -6.0e3, "centre": 0.0})
    run, other = (r[:2150] for r in record(replace(stage, effects=(push,))))
    factor, _ = factor_of(stage, run.u, run.y)
    assert factor < 0.1
    assert mistakes(stage, [run]) == ()
    answer = diagnose(stage, [run], [other]).answer()
    assert [e["name"] for e in answer["effects"]] == ["linear_stiffness"]
    stiffness = answer["effects"][0]["parameters"]["stiffness"]["value"]
    assert stiffness == pytest.approx(-6.0e3, rel=1e-3)
    assert "negative stiffness" in answer["effects"][0]["says"]


@pytest.mark.parametrize(
    ("factor", "others", "kept"),
    [
        (0.2, "alike", True),  # the others say nothing against it
        (0.2, "unlike", False),  # of the others no factor explains y: nor does one here
        (0.01, "unlike", True),  # further off than friction makes anything
        (0.2, "none", True),
        (
            0.2,
            "smaller",
            False,
        ),  # another factor: friction takes more of small moves than of large ones
        (0.2, "as small", True),  # the same factor throughout
        (0.01, "smaller", True),
    ],
)
def test_a_factor_that_other_recordings_do_not_bear_out_is_none(
    motor, driven, factor, others, kept
):
    first = replace(driven, y=factor * driven.y)
    shaken = np.random.default_rng(2).standard_normal(len(driven))
    other = {
        "alike": [driven],
        "unlike": [replace(driven, y=shaken)],
        "none": [],
        "smaller": [replace(driven, y=0.4 * factor * driven.y)],
        "as small": [replace(driven, y=0.9 * factor * driven.y)],
    }[others]
    other = [replace(r, source=f"other_{k}.csv") for k, r in enumerate(other)]
    found = mistakes(motor, [first, *other])
    assert [fault.kind for fault in found if fault.recording == "run.csv"] == ["unit"] * kept


def test_a_machine_that_friction_holds_is_no_wrong_unit():
    """Nearly all of the command goes into friction, and into what it holds while the machine stands: y is
    some hundredths of what the model makes of u (a reviewer's syringe pump was refused)."""
    pump = plant_from_dict(
        {
            "name": "pump",
            "sample_time": 0.002,
            "units": {"input": "N", "output": "m"},
            "plant": {"form": "czpk", "zeros": [], "poles": [0.0, -20.0], "gain": 0.1667},
            "controller": {
                "form": "zpk", "zeros": [0.9934, 0.9603], "poles": [1.0, 0.6], "gain": 79026.0,
            },
            "physics": {"mass": 6.0, "motor_constant": 1.0},
            "machine": {"encoder_resolution": 1e-6, "sensor_noise": 4e-7},
        }
    )  # fmt: skip
    machine = replace(pump, effects=(EffectSpec("coulomb_friction", {"level": 9.0}),))
    steps = [Move(0.3 + 2.0 * k, 0.004 * s, 0.003, 0.02, 1.0) for k, s in enumerate((1, -1, 1))]
    r = moves(steps, 6.5, 0.002)
    run = SimulatedMachine(machine).run(r, np.zeros_like(r), np.random.default_rng(1))
    factor, _ = factor_of(pump, run.u, run.y)
    assert factor < 0.1
    assert mistakes(pump, [run]) == ()
    plain = SimulatedMachine(pump).run(r, np.zeros_like(r), np.random.default_rng(1))
    (fault,) = mistakes(pump, [replace(plain, y=0.02 * plain.y)])
    assert fault.kind == "unit"


@pytest.fixture(scope="module")
def conveyor():
    """40 kg that Stribeck friction holds, moved by a controller that nobody states; its plant file."""
    servo = {
        "name": "conveyor", "sample_time": 0.005, "units": {"input": "N", "output": "m"},
        "plant": {"form": "czpk", "zeros": [], "poles": [0.0, -0.3], "gain": 0.025},
        "controller": {"form": "zpk", "zeros": [0.97], "poles": [0.4], "gain": 4.0e5},
        "effects": [{"name": "stribeck_friction", "parameters": {
            "coulomb_level": 18.0, "static_level": 26.0, "stribeck_velocity": 0.03}}],
    }  # fmt: skip
    machine = plant_from_dict(servo)
    there = moves([Move(0.5, 0.5, 0.4, 0.8, 8.0), Move(5.0, -0.3, 0.4, 0.8, 8.0)], 10.0, 0.005)
    run = SimulatedMachine(machine).run(there, np.zeros_like(there), np.random.default_rng(2))
    return replace(machine, controller=None, effects=()), run


@pytest.mark.parametrize("turned", ["u", "y", ""])
def test_a_sign_beside_friction_that_takes_half_of_the_command(conveyor, turned):
    plant, run = conveyor
    run = Recording.from_signals(0.005, u=run.u, y=run.y, source="belt.csv")
    if turned:
        run = replace(run, **{turned: -getattr(run, turned)})
    found = mistakes(plant, [run])
    assert [f.kind for f in found] == (["sign"] if turned else [])
    assert all("flip y or u" in f.mend for f in found)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_sign_beside_friction_that_holds_a_crane_between_its_moves(sign):
    """A controller that nobody states winds up against it: all of that command goes into standstill."""
    servo = {
        "name": "crane", "sample_time": 0.004, "units": {"input": "N m", "output": "deg"},
        "plant": {"form": "czpk", "zeros": [], "poles": [0.0, -1.9], "gain": 27.0},
        "controller": {"form": "zpk", "zeros": [0.985, 0.97], "poles": [1.0, 0.8], "gain": 3.2},
        "effects": [{"name": "coulomb_friction", "parameters": {"level": 6.0}}],
    }  # fmt: skip
    crane = plant_from_dict(servo)
    steps = [
        Move(0.5 + 2.0 * k, 8.0 * s, 20.0, 60.0, 600.0) for k, s in enumerate((1, -1, 1, 1, -1))
    ]
    there = moves(steps, 10.5, 0.004)
    run = SimulatedMachine(crane).run(there, np.zeros_like(there), np.random.default_rng(3))
    run = Recording.from_signals(0.004, u=run.u, y=sign * run.y, source="crane.csv")
    plant = replace(crane, controller=None, effects=())
    assert factor_of(plant, run.u, run.y)[1] > ALIKE
    assert [f.kind for f in mistakes(plant, [run])] == (["sign"] if sign < 0.0 else [])
    assert _held_beside(plant, run.u, run.y, sign)[1] < 0.01


@pytest.mark.parametrize(
    ("scale", "says"), [(1000.0, "times what"), (57.29578, "times what"), (1.0, None)]
)
def test_a_unit_beside_friction_that_takes_half_of_the_command(conveyor, scale, says):
    plant, run = conveyor
    run = Recording.from_signals(0.005, u=run.u, y=scale * run.y, source="belt.csv")
    found = mistakes(plant, [run])
    assert [f.kind for f in found] == ([] if says is None else ["unit"])
    assert all("load aside" in f.mend and says in f.mend for f in found)


@pytest.mark.parametrize(("scale", "says"), [(1000.0, True), (1.0, False)])
def test_a_unit_of_what_hangs(conveyor, scale, says):
    """The command holds 500 N up and moves it beside."""
    plant, run = conveyor
    hangs = Recording.from_signals(0.005, u=run.u + 500.0, y=scale * run.y, source="lift.csv")
    assert [f.kind for f in mistakes(plant, [hangs])] == ["unit"] * says

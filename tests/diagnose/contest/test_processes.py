"""Machines other than servo stages: speeds, folded and clipped sensors, slow and static loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from ffl.diagnose import diagnose
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.recorded.clip import clipping
from ffl.diagnose.recorded.signs import looks_folded
from ffl.diagnose.recorded.states import State, goes_with
from ffl.diagnose.recorded.trials import stretches
from ffl.diagnose.recorded.unfold import learned_anew
from ffl.effects import EFFECTS, is_speed, mechanics_of
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording
from ffl.recordings.sampling import examine_time
from ffl.systems import Controller, Plant
from ffl.systems.plant import EffectSpec, Imperfections, Physics
from ffl.systems.zpk import Zpk


def open_loop(u: np.ndarray, y: np.ndarray, step: float) -> Recording:
    t = step * np.arange(len(u))
    return Recording(
        t=t, r=np.zeros_like(u), f=u, u=u, y=y, d=None, sample_time=step, source="made here"
    )


@pytest.mark.parametrize(
    "unit", ["rpm", "rad/s", "m/s", "ticks/s", "mm / s", "1/min", "kn", "km/h", "m s^-1"]
)
def test_speeds_are_known_by_their_unit(unit):
    assert is_speed(unit)
    assert not is_speed("m")
    assert not is_speed("m^3/s")
    assert not is_speed("kN")
    assert not is_speed("")


def test_drag_of_what_moves_at_a_measured_speed_is_told_in_that_speed():
    ship = Plant("ship", Zpk([], [0.9], 0.1, 1.0), None, "kN", "kn")
    (drag,) = EFFECTS["quadratic_drag"].parameters
    assert drag.unit_in(ship) == "kN/(kn)^2"


def test_what_turns_is_driven_in_newton_metres():
    level, stiffness = EFFECTS["coulomb_friction"].parameters[0], EFFECTS["linear_stiffness"]
    system = Zpk([-1.0], [1.0, 1.0], 1e-6, 1e-3)
    joint = Plant("joint", system, None, "N m", "rad", physics=Physics(1.2, 1.0))
    assert level.unit_in(joint) == "N m"
    assert stiffness.parameter("stiffness").unit_in(joint) == "N m/rad"
    assert level.unit_in(replace(joint, output_unit="deg/s")) == "N m"
    assert level.unit_in(replace(joint, output_unit="m")) == "N"
    assert level.unit_in(replace(joint, physics=Physics(1.2, None), input_unit="A")) == "A"


def test_dry_friction_stops_a_motor_whose_speed_is_measured():
    """dw/dt = -level b sign(w): from w0 it stops at w0/(level b) and stays."""
    step, gain = 0.01, 2.0
    plant = Plant("motor", Zpk([], [1.0], gain * step, step), input_unit="A", output_unit="rad/s")
    friction = EffectSpec("coulomb_friction", {"level": 0.5})
    run = Simulator(plant).run((friction,), feedforward=np.zeros(300), start=[1.5 / (gain * step)])
    expected = np.maximum(1.5 - 0.5 * gain * step * np.arange(300), 0.0)
    np.testing.assert_allclose(run.y, expected, atol=1e-9)
    np.testing.assert_allclose(run.v, expected, atol=1e-9)


def test_a_speed_has_the_linear_response_of_its_plant():
    """The integral that forces need changes nothing of the linear part."""
    rng = np.random.default_rng(1)
    system = Zpk([0.3], [0.9, 0.8 + 0.3j, 0.8 - 0.3j], 0.1, 0.01)
    u = rng.standard_normal(200)
    for unit in ("rpm", "m"):
        run = Simulator(Plant("p", system, output_unit=unit)).run((), feedforward=u)
        np.testing.assert_allclose(run.y, system.state_space().filter(u), atol=1e-10)
    assert mechanics_of(system, True).own == mechanics_of(system).order


def test_a_folded_output_gives_its_linear_part_back():
    rng = np.random.default_rng(2)
    step = 0.02
    true = Zpk([], [0.85, 0.8 + 0.4j, 0.8 - 0.4j], 0.02, step)
    u = np.repeat(rng.uniform(-1.0, 1.0, 60), 20)
    y = np.abs(true.state_space().filter(u)) + 1e-3 * rng.standard_normal(len(u))
    recording = open_loop(u, y, step)
    wrong = Plant("wrong", Zpk([], [0.9, 0.97 + 0.1j, 0.97 - 0.1j], 0.01, step))
    assert looks_folded(wrong, [recording])
    assert not looks_folded(wrong, [replace(recording, y=y + 0.5)])
    found = learned_anew(wrong, [recording[:800]])
    assert found is not None
    poles = np.sort_complex(found.system.poles)
    np.testing.assert_allclose(poles, np.sort_complex(true.poles), atol=0.02)


def test_clipping_shows_by_standing_at_one_value_while_the_drive_moves():
    t = np.arange(400)
    u = np.sin(0.05 * t) + 0.01 * np.sin(1.3 * t)
    y = np.clip(u, -0.8, 0.8)
    plant = Plant("p", Zpk([], [0.5], 0.5, 1.0))
    found = clipping(plant, [open_loop(u, y, 1.0)])
    assert found is not None
    assert found.parameters == {"kind": "clipping", "level": 0.8}
    assert clipping(plant, [open_loop(u, u, 1.0)]) is None
    loop = replace(plant, controller=Controller.of_error(Zpk([], [], 1.0, 1.0)))
    assert clipping(loop, [open_loop(u, y, 1.0)]) is None


def test_clipping_shows_while_the_command_stands_and_the_stage_rings_on():
    u = np.repeat([0.0, 1.0, -0.9, 0.8, -1.0], 300)
    ringing = Plant("p", Zpk([], [0.99 + 0.1j, 0.99 - 0.1j], 0.0101, 1.0))
    y = ringing.system.state_space().filter(u)
    level = 0.8 * np.abs(y).max()
    found = clipping(ringing, [open_loop(u, np.clip(y, -level, level), 1.0)])
    assert found is not None
    assert found.parameters["level"] == pytest.approx(level)
    assert clipping(ringing, [open_loop(u, y, 1.0)]) is None
    quick = Plant(
        "p", Zpk([], [0.1], 0.9, 1.0)
    )  # it stands where its command does, at full speed before
    ramps = np.clip(np.cumsum(np.repeat([0.1, -0.1, 0.1, -0.1], 100)), 0.0, 4.0)
    assert (
        clipping(quick, [open_loop(ramps, quick.system.state_space().filter(ramps), 1.0)]) is None
    )


def test_slow_process_with_a_dead_zone():
    """2 s sampling, two lags, an operating point: nothing of it may depend on 1 kHz."""
    rng = np.random.default_rng(3)
    step = 2.0
    system = Zpk([-0.9], [0.93, 0.975], 6e-4, step)
    load = EffectSpec("constant_load", {"force": 30.0})
    plant = Plant("oven", system, input_unit="%", output_unit="degC", effects=(load,))
    simulator = Simulator(plant)
    dead = EffectSpec("dead_zone", {"half_width": 6.0})
    made = []
    for _ in range(2):
        u = np.repeat(rng.uniform(-30.0, 30.0, 50), 40)
        y = simulator.run((dead, load), feedforward=u, start=_rest(simulator, 30.0)).y
        made.append(open_loop(u, y + 0.01 * rng.standard_normal(len(u)), step))
    assert [c.name for c in Base.of(plant).corrections] == ["mass", "damping", "apart"]
    answer = diagnose(plant, made[:1], made[1:]).answer()
    assert [e["name"] for e in answer["effects"]][:1] == ["dead_zone"]
    assert answer["effects"][0]["parameters"]["half_width"]["value"] == pytest.approx(6.0, rel=0.03)


def test_a_valve_that_sticks():
    """The stem simulated here; what the command does is found out, and how far it must go."""
    rng = np.random.default_rng(4)
    system = Zpk([-0.9], [0.88, 0.7], 0.02, 10.0)
    plant = Plant("flow", system, input_unit="%", output_unit="m3/h")
    made = []
    for n in (900, 700):
        wave = np.cumsum(rng.standard_normal(n))
        u = 20.0 * np.sin(2 * np.pi * np.arange(n) / 140) + 0.7 * (wave - wave.mean())
        stem, at = np.zeros(n), u[0]
        for k in range(n):
            at = u[k] if abs(u[k] - at) > 3.0 else at
            stem[k] = at
        made.append(open_loop(u, system.filter(stem) + 0.02 * rng.standard_normal(n), 10.0))
    answer = diagnose(plant, made[:1], made[1:]).answer()
    (found,) = answer["effects"]
    assert (answer["verdict"], found["name"]) == ("explained", "valve_stiction")
    band = found["parameters"]["band"]
    assert band["value"] == pytest.approx(3.0, rel=0.03)
    assert 0.0 < band["std_error"] < 0.03  # by moving it until more is left: fits of it go in jumps
    assert abs(band["value"] - 3.0) < 3.0 * band["std_error"]


@pytest.mark.parametrize("steps", [False, True])
def test_a_valve_that_sticks_within_its_loop(steps):
    """A run of the loop by itself soon jumps at other moments; the command as recorded tells its band.
    `steps`: between them the loop swings for ever, and nobody states the noise."""
    rng = np.random.default_rng(11 if steps else 8)
    step, band = 0.5, 1.0
    system = Zpk([-0.98], np.exp([-step / 6.0, -step / 20.0]), 2.0e-3 / 1.98, step)
    pi = Zpk([0.98], [1.0], 1.5, step)
    noise = Imperfections() if steps else Imperfections(sensor_noise=0.02, force_noise=0.05)
    coarse = 0.05 if steps else 1e-9
    plant = Plant(
        "level", system, Controller.of_error(pi), input_unit="%", output_unit="%", machine=noise
    )
    a, b, c, _ = scipy.signal.zpk2ss(system.zeros, system.poles, system.gain)
    made = []
    for n in (3000, 2400):
        waves = rng.uniform(90.0, 300.0, 3)  # seconds
        r = sum(3.0 * np.sin(2 * np.pi * step * np.arange(n) / period) for period in waves)
        r = np.repeat(rng.uniform(-6.0, 6.0, n // 300), 300) if steps else r
        x, at, before = np.zeros((2, 1)), 0.0, (0.0, 0.0)
        y, u = np.zeros(n), np.zeros(n)
        for k in range(n):
            y[k] = coarse * np.round(((c @ x).item() + 0.02 * rng.standard_normal()) / coarse)
            error = r[k] - y[k]
            u[k] = before[1] + 1.5 * (error - 0.98 * before[0])
            before = error, u[k]
            at = u[k] if abs(u[k] - at) > band else at
            x = a @ x + b * (at + 0.05 * rng.standard_normal())
        t = step * np.arange(n)
        made.append(
            Recording(t=t, r=r, f=0.0 * r, u=u, y=y, d=None, sample_time=step, source="made here")
        )
    answer = diagnose(plant, made[:1], made[1:]).answer()
    (found,) = answer["effects"]
    assert (answer["verdict"], found["name"]) == ("explained", "valve_stiction")
    assert found["parameters"]["band"]["value"] == pytest.approx(band, rel=0.01)


def _rest(simulator: Simulator, force: float) -> np.ndarray:
    m = simulator.mechanics
    return np.linalg.solve(m.a, -m.b * force)


def test_effects_of_the_plant_file_run_and_their_numbers_may_be_off():
    plant = Plant(
        "p", Zpk([], [0.9], 0.1, 0.1), effects=(EffectSpec("constant_load", {"force": 1.0}),)
    )
    model = Model(Base.of(plant))
    assert [c.kind for c in model.coordinates] == ["correction", "correction", "given"]
    other = model.at(np.array([0.0, 0.0, 2.0]))
    assert other.plant().effects[0].parameters["force"] == 2.0
    assert model.plant().effects == plant.effects


def test_long_recordings_are_named_from_stretches():
    y = np.zeros(1000)
    short = open_loop(y, y, 1.0)
    assert stretches([short], 1000) == [short]
    parts = stretches([short] * 2, 1000)
    assert len(parts) == 8
    assert sum(len(p) for p in parts) == 2000


def test_stamps_of_seven_digits_are_even():
    t = np.arange(30000) / 12000
    written = np.array([float(f"{x:.7g}") for x in t])
    assert not examine_time(written).faults
    assert examine_time(written + 1e-5 * (np.arange(30000) == 20000)).faults


def test_static_controller_is_checked_and_diagnosed():
    rng = np.random.default_rng(4)
    step, gain = 0.01, 3.0
    t = step * np.arange(1500)
    plant = Plant(
        "axis",
        Zpk([], [1.0], step, step),
        Controller.of_error(Zpk([], [], gain, step)),
    )
    r = np.sin(2 * np.pi * 0.7 * t) + scipy.signal.sawtooth(2 * np.pi * 0.31 * t)
    run = Simulator(plant).run((), r, noise=1e-3 * rng.standard_normal(len(t)))
    recording = Recording(
        t=t, r=r, f=0 * r, u=run.u, y=run.y, d=None, sample_time=step, source="made here"
    )
    answer = diagnose(plant, [recording]).answer()
    assert answer["verdict"] == "nothing_missing"


def test_the_variables_of_what_is_left_follow_from_its_loud_states():
    found = (
        State("high end of the stroke", 2.7),
        State("large commands", 2.6),
        State("forward", 1.2),
    )
    assert goes_with(found) == ("position", "command")


@pytest.mark.slow(20)
def test_a_tank_behind_a_lag_and_under_a_sensor_that_clips():
    """Both are named, with a gain that was off by two thirds and nothing mechanical in their place."""
    step, rng = 4.0, np.random.default_rng(5)

    def tank(n):
        u = np.repeat(rng.uniform(0.8, 4.2, n // 25), 25)
        lag, level, y = u[0], 4.0, np.empty(n)
        for k in range(n):
            y[k] = min(level, 10.0)
            for _ in range(8):
                lag += step / 8 * 0.05 * (u[k] - lag)
                level = max(level + step / 8 * (0.06 * lag - 0.07 * np.sqrt(level)), 0.05)
        return open_loop(u, y + 0.01 * rng.standard_normal(n) * (y < 10.0), step)

    system = Zpk([], [0.82, 0.95], 0.0164 * 0.9, step)
    load = EffectSpec("constant_load", {"force": -1.3})
    model = Plant("tank", system, input_unit="V", output_unit="V", effects=(load,))
    answer = diagnose(model, [tank(800)], [tank(800)]).answer()
    effects = {e["name"]: e["parameters"] for e in answer["effects"]}
    assert list(effects) == ["sensor_nonlinearity", "outflow"]
    assert effects["outflow"]["empty"]["value"] == pytest.approx(0.0, abs=0.05)
    assert answer["validation"]["nrmse_after"] < 1.1 * answer["validation"]["noise_floor"]


def test_one_lag_whose_time_constant_is_off_misses_nothing():
    """It had no number of its own: a cubic spring and a gain by position stood for it, both unsure."""
    rng, step = np.random.default_rng(2), 0.02
    true, stated = (Plant("valve", Zpk([], [p], 25.0 * (1.0 - p), step), None, "bar", "mm")
                    for p in (np.exp(-step / 0.13), np.exp(-step / 0.125)))  # fmt: skip
    runs = []
    for _ in range(3):
        u = np.repeat(rng.uniform(-1.0, 1.0, 40), rng.integers(20, 60, 40))
        y = true.system.filter(u) + 0.02 * rng.standard_normal(len(u))
        runs.append(open_loop(u, y, step))
    answer = diagnose(stated, runs[:2], runs[2:]).answer()
    assert answer["verdict"] == "nothing_missing"
    (slower,) = answer["model_corrections"]
    assert slower["name"] == "time_constant"
    assert slower["relative"] == pytest.approx(0.04, abs=4.0 * slower["std_error"])

"""The free numbers of a hypothesis, and where its effects may act."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.challenge.make import null_case
from ffl.diagnose import diagnose
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.coordinate import LOG_STEP, TURN
from ffl.diagnose.hypothesis.fit import Fit, fit
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.hypothesis.places import drive_places, places_of
from ffl.diagnose.noise.colour import colouring, loop_of
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.proof.conclude import within_a_turn
from ffl.diagnose.recorded.commands import BEYOND, EVERYTHING, PASSES, lets_through, passing
from ffl.diagnose.recorded.trials import prepare
from ffl.diagnose.screen.screen import Screen
from ffl.machines import SimulatedMachine
from ffl.recordings import Recording, read_recording
from ffl.systems import EffectSpec, load_plant

WAVE = EffectSpec("periodic_disturbance", {"amplitude": 1.0, "frequency": 16.0})
RIPPLE = EffectSpec("encoder_ripple", {"amplitude": 1e-6, "period": 1e-3})


def step_of(spec, name, **base):
    model = Model(Base.of(load_plant("emps"), **base), effects=(spec,))
    (found,) = (c for c in model.coordinates if c.name == name)
    return found.step


@pytest.mark.parametrize("until", [4.0, 40.0, 400.0])
def test_a_difference_step_of_a_frequency_turns_the_last_wave_by_little(until):
    """0.4 % of 16 Hz would be 16 rad after 40 s: no derivative at all."""
    turned = 2 * np.pi * 16.0 * until * step_of(WAVE, "frequency", until=until)
    assert turned == pytest.approx(TURN)


def test_a_difference_step_of_a_period_turns_the_last_wave_by_little():
    turned = 2 * np.pi * 0.25 / 1e-3 * step_of(RIPPLE, "period", travel=0.25)
    assert turned == pytest.approx(TURN)
    assert step_of(WAVE, "frequency", until=1e-3) == LOG_STEP


def test_a_limit_and_a_dead_zone_leave_something_of_the_command():
    """Where friction takes most of it a drive that is switched off looked like the friction."""
    u = 3.0 * np.sin(np.linspace(0.0, 60.0, 5000))
    run = Recording.from_signals(1e-3, u=u, y=np.zeros(5000))
    limit, dead = passing([run, run])
    rms = float(np.sqrt(np.mean(u**2)))
    left = np.sign(u) * np.maximum(np.abs(u) - dead, 0.0)
    assert np.sqrt(np.mean(left**2)) == pytest.approx(PASSES * rms, rel=1e-3)
    assert np.mean(np.abs(u) > limit) == pytest.approx(BEYOND, abs=1e-3)
    # A controller that winds up: its commands tell nothing of the limit but that they are beyond it.
    assert passing([replace(run, u=np.where(u > 2.0, 50.0 * u, u))])[0] == pytest.approx(
        limit, rel=1e-3
    )
    assert passing([replace(run, u=np.zeros(5000))]) == EVERYTHING
    base = Base.of(load_plant("emps"), passing=(limit, dead))
    tight = (
        EffectSpec("saturation", {"limit": 2.0 * limit}),
        EffectSpec("dead_zone", {"half_width": 1.0}),
    )
    model = Model(base, effects=tight)
    lowest, widest = (
        next(c for c in model.coordinates if c.name == n) for n in ("limit", "half_width")
    )
    assert np.exp(lowest.lower) == pytest.approx(limit)
    assert widest.upper == dead
    for spec, through in (
        *((EffectSpec("saturation", {"limit": k * limit}), k > 1.1) for k in (0.5, 1.01, 1.2)),
        *((EffectSpec("dead_zone", {"half_width": k * dead}), k < 0.9) for k in (0.5, 0.99, 1.2)),
        (EffectSpec("constant_load", {"force": 0.0}), True),
    ):
        assert lets_through(spec, (limit, dead)) == through
        assert lets_through(spec, EVERYTHING)


@pytest.mark.parametrize(
    ("plant", "collocated", "apart"),
    [("emps", True, False), ("kernel2018_loop", True, True), ("flatbed_printer", True, True)],
)
def test_several_modes_may_be_driven_and_measured_at_two_points(plant, collocated, apart):
    ratios = {p.mass_ratio for p in places_of(Model(Base.of(load_plant(plant))))}
    assert (None in ratios) is collocated
    assert (1.0 in ratios) is apart


@pytest.mark.parametrize(
    ("plant", "ratios"),
    [("emps", [None]), ("kernel2018_loop", [None, 1.0]), ("flatbed_printer", [None, 1.0])],
)
def test_a_drive_feels_the_motion_where_it_pushes(plant, ratios):
    found = drive_places(Model(Base.of(load_plant(plant))))
    assert [p.mass_ratio for p in found] == ratios
    assert all(p.port == "command" for p in found)


def test_a_gain_by_position_is_screened_at_the_drive_that_has_it():
    """Of a printer's three modes the head moves otherwise than the motor, whose position it is."""
    plant = load_plant("flatbed_printer")
    step = plant.sample_time
    bent = {"linear_coefficient": 2.0, "quadratic_coefficient": -60.0, "centre": 0.02}
    gain = EffectSpec("position_dependent_gain", bent, {"side": "motor", "mass_ratio": 1.0})
    t = step * np.arange(4000)
    reference = 0.03 * (1.0 - np.cos(2 * np.pi * 0.7 * t)) * np.minimum(t, 1.0)
    machine = SimulatedMachine(replace(plant, effects=(gain,)))
    run = machine.run(reference, np.zeros_like(reference), np.random.default_rng(1))
    base = Base.of(plant, float(np.ptp(run.y)))
    trial = prepare(base.simulator, run, plant.machine.sensor_noise)
    scene = Scene(plant.loop, (trial,), Noise(plant.machine.sensor_noise or 1e-7, 1e-3))
    found = Screen(scene, fit(scene, Model(base), rounds=0)).candidates([gain.name])
    gains = {c.place.mass_ratio: c.gain for c in found}
    assert gains[1.0] > gains[None]


def test_what_corrections_gain_that_are_open_is_not_an_effect(tmp_path):
    """A judging multisine excites a mode whose damping the fitted recordings leave open."""
    null_case(31, 151).save(tmp_path)
    plant = load_plant(tmp_path / "plant.toml")
    fitted, judging = (
        [read_recording(f, sample_time=plant.sample_time) for f in sorted(tmp_path.glob(name))]
        for name in ("fit_*.csv", "validate_*.csv")
    )
    answer = diagnose(plant, fitted, judging, rng=np.random.default_rng(0)).answer()
    assert answer["verdict"] == "nothing_missing"


def test_a_direction_in_which_a_run_overflows_is_not_known(stage):
    model, rng = Model(Base.of(stage)), np.random.default_rng(0)
    columns = rng.standard_normal((200, len(model.coordinates)))
    columns[7, 0] = np.inf
    spread = Fit(model, rng.standard_normal(200), columns, columns, "converged").spread
    assert spread[0] > 1e9
    assert np.all(spread[1:] < 1.0)


def test_noise_is_coloured_by_the_loop_as_it_stands(two_masses):  # type: ignore[no-untyped-def]
    base = Base.of(two_masses)
    assert colouring(Model(base), 1.0) is two_masses.loop
    moved = colouring(Model(base, {"mode_1_frequency": 0.05}), 1.0)
    nearly = colouring(Model(base, {"mode_1_frequency": 1e-9}), 1.0)
    f = np.linspace(1.0, 90.0, 2000)
    stated, same, other = (
        np.abs(loop.process_sensitivity.response(f)) for loop in (two_masses.loop, nearly, moved)
    )
    np.testing.assert_allclose(same, stated, rtol=1e-5)
    away = f[f > 30.0]
    peaks = [away[np.argmax(x[f > 30.0])] for x in (stated, other)]
    assert peaks[1] / peaks[0] == pytest.approx(1.05, abs=0.01)


def test_a_loop_that_runs_away_colours_nothing(two_masses):  # type: ignore[no-untyped-def]
    base = Base.of(two_masses)
    gone = Model(base, {"damping": -1e4})
    assert loop_of(gone) is two_masses.loop


def test_numbers_that_nobody_mistakes_so_much_colour_nothing(two_masses):  # type: ignore[no-untyped-def]
    base = Base.of(two_masses)
    assert colouring(Model(base, {"mass": 0.5}), 1.5) is two_masses.loop
    assert colouring(Model(base, {"mass": 0.05}), 1.5) is not two_masses.loop
    assert colouring(Model(base, {"mass": 0.05}), 5.0) is two_masses.loop


def test_what_leaves_nothing_but_noise_colours_it_however_far_the_stated_is(two_masses):  # type: ignore[no-untyped-def]
    base = Base.of(two_masses)
    assert colouring(Model(base, {"mass": 0.5}), 1.1) is not two_masses.loop
    quiet = replace(
        two_masses, machine=replace(two_masses.machine, sensor_noise=0.0, force_noise=0.0)
    )
    assert (
        colouring(Model(Base.of(quiet), {"mass": 0.5}), 1.1) is quiet.loop
    )  # noise is what is left


def test_a_phase_is_told_within_a_turn():
    base = Base.of(load_plant("emps"), travel=0.2)
    values = {"amplitude": 1.0, "period": 0.02, "phase": 32.4, "amplitude_2": 0.3, "phase_2": -7.0}
    model = Model(base, effects=(EffectSpec("cogging", values), WAVE))
    told = within_a_turn(model).effects[0].parameters
    for name in ("phase", "phase_2"):
        assert abs(told[name]) <= np.pi
        assert np.sin(told[name]) == pytest.approx(np.sin(values[name]), abs=1e-12)
    assert {k: v for k, v in told.items() if "phase" not in k} == {
        k: v for k, v in values.items() if "phase" not in k
    }


def test_a_number_that_came_off_zero_keeps_its_unit():
    """What is fitted as it is, from none on, is a logarithm to a model made of it anew: its error was told
    that many times too small, and a fit that settled its sub-steps went on at exp(0.02)."""
    friction = {"level": 2.0, "stiffness": 1e5, "micro_damping": 0.0}
    ripple = {"amplitude": 1e-6, "period": 1e-3, "phase": 7.0}
    effects = (EffectSpec("presliding_friction", friction), EffectSpec("encoder_ripple", ripple))
    model = Model(Base.of(load_plant("emps"), travel=0.2), effects=effects)
    at = [c.name for c in model.coordinates].index("micro_damping")
    theta = model.theta.copy()
    theta[at] = 3.0
    off = model.at(theta)
    assert not model.coordinates[at].log
    assert replace(off).coordinates[at].log  # what it would be anew
    for same in (off.resettled(), within_a_turn(off)):
        assert same.coordinates == model.coordinates
        assert same.at(same.theta).effects[0].parameters["micro_damping"] == pytest.approx(3.0)


@pytest.mark.parametrize(
    "stated",
    [
        EffectSpec(
            "hysteresis", {"force": 1.2, "displacement": 1e-4, "exponent": 1.0, "beta": 0.5}
        ),
        EffectSpec("presliding_friction", {"level": 2.0, "stiffness": 10.0}),
        EffectSpec("backlash", {"gap": 1e-9}),
    ],
    ids=lambda spec: spec.name,
)
def test_what_a_plant_file_states_stands_wherever_it_would_be_looked_for(stated):
    """Numbers outside the bounds of a search jumped onto them with the first step of a fit."""
    plant = replace(load_plant("emps"), effects=(stated,))
    model = Model(Base.of(plant, 0.24, 25.0))
    again = model.at(model.theta)
    for name, value in stated.parameters.items():
        assert again.stated[0].parameters[name] == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(("kind", "free"), [("clipping", ["level"]), ("rectified", [])])
def test_what_does_nothing_in_a_form_is_no_number_of_it(stage, kind, free):
    """A sensor blind to the sign has no level: found by 7,200 of log-likelihood it was not told, "of no
    size" (20261215/0016)."""
    spec = EffectSpec("sensor_nonlinearity", {"kind": kind, "level": 0.01})
    model = Model(Base.of(stage)).with_effect(spec)
    assert [c.name for c in model.coordinates if c.kind == "effect"] == free


def test_a_logarithm_at_its_bound_is_within_it(stage):
    """exp(log(10)) is 10.000000000000002, which no hysteresis takes."""
    base = Base.of(stage, 0.05)
    values = {"force": 1.0, "displacement": 1e-3, "exponent": 1.0, "beta": 9.0}
    spec = EffectSpec("hysteresis", values, {"kind": "hardening"})
    model = Model(base, {}, (spec,))
    theta = model.theta
    at = [c.name for c in model.coordinates].index("beta")
    theta[at] = np.inf
    assert model.at(theta).effects[0].parameters["beta"] <= 10.0


@pytest.mark.parametrize(
    ("name", "parameter", "numbers"),
    [
        ("hysteresis", "displacement", {"force": 0.35, "displacement": 2e-3}),
        ("presliding_friction", "stiffness", {"level": 0.35, "stiffness": 900.0}),
    ],
)
def test_a_loop_and_a_contact_are_told_apart_by_the_travel_that_is_learned_from(
    stage, name, parameter, numbers
):  # type: ignore[no-untyped-def]
    """20270109/0141: 34 mm were fitted, 135 mm judged, and the loop of 2 mm was out of bounds."""
    far = Base.of(stage, 0.135)
    for base, longest in ((far, 0.025 * 0.135), (replace(far, learned=0.034), 0.025 * 0.034)):
        model = Model(base, effects=(EffectSpec(name, numbers),))
        lower = next(c.lower for c in model.coordinates if c.name == parameter)
        least = longest if name == "hysteresis" else numbers["level"] / (1.4 * longest)
        wanted = max(np.log(least), np.log(numbers[parameter]) - 3.0)
        assert lower == pytest.approx(wanted, abs=1e-6)


def test_a_contact_whose_level_begins_at_nothing_is_as_soft_as_may_be(stage):  # type: ignore[no-untyped-def]
    """In the place of a friction that had vanished at speed: warned of a logarithm of 0 (7428/0002)."""
    spec = EffectSpec("presliding_friction", {"level": 0.0, "stiffness": 900.0})
    (stiffness,) = (
        c for c in Model(Base.of(stage, 0.1), effects=(spec,)).coordinates if c.name == "stiffness"
    )
    assert stiffness.lower == pytest.approx(np.log(900.0) - 3.0, abs=1e-6)

"""Two encoders on one transmission: stiffness, play, delay, ripple and nothing, on a machine of two
masses stepped by plain Euler; what cannot be told, and what is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numba import njit
from scipy.interpolate import CubicSpline

from ffl.diagnose import diagnose
from ffl.diagnose.transmission.transmission import transmission
from ffl.errors import InputError
from ffl.recordings import Recording
from ffl.report.diagnosis import page_of, print_answer
from ffl.systems import Move, Physics, Plant, Zpk, moves

STEP, FINE = 0.001, 40
MOTOR, LOAD = 2.0, 6.0  # kg
PLANT = Plant(
    "stage", Zpk([-1.0], [1.0, 1.0], STEP**2 / (2 * (MOTOR + LOAD)), STEP), None, "N", "m",
    "made here", Physics(MOTOR + LOAD, 1.0, LOAD),
)  # fmt: skip
NOISE = 2e-8  # m


@njit(cache=True)
def two_masses(r, d, stiffness, damping, gap, at_motor, at_load, step, fine):
    """Motor, load and command under a PD on the motor; dry friction on either side."""
    n, h = len(r), step / fine
    y, load, u = np.empty(n), np.empty(n), np.empty(n)
    x = v = xl = vl = 0.0
    for k in range(n):
        rate = (r[k] - r[k - 1]) / step if k else 0.0
        y[k], load[k] = x, xl
        force = 8.0e4 * (r[k] - x) + 1.6e3 * (rate - v)
        u[k] = force
        for _ in range(fine):
            e = x - xl
            stretch = e - 0.5 * gap if e > 0.5 * gap else (e + 0.5 * gap if e < -0.5 * gap else 0.0)
            spring = stiffness * stretch + damping * (v - vl) * (1.0 if stretch != 0.0 else 0.0)
            a = (force - spring - at_motor * np.tanh(v / 1e-4)) / MOTOR
            al = (spring + d[k] - at_load * np.tanh(vl / 1e-4)) / LOAD
            v += h * a
            vl += h * al
            x += h * v
            xl += h * vl
    return y, load, u


def path(seed=0, duration=6.0):
    rng = np.random.default_rng(seed)
    total, at, sign = np.zeros(round(duration / STEP)), 0.3, 1.0
    while at < duration - 0.9:
        move = Move(at, sign * rng.uniform(0.02, 0.06), rng.uniform(0.15, 0.3), 4.0, 200.0)
        total += np.asarray(moves([move], duration, STEP))[: len(total)]
        at, sign = at + rng.uniform(0.7, 0.9), -sign
    return total


def record(
    seed=0, stiffness=2e6, damping=200.0, gap=0.0, at_motor=5.0, at_load=0.0, delay=0.0, pull=0.0,
    noise=NOISE, rigid=False, reference=None,
):  # fmt: skip
    """A recording; `pull`: force on the load that goes with position, noted as the known load d."""
    r = path(seed) if reference is None else reference
    d = pull * np.sin(40.0 * r)
    y, load, u = two_masses(r, d, stiffness, damping, gap, at_motor, at_load, STEP, FINE)
    rng = np.random.default_rng(seed + 1000)
    t = STEP * np.arange(len(r))
    load = y if rigid else load
    late = CubicSpline(t, load)(np.clip(t - delay, 0.0, None)) if delay else load
    return Recording.from_signals(
        STEP,
        y=y + noise * rng.standard_normal(len(r)),
        y_load=late + noise * rng.standard_normal(len(r)),
        u=u,
        r=r,
        d=d if pull else None,
    )


def part(found, name):
    return next((p for p in found.parts if p.name == name), None)


def within(figure, truth, sigmas=4.0, share=0.05):
    return abs(figure.value - truth) < max(sigmas * figure.std_error, share * truth)


def test_stiffness_and_delay_of_a_spring():
    found = transmission(PLANT, [record(delay=0.0023)])
    assert {p.name for p in found.parts} == {"torsion", "delay"}
    spring = part(found, "torsion").parameters["stiffness"]
    assert within(spring, 2e6)
    assert spring.unit == "N/m"
    assert within(part(found, "delay").parameters["delay"], 0.0023, share=0.01)
    low, high = found.stiffness
    assert 0.9 * low < 2e6 < 1.1 * high
    assert found.explained > 0.9999
    assert found.explained_by_delay < found.explained
    assert not found.undecided


@pytest.mark.parametrize(("at_motor", "at_load"), [(8.0, 0.0), (0.0, 8.0), (4.0, 4.0)])
def test_stiffness_and_damping_wherever_friction_sits(at_motor, at_load):
    found = transmission(PLANT, [record(at_motor=at_motor, at_load=at_load, pull=30.0)])
    spring = part(found, "torsion")
    assert within(spring.parameters["stiffness"], 2e6)
    assert {p.name for p in found.parts} <= {"torsion", "play"}
    if at_load:
        assert spring.parameters["damping"].value == pytest.approx(200.0, rel=0.5)
    if at_motor and at_load:
        assert within(spring.parameters["friction_behind"], 0.5)
    elif at_load:
        assert "what the motor gives" in spring.says
    else:
        assert "friction acts at the motor" in spring.says


def test_play_between_two_masses_beside_their_spring():
    found = transmission(PLANT, [record(gap=4e-5, at_motor=0.0, at_load=15.0)])
    assert within(part(found, "play").parameters["gap"], 4e-5)
    assert within(part(found, "torsion").parameters["stiffness"], 2e6)
    assert part(found, "delay") is None


def test_play_with_friction_on_both_sides():
    """Neither the load's torque nor the command has the sign that the transmission carries."""
    found = transmission(PLANT, [record(gap=2e-5, at_motor=6.0, at_load=12.0, stiffness=4e6)])
    assert within(part(found, "play").parameters["gap"], 2e-5, share=0.1)
    assert within(part(found, "torsion").parameters["stiffness"], 4e6, share=0.1)
    assert within(part(found, "torsion").parameters["friction_behind"], 2 / 3, share=0.2)


def test_a_ripple_with_position_is_no_spring():
    r = record(rigid=True, delay=1e-3)
    wave = 2e-6 * np.sin(2 * np.pi * r.y_load / 0.008)
    found = transmission(PLANT, [replace(r, y_load=r.y_load + wave)])
    assert {p.name for p in found.parts} == {"ripple", "delay"}
    ripple = part(found, "ripple").parameters
    assert ripple["period"].value == pytest.approx(0.008, rel=0.01)
    assert ripple["amplitude"].value == pytest.approx(2e-6, rel=0.1)


def test_a_ratio_slightly_off_and_held_out_recordings_that_judge():
    rigid = [record(seed, rigid=True) for seed in (0, 1)]
    off = [replace(r, y_load=r.y_load * (1.0 - 3e-4)) for r in rigid]
    found = transmission(PLANT, off[:1], off[1:])
    assert [p.name for p in found.parts] == ["scale"]
    assert within(part(found, "scale").parameters["relative"], 3e-4)
    assert found.judged == off[1].source
    assert found.explained > 0.999


def test_nothing_but_noise_is_said_to_be_nothing():
    for seed in range(4):
        r = record(seed, rigid=True, noise=1e-7)
        found = transmission(PLANT, [r])
        assert found.parts == ()
        assert found.stiffness[1] is None  # no upper bound


def test_shaking_of_one_encoder_is_no_spring():
    """A resonance on y_load alone has e = a/w^2 whatever the stiffness."""
    r = record(rigid=True)
    rng = np.random.default_rng(3)
    shaken = np.zeros(len(r))
    pole = 0.995 * np.exp(2j * np.pi * 9.0 * STEP)
    for k in range(2, len(r)):
        past = 2 * pole.real * shaken[k - 1] - abs(pole) ** 2 * shaken[k - 2]
        shaken[k] = past + rng.standard_normal()
    found = transmission(PLANT, [replace(r, y_load=r.y_load + 2e-6 * shaken / shaken.std())])
    assert part(found, "torsion") is None


def test_one_sine_cannot_tell_a_spring_from_a_scale():
    t = STEP * np.arange(6000)
    sine = 0.03 * np.cos(2 * np.pi * 1.5 * t)
    found = transmission(PLANT, [record(reference=sine - sine[0], at_motor=0.0)])
    assert part(found, "torsion") or part(found, "scale")
    assert any("scale" in line for line in found.undecided)


def test_without_a_stated_mass_the_antiresonance_is_what_can_be_said():
    free = replace(PLANT, physics=Physics())
    found = transmission(free, [record()])
    frequency = part(found, "inertia").parameters["antiresonance"]
    assert frequency.value == pytest.approx(np.sqrt(2e6 / LOAD) / (2 * np.pi), rel=0.03)


def test_no_second_encoder_no_answer():
    assert transmission(PLANT, [replace(record(), y_load=None)]) is None


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda y: 0.0 * y, "y_load is constant at "),
        (lambda y: 1000.0 * y, r"another unit.*scale = 0.001"),
        (lambda y: -y, "wrong sign"),
        (lambda y: np.where(np.arange(len(y)) == 7, np.nan, y), "sample 7, column y_load"),
        (lambda y: np.random.default_rng(0).standard_normal(len(y)), "does not follow y"),
    ],
)
def test_second_encoders_that_cannot_be_compared(change, says):
    r = record()
    with pytest.raises(InputError, match=says):
        transmission(PLANT, [replace(r, y_load=change(r.y_load))])


def test_unequal_length_is_refused():
    r = record()
    with pytest.raises(InputError, match=r"unequal lengths.*y_load 5999"):
        replace(r, y_load=r.y_load[:-1])


def test_the_answer_carries_it_and_says_of_y_what_it_said(monkeypatch, capsys):
    monkeypatch.setattr("ffl.diagnose.diagnosis.SHORTEST", 10**6)  # what is said of y comes at once
    r = record(delay=0.002)
    both, one = diagnose(PLANT, [r]), diagnose(PLANT, [replace(r, y_load=None)])
    page = page_of(both).html()
    assert "Between motor and load" in page
    answer = both.answer()
    said = answer.pop("transmission")
    assert answer == one.answer()
    assert {term["name"] for term in said["terms"]} >= {"delay"}
    assert json.loads(json.dumps(said, allow_nan=False)) == said
    print_answer(both.answer())
    printed = capsys.readouterr().out
    assert "the load's encoder is read 2 ms later" in printed
    assert "N/m" in printed


def scaled(recording, size, turn=None):
    """The same with y in another unit, wrapped at a `turn` of that."""

    def told(x):
        return size * x if turn is None else np.mod(size * x + 0.05 * turn, turn)

    signals = {name: told(getattr(recording, name)) for name in ("r", "y", "y_load")}
    return Recording.from_signals(STEP, u=recording.u, **signals)


def in_unit(unit, size):
    """The plant with y in a unit of which one metre is `size`; a mass stays one, in kg."""
    system = replace(PLANT.system, gain=size * PLANT.system.gain)
    return replace(PLANT, system=system, output_unit=unit)


@pytest.mark.parametrize("dry", [(5.0, 0.0), (4.0, 4.0)])
def test_the_unit_of_the_encoders_is_no_matter(dry):
    """A mass in kg times an acceleration in mm/s^2 is no force in N."""
    recording = record(at_motor=dry[0], at_load=dry[1])
    one = transmission(PLANT, [recording])
    other = transmission(in_unit("mm", 1e3), [scaled(recording, 1e3)])
    own, theirs = (part(found, "torsion").parameters for found in (one, other))
    for name, size in (("stiffness", 1e-3), ("antiresonance", 1.0), ("friction_behind", 1.0)):
        assert (name in own) == (name in theirs)
        if name in own:
            assert theirs[name].value == pytest.approx(size * own[name].value, rel=1e-4)


def test_angles_go_on_over_a_turn_on_both_encoders():
    recording, size = record(), 180.0
    physics = Physics((MOTOR + LOAD) / size, 1.0, LOAD / size)  # kg m^2 per rad of this gear
    plant = replace(in_unit("rad", size), physics=physics)
    whole, wrapped = (
        transmission(plant, [scaled(recording, size, turn)]) for turn in (None, 2.0 * np.pi)
    )
    own, theirs = (part(found, "torsion").parameters["stiffness"] for found in (whole, wrapped))
    assert theirs.value == pytest.approx(own.value, rel=1e-6)
    assert whole.explained == pytest.approx(wrapped.explained, abs=1e-6)


def test_what_judges_must_hold_what_was_fitted_with():
    """A known load, or a command that no controller tells, in the fitted recording alone."""
    fitted, judging = record(pull=30.0), record(seed=3, pull=30.0)
    whole = transmission(PLANT, [fitted], [judging])
    for lacking, name in ((replace(judging, d=None), "load d"), (silent(judging), "command u")):
        found = transmission(PLANT, [fitted], [lacking])
        assert "tenths" in found.judged
        assert found.explained > 0.9 * whole.explained
        assert any(name in note for note in found.notes)


def silent(recording):
    """Without its command."""
    return Recording.from_signals(
        STEP, y=recording.y, y_load=recording.y_load, r=recording.r, d=recording.d
    )

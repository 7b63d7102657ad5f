"""Masses that share a motion otherwise than the plant file has it are no mode that is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
import scipy.signal

from ffl.diagnose import diagnose
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.shares import shares_off
from ffl.diagnose.hypothesis.linear import corrected, corrections_of, damped_together, discrete
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.machines.simulator import Simulator
from ffl.systems import plant_from_dict
from ffl.systems.plant import EffectSpec

MODE = EffectSpec("flexible_mode", {"frequency": 80.0, "damping": 0.02, "mass_fraction": 0.05})


def modal_residues(plant, share):
    """By pole."""
    system = discrete(corrected(Simulator(plant).mechanics, {"mode_1_share": share}))
    poles, vectors = np.linalg.eig(system.a)
    order = np.argsort(np.abs(poles.imag) + 1e-3 * poles.imag)
    out = (system.c.ravel() @ vectors) * np.linalg.solve(vectors, system.b.ravel())
    return poles[order], out[order]


def test_a_share_is_that_of_its_mode_alone(two_masses):
    poles, before = modal_residues(two_masses, 0.0)
    moved, after = modal_residues(two_masses, 0.1)
    assert np.allclose(poles, moved, atol=1e-9)
    times = np.where(np.abs(poles.imag) > 0.1, 1.1, 1.0)
    assert np.allclose(after[2:], (times * before)[2:], rtol=1e-6)
    rests = np.argmin(np.abs(poles - 1.0))
    assert after[rests] == pytest.approx(before[rests], rel=1e-6)
    # What the mode gains at once the rigid body loses: next to nothing here.
    assert after[:2].sum() == pytest.approx(before[:2].sum(), rel=2e-3)


@pytest.mark.parametrize("name", ["mode_1_share", "mode_1_lead"])
def test_y_answers_u_no_sooner_for_a_share_that_is_off(two_masses, name):
    mechanics = Simulator(two_masses).mechanics
    moved = corrected(mechanics, {name: 0.1, "mode_1_frequency": 0.02, "damping": 0.3})
    size = np.linalg.norm(mechanics.c) * np.linalg.norm(mechanics.b)
    assert moved.c @ moved.b == pytest.approx(mechanics.c @ mechanics.b, abs=1e-9 * size)


def car(body=320.0, spring=22e3, damper=1500.0, tyre=190e3, wheel=45.0, **more):  # type: ignore[no-untyped-def]
    """A quarter of a car on a post, N to mm between body and wheel: its damper joins both of its modes."""
    a = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-spring / body, -damper / body, spring / body, damper / body],
            [0.0, 0.0, 0.0, 1.0],
            [spring / wheel, damper / wheel, -(spring + tyre) / wheel, -damper / wheel],
        ]
    )
    zeros = np.sqrt(tyre / (body + wheel)) * np.array([1j, -1j])
    pairs = [[[x.real, x.imag] for x in values] for values in (zeros, np.linalg.eigvals(a))]
    gain = 1e3 * (1.0 / body + 1.0 / wheel)
    return plant_from_dict(
        {
            "name": "car",
            "sample_time": 5e-3,
            "units": {"input": "N", "output": "mm"},
            "plant": {"form": "czpk", "zeros": pairs[0], "poles": pairs[1], "gain": gain},
            "machine": {"encoder_resolution": 0.01, "sensor_noise": 0.02, "force_noise": 3.0},
            **more,
        }
    )


OFF = {"body": 316.8, "spring": 22.22e3, "damper": 1545.0, "tyre": 193.8e3}


def test_seven_numbers_are_all_that_a_car_may_have_otherwise():
    """Its modes are joined by a damper: shares of mode alone leave 1 to 5 % of the change."""
    stated, real = (Simulator(plant).mechanics for plant in (car(), car(**OFF)))
    assert damped_together(stated)
    names = [c.name for c in corrections_of(stated)]
    assert len(names) == 7

    def answer(mechanics):  # type: ignore[no-untyped-def]
        system = discrete(mechanics)
        out, state = [], system.b[:, 0]
        for _ in range(100):
            out.append(float((system.c @ state).item()))
            state = system.a @ state
        return np.array(out)

    wanted = answer(real)
    size = np.abs(wanted).max()

    def left(values):  # type: ignore[no-untyped-def]
        return (answer(corrected(stated, dict(zip(names, values, strict=True)))) - wanted) / size

    found = scipy.optimize.least_squares(
        left, np.full(7, 1e-4), x_scale=0.01, xtol=1e-14, ftol=1e-14
    )
    assert np.abs(found.fun).max() < 1e-9 < 1e-2 < np.abs(left(np.zeros(7))).max()


def test_dampers_that_join_masses_are_known_from_those_that_do_not(two_masses):
    assert not damped_together(Simulator(two_masses).mechanics)
    assert not damped_together(Simulator(car(damper=150.0)).mechanics)


@pytest.mark.usefixtures("no_play_sought")
def test_a_car_whose_numbers_are_slightly_off_misses_nothing():
    """(Without the shares: 5 % less stiffness and a damper.)"""
    rng, n = np.random.default_rng(4), 1200
    t = 5e-3 * np.arange(n)
    device, zero = SimulatedMachine(car(**OFF)), np.zeros(n)
    noises = [scipy.signal.lfilter([0.3], [1.0, -0.7], rng.standard_normal(n)) for _ in range(2)]
    shaken = [400.0 * noises[0], 700.0 * noises[1]]
    steps = 500.0 * np.sign(np.sin(1.5 * t)) + 200.0 * np.sin(2 * np.pi * (0.5 + 0.5 * t) * t)
    *fitted, judging = (device.run(zero, force, rng) for force in (*shaken, steps))
    answer = diagnose(car(), fitted, [judging]).answer()
    assert answer["verdict"] == "nothing_missing"
    told = {c["name"]: c["relative"] for c in answer["model_corrections"]}
    assert told["mode_1_frequency"] == pytest.approx(0.009, abs=0.002)
    assert "mode_1_share" in told


def test_it_is_free_only_where_it_is_asked_for(two_masses):
    model = Model(Base.of(two_masses))
    assert "mode_1_share" not in {c.name for c in model.coordinates}
    asked = replace(model, corrections={"mode_1_share": 0.0})
    assert "mode_1_share" in {c.name for c in asked.coordinates}


def recordings(plant, references, push=0.3):
    """Moves, and a push of that many A beside them."""
    rng = np.random.default_rng(3)
    device = SimulatedMachine(plant)
    paths = (*references, 0.7 * references[0])
    shaken = [push * rng.standard_normal(len(path)) for path in paths]
    return [device.run(path, push, rng) for path, push in zip(paths, shaken, strict=True)]


@pytest.mark.usefixtures("no_play_sought")
@pytest.mark.parametrize(("share", "push"), [(0.035, 0.3), (0.035, 1.5), (-0.03, 1.5)])
def test_zeros_that_are_off_are_no_mode_and_no_mass(two_masses, references, share, push):
    """(Without the shares: a mode at 33 Hz, 2 % less mass, and something that has no name.)"""
    mechanics = Simulator(two_masses).mechanics
    system = discrete(corrected(mechanics, {"mode_1_share": share}))
    *fitted, judging = recordings(replace(two_masses, system=system), references, push)
    answer = diagnose(two_masses, fitted, [judging]).answer()
    assert answer["verdict"] == "nothing_missing"
    told = {c["name"]: c["relative"] for c in answer["model_corrections"]}
    assert told["mode_1_share"] == pytest.approx(share, abs=0.006)


def test_a_mode_that_is_there_stays(two_masses, references):
    runs = recordings(replace(two_masses, effects=(MODE,)), references)
    base = Base.of(two_masses)
    noise = Noise(1e-6, 0.01)
    trials = [prepare(base.simulator, r, 1e-6) for r in runs]
    scene, held = (Scene(two_masses.loop, tuple(t), noise) for t in (trials[:2], trials[2:]))
    standing = judge(scene, held, replace(Model(base), effects=(MODE,)), 6)
    assert shares_off(scene, held, standing, lambda line: None) is None

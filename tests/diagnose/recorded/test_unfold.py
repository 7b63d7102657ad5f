"""Recordings of a sensor that is blind to the sign: starts in motion, what a screen sees through it, and
force noise that hides its folds."""

import numpy as np

from ffl.diagnose.ground import _through_folds
from ffl.diagnose.hypothesis.fit import Scene, fit
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.starts import with_starts
from ffl.diagnose.recorded.trials import prepare
from ffl.diagnose.recorded.unfold import RECTIFIED, folded_trial
from ffl.diagnose.screen.screen import Screen
from ffl.machines import Simulator
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.zpk import Zpk

T = 0.02
DRIVE = Plant("drive", Zpk([], [0.9], 0.1, T), input_unit="V", output_unit="ticks/s")
LAG = EffectSpec("actuator_lag", {"time_constant": 0.1})


def drive_and_speed(*effects, samples=400):
    u = np.repeat(np.random.default_rng(3).uniform(-2.0, 2.0, samples // 20), 20)
    return u, Simulator(DRIVE).run(effects, feedforward=u).y


def cut(u, y, sample):
    t = T * np.arange(len(u))
    recording = Recording(t, np.zeros(len(u)), u, u, np.abs(y), sample_time=T)
    return recording[sample:]


def scene_of(*trials):
    return Scene(DRIVE.loop, trials, Noise(1e-3, 1e-9), plain=True)


def test_a_start_in_motion_has_the_sign_that_the_rest_tells():
    u, y = drive_and_speed()
    simulator = Base.of(DRIVE).simulator
    model = Model(Base.of(DRIVE), effects=(RECTIFIED,))
    backwards = [k for k in range(40, 300, 7) if y[k] < -0.3]
    assert backwards
    for sample in backwards:
        trial = folded_trial(simulator, cut(u, y, sample), 1e-3)
        assert np.abs(model.simulate(trial).y - trial.y).max() < 1e-6


def test_a_recording_that_begins_at_zero_is_from_rest_and_one_cut_out_is_not():
    u, y = drive_and_speed()
    simulator = Base.of(DRIVE).simulator
    assert folded_trial(simulator, cut(u, y, 0), 1e-3).off
    crossing = 40 + int(np.argmin(np.abs(y[40:300])))
    assert not folded_trial(simulator, cut(u, y, crossing), 1e-3).off


def test_the_command_before_a_cut_is_found_where_a_lag_shows_it():
    u, y = drive_and_speed(LAG)
    base = Base.of(DRIVE)
    model = Model(base, effects=(RECTIFIED, LAG))
    sample = 101  # the command has just changed
    assert abs(u[sample] - u[sample - 2]) > 0.5
    scene = scene_of(folded_trial(base.simulator, cut(u, y, sample), 1e-3))
    left = np.std(scene.residuals(model)[0])
    begun = with_starts(scene, model)
    assert begun.trials[0].held is not None
    assert np.std(begun.residuals(model)[0]) < 0.05 * left


def test_the_screen_sees_a_small_lag_through_a_sensor_blind_to_the_sign():
    u, y = drive_and_speed(EffectSpec("actuator_lag", {"time_constant": 0.004}))
    base = Base.of(DRIVE)
    scene = scene_of(folded_trial(base.simulator, cut(u, y, 0), 1e-3))
    screen = Screen(scene, fit(scene, Model(base, effects=(RECTIFIED,)), rounds=0))
    (found,) = screen.candidates(["actuator_lag"])
    assert found.gain > 0.8 * float(screen.residual @ screen.residual)


def test_folds_are_told_through_force_noise_and_where_what_judges_keeps_to_one_side(on_a_spring):
    """The noise moves the machine half as much as the command does; the held-out command pushes one way."""
    plant = on_a_spring(2.0, 25.0, 0.05, 1e-3, "N", sensor_noise=1e-8, force_noise=1.0)
    base, rng = Base.of(plant), np.random.default_rng(4)
    t = 1e-3 * np.arange(4000)
    waves = sum(np.sin(2 * np.pi * f * t + f) for f in (3.0, 7.0, 11.0, 17.0, 23.0)) / 2.0
    scenes, recordings = [], []
    for u in (waves, 2.5 + np.sin(2 * np.pi * 2.0 * t)):
        noise = np.std(waves) * 1.5 * rng.standard_normal(len(u))
        y = np.abs(Simulator(plant).run((), feedforward=u, force=noise).y)
        recordings.append(Recording(t, np.zeros(len(u)), u, u, y, sample_time=1e-3))
        trial = prepare(base.simulator, recordings[-1], 1e-8)
        scenes.append(Scene(plant.loop, (trial,), Noise(1e-8, 1.0)))
    short = recordings[:1], recordings[1:]
    found = _through_folds(Model(base), *scenes, short[0], short)
    assert found is not None
    assert found[0].names == ("sensor_nonlinearity",)
    assert found[0].base is base  # the linear part was right as stated
    straight = [
        Recording(t, r.r, r.f, r.u, np.sign(r.u) * r.y, sample_time=1e-3) for r in recordings
    ]
    assert _through_folds(Model(base), *scenes, straight[:1], (straight[:1], straight[1:])) is None

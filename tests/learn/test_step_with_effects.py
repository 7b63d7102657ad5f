"""A learning step with an augmented model: along its trajectory, wherever the recording begins."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.bases import make_basis
from ffl.learn import Weights
from ffl.learn.foretold import LEAD, foretold, led_in
from ffl.learn.step import feedforward_for, learn_from_recording
from ffl.machines import Simulator
from ffl.recordings import Recording
from ffl.report.step import error_told
from ffl.systems import EffectSpec, Move, load_plant, moves

T = 1e-3
WEIGHTS = Weights(1e9, 1e-9, 0.0)
EFFECTS = (
    EffectSpec("coulomb_friction", {"level": 20.0}),
    EffectSpec("cogging", {"amplitude": 8.0, "period": 0.03, "phase": 0.4}),
)


@pytest.fixture(scope="module")
def stage():
    return replace(load_plant("emps"), effects=EFFECTS)


def record(machine, feedforward=None, load=None, first=0, start=0.0):
    r = start + moves([Move(0.2, 0.12, 0.3, 3.0, 60.0), Move(1.0, -0.07, 0.25, 3.0, 60.0)], 1.8, T)
    f = np.zeros_like(r) if feedforward is None else feedforward
    simulator = Simulator(machine)
    run = simulator.run(machine.effects, r, f, force=load, start=simulator.at_rest(start))
    t = T * np.arange(len(r))
    return Recording(t, r, f, run.u, run.y, load, sample_time=T)[first:]


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("start", [0.0, 0.043])
def test_what_it_foretells_is_what_the_machine_does(stage, start):
    """Of a linear step friction and cogging leave eight times as much and more."""
    recording = record(stage, start=start)
    basis = make_basis("from_diagnosis", T, stage)
    step = learn_from_recording(stage, basis, recording, WEIGHTS)
    linear = learn_from_recording(stage, basis, recording, WEIGHTS, path="closed_form")
    theta = dict(zip(step.names, step.theta, strict=True))
    assert theta["coulomb_friction"] == pytest.approx(20.0, rel=0.02)
    assert np.hypot(theta["cogging[0]"], theta["cogging[1]"]) == pytest.approx(8.0, rel=0.05)
    done = {}
    for name, learned in (("step", step), ("linear", linear)):
        whole = record(stage, start=start)
        again = record(
            stage, feedforward_for(basis, whole, learned.theta, 0 * learned.theta), start=start
        )
        done[name] = rms(again.r - again.y)
    assert done["step"] < 0.15 * done["linear"]
    assert rms(step.predicted) == pytest.approx(done["step"], rel=0.3)
    told = foretold(stage, recording, feedforward_for(basis, recording, step.theta, 0 * step.theta))
    assert rms(told.after - step.predicted) < 0.05 * rms(step.predicted)


def test_a_recording_that_begins_in_motion_is_learned_from_as_linear(stage):
    recording = record(stage, first=300)
    basis = make_basis("from_diagnosis", T, stage)
    step, linear = (
        learn_from_recording(stage, basis, recording, WEIGHTS, path=path)
        for path in ("auto", "closed_form")
    )
    np.testing.assert_array_equal(step.theta, linear.theta)


def test_a_load_and_an_injection_of_that_trial_are_not_learned(stage):
    """They pushed in the recording alone: the next command is the same without them."""
    basis = make_basis("from_diagnosis", T, stage)
    t = T * np.arange(1800)
    load, injected = 6.0 * np.sin(9.0 * t), 4.0 * np.sin(31.0 * t)
    plain = learn_from_recording(stage, basis, record(stage), WEIGHTS)
    pushed = learn_from_recording(stage, basis, record(stage, injected, load), WEIGHTS)
    assert pushed.feedforward == pytest.approx(
        plain.feedforward, abs=0.01 * np.abs(plain.feedforward).max()
    )
    assert any("injection" in note for note in pushed.notes)


def test_a_parameter_that_nothing_in_the_trial_shows_has_no_error(stage):
    """A constant load before a servo that integrates, a mass beside itself."""
    machine = replace(
        stage, effects=(*EFFECTS, EffectSpec("viscous_friction", {"coefficient": 30.0}))
    )
    basis = make_basis("from_diagnosis", T, machine)
    step = learn_from_recording(machine, basis, record(machine), WEIGHTS)
    both = [k for k, name in enumerate(step.names) if name in ("velocity", "viscous_friction")]
    assert min(step.std_error[both]) == 0.0
    moved = [note for note in step.notes if "this step moved" in note]
    assert not any("e+" in note and "inf" in note for note in moved)
    assert all("e+300" not in note for note in step.notes)


@pytest.mark.parametrize(
    ("value", "std_error", "told"),
    [(2.0, 0.1, True), (0.0, 0.1, True), (0.0, 0.0, False), (2.0, 0.0, False), (8.9, 8e12, False)],
)
def test_errors_that_say_nothing_are_not_told(value, std_error, told):
    assert (error_told({"value": value, "std_error": std_error}) != "not told") is told


def test_a_recording_is_led_in_at_its_own_velocity():
    r = 0.3 + 0.02 * np.arange(50.0)
    before = led_in(r)
    assert len(before) == LEAD
    assert np.diff(np.append(before, r)) == pytest.approx(0.02)

"""Commands under way in a delay, and what is open of a start, in the states that they belong to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.colour import loop_of
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.noise.whitening import Whitener
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import Simulator
from ffl.recordings import Recording
from ffl.systems import EffectSpec, Zpk

SENSOR, FORCE = 1e-6, 1e-2


def delayed(stage, delay):
    return replace(stage, system=replace(stage.system, delay=delay))


def with_pole(stage, pole):
    own = stage.system
    poles = np.append(own.poles, pole)
    return replace(stage, system=Zpk(own.zeros, poles, own.gain * (1.0 - pole), own.sample_time))


PLANTS = {
    "as it is": lambda stage: stage,
    "3 samples late": lambda stage: delayed(stage, 3),
    "8 samples late": lambda stage: delayed(stage, 8),
    "a pole at -0.2": lambda stage: with_pole(stage, -0.2),
}


@pytest.mark.parametrize("which", PLANTS)
def test_a_piece_cut_out_of_a_motion_speaks_for_the_true_model(stage, which):
    """And errors of its start as large as is said of them cost what as many free numbers would."""
    plant, rng = PLANTS[which](stage), np.random.default_rng(0)
    assert plant.loop.is_stable
    base = Base.of(plant)
    n, cut, step = 3000, 1000, plant.sample_time
    t = np.arange(n) * step
    waves = [np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in (1, 3, 7, 13, 29)]
    noise = {"force": FORCE * rng.standard_normal(n), "noise": SENSOR * rng.standard_normal(n)}
    r = 0.02 * np.sum(waves, axis=0)
    run = base.simulator.run((), r, **noise)
    piece = Recording.from_signals(step, y=run.y[cut:], u=run.u[cut:], r=r[cut:])
    trial = prepare(base.simulator, piece, SENSOR)
    whitened = Whitener.of(base.loop, Noise(SENSOR, FORCE), trial.doubt)
    left = whitened(trial.y - Model(base).simulate(trial).y)
    assert np.mean(left**2) == pytest.approx(1.0, abs=0.12)
    values, vectors = np.linalg.eigh(trial.doubt)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    costs = []
    for _ in range(20):
        start = root @ rng.standard_normal(len(root))
        costs.append(np.sum(whitened(base.simulator.run((), np.zeros(400), start=start).y) ** 2))
    assert np.mean(costs) < 1.5 * np.sum(values > 1e-12 * values.max())


def test_the_loop_by_states_is_the_loop(stage):
    f = [0.5, 5.0, 50.0, 200.0]
    for make in PLANTS.values():
        plant = make(stage)
        own, other = (loop.system.response(f) for loop in (plant.loop, Base.of(plant).loop))
        np.testing.assert_allclose(other, own, rtol=1e-9, atol=1e-12 * np.abs(own).max())
    assert Base.of(stage).loop is stage.loop


@pytest.mark.parametrize("delay", [0, 3, 8])
def test_what_was_held_before_is_under_way(stage, references, delay):
    """A constant load, held by the motor for long."""
    load = EffectSpec("constant_load", {"force": -5.0})
    plant = replace(delayed(stage, delay), effects=(load,))
    assert _left_by_the_true_model(plant, references[0]) < 1e-11


@pytest.mark.parametrize(
    "spec",
    [
        EffectSpec("actuator_lag", {"time_constant": 0.003}),
        EffectSpec("input_delay", {"delay": 0.002}),
    ],
)
def test_a_known_load_is_no_command_to_remember(stage, references, spec):
    """What holds it is."""
    plant = replace(stage, effects=(spec,))
    assert _left_by_the_true_model(plant, references[0], known=0.4) < 1e-11


def _left_by_the_true_model(plant, reference, known=0.0):  # type: ignore[no-untyped-def]
    """The largest error of the true model where a machine has stood for long, without noise."""
    lead = 30000
    whole = np.concatenate([np.zeros(lead), reference])
    run = Simulator(plant).run(plant.effects, whole, force=np.full(len(whole), known))
    d = np.full(len(reference), known) if known else None
    recording = Recording.from_signals(
        plant.sample_time, y=run.y[lead:], u=run.u[lead:], r=reference, d=d
    )
    base = Base.of(plant)
    trial = prepare(base.simulator, recording, 1e-9)
    assert trial.at_rest
    return np.abs(trial.y - Model(base).simulate(trial).y).max()


@pytest.mark.parametrize("which", PLANTS)
def test_the_corrected_loop_is_that_of_the_corrected_plant(stage, which):
    """Behind a delay too, and with nothing corrected by the same states as the stated loop."""
    base, f = Base.of(PLANTS[which](stage)), [0.5, 5.0, 50.0, 200.0]
    model = Model(base, {"mass": 0.05, "damping": 0.1})
    own, other = (one.system.response(f) for one in (loop_of(model), model.plant().loop))
    np.testing.assert_allclose(own, other, rtol=1e-9, atol=1e-12 * np.abs(other).max())
    bare, stated = loop_of(Model(base)).system, base.loop.system
    np.testing.assert_array_equal(bare.a, stated.a)
    np.testing.assert_array_equal(bare.b, stated.b)

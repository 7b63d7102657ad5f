"""A sine of time found at a neighbouring tooth of the recordings' comb comes to its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.teeth import other_teeth
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec

FREQUENCY, AMPLITUDE, PHASE, APART = 3.65, 0.3, 0.7, 19.0  # Hz, N, rad, s


def begun_at(stage, reference, start, seed):  # type: ignore[no-untyped-def]
    """A recording that begins `start` seconds after the clock."""
    rng = np.random.default_rng(seed)
    n, simulator = len(reference), Simulator(stage)
    t = start + stage.sample_time * np.arange(n)
    sine = AMPLITUDE * np.sin(2.0 * np.pi * FREQUENCY * t + PHASE) / simulator.force_per_input
    run = simulator.run(
        (), reference, force=sine + stage.machine.force_noise * rng.standard_normal(n),
        noise=stage.machine.sensor_noise * rng.standard_normal(n),
    )  # fmt: skip
    return Recording(
        t, np.asarray(reference), np.zeros(n), run.u, run.y, sample_time=stage.sample_time,
        source=f"run_{seed}.csv",
    )  # fmt: skip


def scene_of(stage, runs):  # type: ignore[no-untyped-def]
    simulator = Simulator(stage)
    trials = tuple(prepare(simulator, run, stage.machine.sensor_noise) for run in runs)
    noise = Noise(stage.machine.sensor_noise, stage.machine.force_noise)
    return Scene(stage.loop, trials, noise)


@pytest.fixture(scope="module")
def grounds(stage, references):  # type: ignore[no-untyped-def]
    one, other = references
    fitted = [begun_at(stage, one, 0.0, 0), begun_at(stage, other, APART, 1)]
    return scene_of(stage, fitted), scene_of(stage, [begun_at(stage, one, 2.3 * APART, 2)])


def with_sine(stage, frequency):  # type: ignore[no-untyped-def]
    numbers = {"amplitude": AMPLITUDE, "frequency": frequency, "phase": PHASE}
    return replace(Model(Base.of(stage)), effects=(EffectSpec("periodic_disturbance", numbers),))


@pytest.mark.parametrize("tooth", [-2, 1])
def test_a_sine_comes_to_its_own_tooth(stage, grounds, tooth):  # type: ignore[no-untyped-def]
    scene, held = grounds
    base = judge(scene, held, Model(Base.of(stage)), 4)
    astray = judge(scene, held, with_sine(stage, FREQUENCY + tooth / APART), 6)
    assert abs(astray.model.effects[0].parameters["frequency"] - FREQUENCY) > 0.5 / APART
    best = max(other_teeth(scene, held, base, [astray]), key=lambda judged: judged.score)
    found = best.model.effects[0].parameters
    assert found["frequency"] == pytest.approx(FREQUENCY, abs=1e-3)
    assert found["amplitude"] == pytest.approx(AMPLITUDE, rel=0.05)
    assert best.held_out > astray.held_out + 20.0


def test_one_recording_and_a_faint_sine_have_no_other_teeth(stage, grounds):  # type: ignore[no-untyped-def]
    scene, held = grounds
    one = replace(scene, trials=scene.trials[:1])
    base = judge(one, held, Model(Base.of(stage)), 4)
    found = judge(one, held, with_sine(stage, FREQUENCY), 4)
    assert found.fitted > base.fitted + 20.0
    assert other_teeth(one, held, base, [found]) == []
    assert other_teeth(scene, held, found, [found]) == []  # nothing beyond what stands

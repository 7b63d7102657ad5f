"""A mode that no move excites, told by the noise that rings it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.linear import corrected_plant
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.heard import with_modes_heard
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.systems import Move, moves
from ffl.systems.plant import Imperfections

SENSOR, FORCE, STEP = 1e-8, 0.05, 1e-3
LIGHT = {"mode_1_damping": -0.7}


def judged(two_masses, off):  # type: ignore[no-untyped-def]
    """Slow moves, and a multisine to judge by, of a machine whose mode is `off` the stated one."""
    light = corrected_plant(two_masses, Base.of(two_masses).simulator.mechanics, LIGHT)
    stated = replace(light, machine=Imperfections(0.0, SENSOR, FORCE, None))
    base = Base.of(stated, 0.05, 8.0)
    machine = SimulatedMachine(corrected_plant(stated, base.simulator.mechanics, off))
    slow = moves([Move(0.2, 0.02, 0.1, 0.5, 5.0), Move(2.0, -0.02, 0.1, 0.5, 5.0)], 8.0, STEP)
    t = STEP * np.arange(len(slow))
    rng = np.random.default_rng(5)
    phases = rng.uniform(0, 2 * np.pi, 60)
    tones = np.sin(2 * np.pi * np.arange(20, 80)[:, None] * t + phases[:, None])
    loud = 2e-6 * tones.sum(axis=0) * (t > 0.3)
    runs = [machine.run(r, np.zeros_like(r), rng) for r in (slow, loud)]
    trials = [prepare(base.simulator, r, SENSOR) for r in runs]
    noise = Noise(SENSOR, FORCE)
    scene, held = (Scene(stated.loop, (trial,), noise) for trial in trials)
    return held, judge(scene, held, Model(base))


@pytest.mark.parametrize("off", [0.012, -0.01])
def test_noise_tells_how_far_off_a_mode_is(two_masses, off):  # type: ignore[no-untyped-def]
    held, before = judged(two_masses, {"mode_1_frequency": off})
    after = with_modes_heard(held, before)
    found = after.model.corrections["mode_1_frequency"]
    assert found == pytest.approx(off, abs=0.003)
    assert after.model.held == before.model.held


def test_free_runs_of_recordings_that_judge_have_the_last_word(two_masses):  # type: ignore[no-untyped-def]
    held, before = judged(two_masses, {"mode_1_frequency": 0.012})
    other, _ = judged(two_masses, {})
    assert with_modes_heard(other, before) is before
    assert with_modes_heard(held, before) is not before

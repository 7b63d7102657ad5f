"""A drive that slews: found with its rate, and beside what it could be taken for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.effects import EFFECTS
from ffl.machines import SimulatedMachine, Simulator
from ffl.systems.plant import EffectSpec, Imperfections, Plant
from ffl.systems.plant_file import plant_from_dict
from ffl.systems.zpk import Zpk

STEP, RATE = 1e-3, 60.0
ALONE = Plant("drive", Zpk(np.array([]), np.array([0.0]), 1.0, STEP))


def test_a_step_is_a_ramp_that_ends_within_a_sample():
    """u = 0, then 0.1: 0.06 a sample, the rest in the next; seen is the mean over a sample."""
    u = np.concatenate([np.zeros(3), np.full(6, 0.1)])
    spec = EffectSpec("slew_limit", {"rate": RATE})
    run = Simulator(ALONE, open_loop=True).run([spec], feedforward=u)
    ramp = np.array([0.0, 0.0, 0.0, 0.03, 0.1 - 0.02 * 2 / 3, 0.1, 0.1, 0.1, 0.1])
    assert u + run.contribution[:, 0] == pytest.approx(ramp, abs=1e-12)
    (column,) = EFFECTS["slew_limit"].regressors(run.motion(), rate=RATE).T
    assert column == pytest.approx(ramp - u, abs=1e-12)


def test_it_is_named_with_its_rate():
    """A stage of 6 kg whose drive needs 0.05 s for 3 N."""
    stage = plant_from_dict(
        {
            "name": "stage",
            "sample_time": STEP,
            "units": {"input": "N", "output": "m"},
            "plant": {"form": "czpk", "zeros": [], "poles": [0.0, -1.0], "gain": 1.0 / 6.0},
            "controller": {"form": "zpk", "zeros": [0.98], "poles": [0.8], "gain": 12000.0},
            "physics": {"mass": 6.0, "motor_constant": 1.0},
            "machine": {"sensor_noise": 1e-6, "force_noise": 0.02},
        }
    )
    spec = EffectSpec("slew_limit", {"rate": RATE})
    machine = replace(stage, effects=(spec,), machine=Imperfections(0.0, 1e-6, 0.02))
    t, runs = STEP * np.arange(4000), []
    for seed, tones in enumerate(((0.7, 1.9), (1.1, 2.3))):
        wave = sum(np.sin(2 * np.pi * f * (t - 0.2)) / f for f in tones)
        path = 0.0035 * np.clip((t - 0.2) / 0.5, 0.0, 1.0) ** 3 * wave
        run = SimulatedMachine(machine).run(path, None, np.random.default_rng(seed))
        runs.append(replace(run, source=f"run_{seed}"))
    found = diagnose(stage, runs[:1], runs[1:], rng=np.random.default_rng(0))
    (effect,) = found.findings
    assert effect.name == "slew_limit"
    assert effect.parameters["rate"].value == pytest.approx(RATE, rel=0.01)
    assert effect.parameters["rate"].unit == "N/s"
    assert found.verdict == "explained"

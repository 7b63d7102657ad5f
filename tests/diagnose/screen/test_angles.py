"""A rotor seen by its speed: where each recording began is read from the cogging that it shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.machines import SimulatedMachine
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec
from ffl.systems.plant_file import plant_from_dict

STEP, SAMPLES, PERIOD = 2e-3, 1500, 60.0 / 11.0  # s, rpm s: 11 to a turn
COGGING = EffectSpec("cogging", {"amplitude": 0.09, "period": PERIOD, "phase": 0.7})
BEGAN = (0.0, 1.9, 4.4)  # rpm s


@pytest.fixture(scope="module")
def turntable():  # type: ignore[no-untyped-def]
    return plant_from_dict(
        {
            "name": "turntable", "sample_time": STEP, "units": {"input": "A", "output": "rpm"},
            "plant": {"form": "czpk", "zeros": [], "poles": [-0.2], "gain": 238.7},
            "controller": {"form": "zpk", "zeros": [0.992], "poles": [1.0], "gain": 0.012},
            "physics": {"mass": 0.0020944, "motor_constant": 0.5},
            "machine": {"sensor_noise": 0.02, "force_noise": 0.004},
        }
    )  # fmt: skip


def recorded(plant, effects, began):  # type: ignore[no-untyped-def]
    t, out = STEP * np.arange(SAMPLES), []
    for k, place in enumerate(began):
        rng, noise = np.random.default_rng(k), plant.machine
        r = (20.0 + 6.0 * k) * np.sin(2 * np.pi * (0.3 + 0.11 * k) * t)
        run = Simulator(plant).run(
            effects, r, force=noise.force_noise * rng.standard_normal(SAMPLES),
            noise=noise.sensor_noise * rng.standard_normal(SAMPLES), place=place,
        )  # fmt: skip
        out.append(Recording(t, r, 0 * r, run.u, run.y, sample_time=STEP, source=f"run_{k}.csv"))
    return out


def test_a_run_begins_where_it_is_put(turntable):
    runs = [
        Simulator(turntable).run((COGGING,), np.zeros(200), place=at).y for at in (0.0, PERIOD, 1.0)
    ]
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-9)
    assert np.abs(runs[2] - runs[0]).max() > 0.01
    device = SimulatedMachine(replace(turntable, effects=(COGGING,)))
    same = device.run(np.zeros(200), np.zeros(200), np.random.default_rng(0))
    assert np.corrcoef(same.y, runs[0])[0, 1] > 0.9


def test_cogging_is_named_wherever_the_rotor_stood(turntable):
    runs = recorded(turntable, (COGGING,), BEGAN)
    found = diagnose(turntable, runs[:2], runs[2:])
    (told,) = found.findings
    assert (found.verdict, told.name) == ("explained", "cogging")
    assert told.parameters["amplitude"].value == pytest.approx(0.09, rel=0.02)
    assert told.parameters["period"].value == pytest.approx(PERIOD, rel=1e-3)
    assert told.parameters["phase"].value == pytest.approx(0.7, abs=0.05)
    assert found.proof.nrmse_after < 1.2 * found.proof.noise_floor
    assert any("where the recordings began" in note for note in found.notes)
    trials = (*found.judged.scene.trials,)
    assert trials[0].place == 0.0
    off = (trials[1].place - BEGAN[1]) / PERIOD
    assert off - round(off) == pytest.approx(0.0, abs=0.02)


def test_where_nothing_comes_again_nothing_is_read(turntable):
    runs = recorded(turntable, (), BEGAN)
    found = diagnose(turntable, runs[:2], runs[2:])
    assert found.verdict == "nothing_missing"
    assert not any("where the recordings began" in note for note in found.notes)
    assert all(trial.place is None for trial in found.judged.scene.trials)

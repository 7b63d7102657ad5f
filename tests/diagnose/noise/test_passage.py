"""What a force does to y in the loop of a plant that would run away without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.hypothesis.places import places_of
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.noise.passage import Passage
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.systems.plant import EffectSpec, Imperfections
from ffl.systems.plant_file import plant_from_dict

STEP = 0.0005
REFERENCE = 1e-4 * np.sin(2 * np.pi * 3.0 * STEP * np.arange(4000)) ** 3
SINE = EffectSpec("periodic_disturbance", {"amplitude": 0.4, "frequency": 47.0, "phase": 0.4}, {})


@pytest.fixture(scope="module")
def bearing():
    """A magnetic bearing of 2.5 kg: it pulls by 90 N/mm off its centre."""
    return plant_from_dict(
        {
            "name": "bearing",
            "sample_time": STEP,
            "units": {"input": "A", "output": "m"},
            "plant": {"form": "czpk", "zeros": [], "poles": [190.0, -190.0], "gain": 60.0},
            "controller": {"form": "zpk", "zeros": [0.93], "poles": [0.3], "gain": 8000.0},
            "physics": {"mass": 2.5, "motor_constant": 150.0},
            "machine": {"sensor_noise": 2e-8, "force_noise": 2e-3},
        }
    )


def ran(machine, seed):  # type: ignore[no-untyped-def]
    t = STEP * np.arange(6000)
    reference = 1e-4 * np.sin(2 * np.pi * (3.0 + seed) * t) * np.clip(t / 0.2, 0.0, 1.0)
    run = SimulatedMachine(machine).run(reference, None, np.random.default_rng(seed))
    return replace(run, source=f"run_{seed}")


def test_the_answer_to_a_force_is_that_of_the_loop(bearing):  # type: ignore[no-untyped-def]
    quiet = replace(bearing, machine=Imperfections())
    with_sine, without = (
        SimulatedMachine(replace(quiet, effects=effects)).run(
            REFERENCE, None, np.random.default_rng(0)
        )
        for effects in ((SINE,), ())
    )
    base = Base.of(bearing)
    trial = prepare(base.simulator, without, 2e-8)
    scene, model = Scene(bearing.loop, (trial,), Noise(2e-8, 2e-3)), Model(base)
    (place, *_) = places_of(model)
    middle = trial.t + 0.5 * STEP
    force = 0.4 * np.sin(2 * np.pi * 47.0 * middle + 0.4) / base.simulator.force_per_input
    column = Passage(scene, model).through(place, [force[:, None]])[:, 0]
    wanted = scene.whiten([with_sine.y - without.y])
    assert np.linalg.norm(column - wanted) < 0.02 * np.linalg.norm(wanted)


def test_an_unbalance_is_no_noise(bearing):  # type: ignore[no-untyped-def]
    machine = replace(bearing, effects=(SINE,))
    found = diagnose(bearing, [ran(machine, 1)], [ran(machine, 2)], rng=np.random.default_rng(0))
    (effect,) = found.findings
    assert effect.name == "periodic_disturbance"
    assert effect.parameters["amplitude"].value == pytest.approx(0.4, rel=0.05)
    assert found.verdict == "explained"

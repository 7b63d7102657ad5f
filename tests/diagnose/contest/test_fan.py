"""A fan of which nobody states the noise: what a first wrong name leaves must not stay its noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.machines import SimulatedMachine
from ffl.systems.plant import EffectSpec, Imperfections
from ffl.systems.plant_file import plant_from_dict

STEP, SAMPLES = 0.002, 3600
FAN = {
    "name": "fan",
    "sample_time": STEP,
    "units": {"input": "A", "output": "rad/s"},
    "plant": {"form": "czpk", "zeros": [], "poles": [-0.2], "gain": 40.0},
    "controller": {"form": "zpk", "zeros": [0.99005], "poles": [1.0], "gain": 1.005},
    "physics": {"mass": 0.002, "motor_constant": 0.08},
}
DRAG = EffectSpec("quadratic_drag", {"coefficient": 3e-6}, {})
DRY = EffectSpec("coulomb_friction", {"level": 0.03}, {})
SPEEDS = ((100, 80), (500, 200), (1000, 120), (1400, 260), (1900, 30), (2300, -90), (2800, -220))


@pytest.fixture(scope="module")
def fan():
    return plant_from_dict(FAN)


@pytest.fixture(scope="module")
def runs(fan):  # type: ignore[no-untyped-def]
    machine = SimulatedMachine(
        replace(fan, effects=(DRAG, DRY), machine=Imperfections(0.0, 0.05, 0.01))
    )
    wanted = np.zeros(SAMPLES)
    for at, speed in (*SPEEDS, (3200, 60)):
        wanted[at:] = speed
    steps, weight = np.empty(SAMPLES), 0.0
    for k, speed in enumerate(wanted):
        weight = steps[k] = 0.97 * weight + 0.03 * speed
    t = STEP * np.arange(3000)
    waves = sum(np.sin(2 * np.pi * f * t + f) for f in (0.3, 0.7, 1.9, 4.0))
    moved = np.clip(t - 0.05, 0.0, 1.0) ** 2 * (60.0 + 77.0 * waves)
    return [
        replace(machine.run(r, None, np.random.default_rng(seed)), source=f"run_{seed}")
        for seed, r in ((3, steps), (4, moved))
    ]


@pytest.mark.slow(20)
def test_noise_is_heard_anew_beside_who_took_a_place(fan, runs):  # type: ignore[no-untyped-def]
    found = diagnose(fan, runs[:1], runs[1:], rng=np.random.default_rng(0))
    numbers = {effect.name: effect.parameters for effect in found.findings}
    assert set(numbers) == {"quadratic_drag", "coulomb_friction"}
    assert numbers["coulomb_friction"]["level"].value == pytest.approx(0.03, rel=0.01)
    assert numbers["quadratic_drag"]["coefficient"].value == pytest.approx(3e-6, rel=0.01)
    assert found.verdict == "explained"


@pytest.mark.slow(20)
def test_friction_that_leaves_next_to_nothing_is_louder_than_any_noise(fan, runs):  # type: ignore[no-untyped-def]
    alone = replace(fan, controller=None)
    found = diagnose(alone, runs[:1], runs[1:], rng=np.random.default_rng(0))
    names = {effect.name for effect in found.findings}
    assert "quadratic_drag" in names
    assert names & {"coulomb_friction", "stribeck_friction"}
    assert found.verdict == "explained"

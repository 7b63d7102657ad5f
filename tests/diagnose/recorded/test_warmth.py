"""Heat that a recording begins with is found, and a machine that warms is not told as a drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.maps.freeform import free_form
from ffl.diagnose.maps.freemodel import FreeModel, Part
from ffl.diagnose.maps.histories import low_pass
from ffl.diagnose.maps.terms import TERMS
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.diagnose.recorded.warmth import warmed, with_warmth
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording

PUSH, SETTLING = 0.6, 0.9  # N per A^2, s
WARM = (0.0, 0.9, 0.6)  # A^2 before each recording
HEAT = next(t for t in TERMS if t.name == "heat of the command")


def recorded(plant, reference, seed, warm):  # type: ignore[no-untyped-def]
    """The stage that a guide pushes as it warms with the square of the command; it began at rest."""
    rng = np.random.default_rng(seed)
    n, simulator, noise = len(reference), Simulator(plant), plant.machine
    shaken = noise.force_noise * rng.standard_normal(n)
    seen = noise.sensor_noise * rng.standard_normal(n)
    held = np.full(2000, warm)  # it has come to rest against the push before the recording begins
    longer = np.concatenate([np.full(2000, reference[0]), reference])
    quiet = np.zeros(2000)
    push = np.zeros(len(longer))
    for _ in range(25):
        run = simulator.run(
            (), longer, force=np.append(quiet, shaken) + push, noise=np.append(quiet, seen)
        )
        heat = low_pass(run.u[2000:] ** 2, SETTLING, plant.sample_time, warm)
        push = PUSH * np.append(held, heat) / plant.physics.motor_constant
    cut = slice(2000, None)
    return Recording(
        run.t[:n], np.asarray(reference), np.zeros(n), run.u[cut], run.y[cut],
        sample_time=plant.sample_time, source=f"run_{seed}.csv",
    )  # fmt: skip


@pytest.fixture(scope="module")
def scenes_of(stage, references):  # type: ignore[no-untyped-def]
    wanted = (references[0], references[1], references[0][::-1].copy())
    runs = [recorded(stage, r, k, w) for k, (r, w) in enumerate(zip(wanted, WARM, strict=True))]
    base = Base.of(stage)
    trials = [prepare(base.simulator, r, stage.machine.sensor_noise) for r in runs]
    noise = Noise(stage.machine.sensor_noise, stage.machine.force_noise)
    loop = stage.loop
    return Scene(loop, tuple(trials[:2]), noise), Scene(loop, tuple(trials[2:]), noise), Model(base)


def test_a_lag_goes_on_from_where_it_stood():
    step, tau = 1e-3, 0.2
    u = np.sin(np.arange(500) / 40)
    whole = low_pass(u, tau, step)
    np.testing.assert_allclose(low_pass(u[300:], tau, step, whole[299]), whole[300:], rtol=1e-12)
    np.testing.assert_allclose(
        low_pass(0.0 * u, tau, step, 2.0), 2.0 * np.exp(-step / tau * np.arange(1, 501)), rtol=1e-9
    )


def test_what_a_recording_begins_warm_with_is_found(scenes_of):  # type: ignore[no-untyped-def]
    scene, held, model = scenes_of
    found = free_form(scene, held, model, names=[HEAT.name])[-1]
    assert found.name == HEAT.name
    assert np.mean(found.white**2) < 1.3
    assert np.mean(found.held_white**2) < 1.6
    warm = [t.warm for t in (*found.scene.trials, *found.held.trials)]
    np.testing.assert_allclose(warm, WARM, atol=0.06)
    assert found.scene.trials[0].warm < 0.05


def test_only_maps_that_feel_heat_have_a_warmth(scenes_of):  # type: ignore[no-untyped-def]
    scene, _, model = scenes_of
    ranges = {"x": (-0.1, 0.1), "v": (-0.3, 0.3), "u": (-1.0, 1.0), "step": (1e-3, 3.0)}
    straight = Part(TERMS[0], Place("force"), np.zeros(49), ranges)
    assert with_warmth(scene, FreeModel(model, (straight,))) is scene
    blank = Part(HEAT, Place("force"), np.zeros(7), ranges)
    cold = with_warmth(warmed(scene, (0.5, 0.5)), FreeModel(model, (blank,)))
    assert all(t.warm == 0.0 for t in cold.trials)


def test_a_map_along_heat_is_straight_in_the_warmth(scenes_of):  # type: ignore[no-untyped-def]
    scene, _, model = scenes_of
    motion = model.simulate(scene.trials[1]).motion()
    ranges = {"x": (-0.1, 0.1), "v": (-0.3, 0.3), "u": (-1.0, 1.0), "step": (1e-3, 3.0)}
    cold, one, two = (HEAT.columns(replace(motion, warm=w), ranges) for w in (0.0, 1.0, 2.0))
    np.testing.assert_allclose(two - cold, 2.0 * (one - cold), atol=1e-12)

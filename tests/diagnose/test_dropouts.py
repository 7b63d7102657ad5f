"""Commands that did not arrive are found by themselves, and neither noise, a delay nor knocks are taken
for them."""

from __future__ import annotations

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.dropouts import dropouts
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec


def recorded(plant, reference, lost, seed, effects=(), knock=0.0):  # type: ignore[no-untyped-def]
    """The stage whose drive keeps the command before at the samples `lost`: found by repetition, since
    what is lost moves the machine and so the commands."""
    rng = np.random.default_rng(seed)
    n = len(reference)
    simulator, noise = Simulator(plant), plant.machine
    shaken = noise.force_noise * rng.standard_normal(n) + knock
    seen = noise.sensor_noise * rng.standard_normal(n)
    kept = np.maximum.accumulate(np.where(lost, 0, np.arange(n)))
    missing = np.zeros(n)
    for _ in range(30):
        run = simulator.run(effects, reference, force=shaken + missing, noise=seen)
        missing = run.u[kept] - run.u
    return Recording(
        run.t, np.asarray(reference), np.zeros(n), run.u, run.y, sample_time=plant.sample_time,
        source=f"run_{seed}.csv",
    )  # fmt: skip


def lost_at(n, share, seed):  # type: ignore[no-untyped-def]
    lost = np.random.default_rng(seed).random(n) < share
    lost[0] = False
    return lost


@pytest.fixture(scope="module")
def losing(stage, references):  # type: ignore[no-untyped-def]
    return [
        recorded(stage, r, lost_at(len(r), 0.05, 7 + k), k) for k, r in enumerate(references[:2])
    ]


def test_lost_commands_are_found_and_what_they_did_is_explained(stage, losing, scenes):  # type: ignore[no-untyped-def]
    scene, held, model = scenes(losing)
    found = dropouts(scene, held, model)
    assert found is not None
    true = lost_at(scene.samples, 0.05, 7)
    seen = found.fitted.scene.trials[0].load != 0
    near = np.convolve(true, np.ones(3), "same") > 0  # a force's own sample is hardly seen
    assert np.sum(seen & near) > 0.9 * np.sum(seen)
    assert np.mean(found.white**2) < 1.2
    assert min(found.gains(scene, held, model)) > 100.0


@pytest.mark.parametrize("what", ["noise", "delay", "knocks"])
def test_nothing_else_is_taken_for_lost_commands(stage, references, what, scenes):  # type: ignore[no-untyped-def]
    effects = (EffectSpec("input_delay", {"delay": 1e-3}),) if what == "delay" else ()
    runs = []
    for k, r in enumerate(references[:2]):
        knock = np.zeros(len(r))
        if what == "knocks":
            for at in (300, 900, 1500):
                knock[at : at + 40] = 0.3
        runs.append(recorded(stage, r, np.zeros(len(r), bool), k, effects, knock))
    scene, held, model = scenes(runs)
    found = dropouts(scene, held, model)
    assert found is None or min(found.gains(scene, held, model)) < 0


def test_a_bus_that_loses_commands_is_unnamed(stage, losing):  # type: ignore[no-untyped-def]
    answer = diagnose(stage, losing[:1], losing[1:]).answer()
    assert answer["verdict"] == "unnamed"
    assert answer["effects"] == []
    assert answer["location"]["component"] == "timing"
    assert set(answer["location"]["depends_on"]) == {"command", "time"}
    assert "did not arrive" in answer["location"]["where"]

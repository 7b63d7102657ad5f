"""Commands that did not arrive are found by themselves, and neither noise, a delay nor knocks are taken
for them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.maps.dropouts import CERTAIN, _searched, dropouts, expected
from ffl.diagnose.maps.unnamed import _lost
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec

FAINT = 2e-3  # m, a move in which hardly a sample would be certain by itself


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


def test_too_many_lost_commands_are_not_counted_out(losing, scenes):  # type: ignore[no-untyped-def]
    """More than so many of those that could be seen are a delay, whatever they bring."""
    scene, _, model = scenes(losing)
    whole, some = _searched(scene, model), _searched(scene, model, 0.5)
    assert whole is not None
    assert some is not None
    assert (some.lost, some.gain, some.other) == (whole.lost, whole.gain, whole.other)
    assert 0.01 < whole.rate < 0.5
    assert _searched(scene, model, 0.01) is None


def test_what_is_expected_of_lost_samples_counts_the_luck_of_the_noise():
    rng = np.random.default_rng(3)
    worth = rng.uniform(0.0, 9.0, 200_000)  # each alone, most of them fainter than what is certain
    brought = worth + np.sqrt(2.0 * worth) * rng.standard_normal(len(worth))
    seen, beyond = expected(worth)
    assert seen == pytest.approx(np.sum(brought > CERTAIN), rel=0.02)
    assert beyond == pytest.approx(np.sum(np.maximum(brought - CERTAIN, 0.0)), rel=0.02)
    assert expected(np.zeros(1000)) == (0.0, 0.0)


def test_many_faint_samples_are_no_delay_for_being_seen_by_luck(stage, scenes):  # type: ignore[no-untyped-def]
    t = np.arange(6000) * stage.sample_time
    slow = FAINT * np.sin(2 * np.pi * 3.0 * np.maximum(t - 0.3, 0.0)) ** 2
    runs = [
        recorded(stage, size * slow, lost_at(len(slow), 0.08, 11 + k), k)
        for k, size in enumerate((1.0, 0.8))
    ]
    found = dropouts(*scenes(runs))
    assert found is not None
    assert found.fitted.rate < 0.3


@pytest.mark.parametrize(
    ("confirmed", "gains", "said"),
    [
        (True, (-22.0, 800.0), True),  # hardly seen where it was fitted, plain where it was not
        (True, (-90.0, 800.0), False),
        (True, (800.0, 10.0), False),
        (False, (800.0, 10.0), True),
        (False, (15.0, 800.0), False),
    ],
)
def test_recordings_that_hardly_show_it_may_lose_a_little(confirmed, gains, said):  # type: ignore[no-untyped-def]
    assert _lost(SimpleNamespace(confirmed=confirmed), *gains) is said

"""A disturbance that comes at the same time in every recording is no noise, however loud."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.repeating import repeating
from ffl.diagnose.recorded.trials import prepared
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording

STEP, SAMPLES = 1e-3, 2000


def spun_up(t):  # type: ignore[no-untyped-def]
    """An unbalance, A: 4 Hz at first, 20 Hz after 2 s."""
    speed = 4.0 + 8.0 * t
    return 4e-3 * speed**2 * np.sin(2 * np.pi * (4.0 * t + 4.0 * t**2))


def moves(k):  # type: ignore[no-untyped-def]
    t = STEP * np.arange(SAMPLES)
    slow, fast = ((0.5, 1.7), (0.8, 2.9), (0.65, 2.2))[k]
    return 0.02 * np.sin(2 * np.pi * slow * t) ** 2 * np.sin(2 * np.pi * fast * t)


def recorded(stage, force, k, move=None):  # type: ignore[no-untyped-def]
    rng, simulator, machine = np.random.default_rng(k), Simulator(stage), stage.machine
    r = moves(k if move is None else move)
    shaken = machine.force_noise * rng.standard_normal(SAMPLES)
    run = simulator.run(
        (), r, force=force + shaken, noise=machine.sensor_noise * rng.standard_normal(SAMPLES)
    )
    return Recording(run.t, r, 0.0 * r, run.u, run.y, sample_time=STEP, source=f"run_{k}.csv")


@pytest.fixture
def heard(stage):  # type: ignore[no-untyped-def]
    """What three recordings under a force (k, N) share, the last of them judging."""

    def of(forces, moved=(0, 1, 2)):  # type: ignore[no-untyped-def]
        base = Base.of(stage)
        runs = [
            recorded(stage, f, k, m) for k, (f, m) in enumerate(zip(forces, moved, strict=True))
        ]
        noise = Noise(stage.machine.sensor_noise, stage.machine.force_noise)
        trials = prepared(base.simulator, runs, noise.sensor)
        scene = Scene(base.loop, trials[:2], noise)
        return repeating(scene, replace(scene, trials=trials[2:]), Model(base))

    return of


T = STEP * np.arange(SAMPLES)


def test_what_every_recording_has_in_common_is_run_in_those_that_judge(heard):
    found = heard([spun_up(T)] * 3)
    assert found is not None
    assert found.correlation > 0.95
    assert found.left < 0.1
    error = found.load[200:-50] - spun_up(T)[200:-50]
    assert np.std(error) < 0.1 * np.std(spun_up(T))
    first, last = found.hertz
    assert first == pytest.approx(6.85, abs=0.3)  # 0.207 to 0.5 s
    assert last == pytest.approx(19.2, abs=0.5)
    assert found.sweeps


@pytest.mark.parametrize(
    ("forces", "moved"),
    [
        ([0.0 * T] * 3, (0, 1, 2)),  # noise alone
        ([spun_up(T), spun_up(T + 0.13), spun_up(T + 0.31)], (0, 1, 2)),  # begun at other times
        ([spun_up(T)] * 3, (1, 1, 1)),  # of one move everything repeats
        ([spun_up(T), spun_up(T), 0.0 * T], (0, 1, 2)),  # not in the one that judges
    ],
)
def test_nothing_is_said_of_what_does_not_come_again(heard, forces, moved):
    assert heard(forces, moved) is None


def test_a_rotor_that_spins_up_is_unnamed_and_goes_by_time(stage):
    runs = [recorded(stage, spun_up(T), k) for k in range(3)]
    found = diagnose(stage, runs[:2], runs[2:])
    assert found.verdict == "unnamed"
    assert found.place.component == "environment"
    assert found.place.depends_on == ("time",)
    assert "same in every recording" in found.place.where
    assert found.proof.nrmse_with_map < 0.3 * found.proof.nrmse_before
    assert "standstill" in found.advice[0]
    (drawn,) = found.pictures
    middle = slice(200, -50)
    force = spun_up(drawn.grid) * Simulator(stage).force_per_input
    assert np.std((drawn.values - force)[middle]) < 0.1 * np.std(force[middle])

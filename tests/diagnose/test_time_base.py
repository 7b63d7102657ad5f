"""Columns that are not of one clock are said where friction hides it and no controller's equation tells."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from ffl.diagnose.contest.judging import judge
from ffl.diagnose.ground import Comparison, ground_of
from ffl.diagnose.predict.observer import decay_for, led, moving, with_observer
from ffl.diagnose.time_base import off_clock
from ffl.systems import EffectSpec

FRICTION = EffectSpec("coulomb_friction", {"level": 3.0})


@pytest.fixture(scope="module")
def said(stage, record):  # type: ignore[no-untyped-def]
    """What is said of a machine with these effects, its recordings passed through `logged` and its
    controller unknown, over the linear model alone."""

    def of(logged, *effects):  # type: ignore[no-untyped-def]
        runs = [r[:2150] for r in record(replace(stage, effects=effects))]
        logs = [replace(logged(r), source=f"run_{k}.csv") for k, r in enumerate(runs)]
        ground = ground_on(stage, logs[:1], logs[1:])
        return off_clock(ground, judge(ground.scene, ground.held, ground.told))

    return of


def ground_on(stage, fitted, judging):  # type: ignore[no-untyped-def]
    """The ground of recordings of the stage whose controller is unknown."""
    decay = decay_for([*fitted, *judging])
    leading = with_observer(replace(stage, controller=None), decay)
    groups = (led(moving(group)) for group in (fitted, judging))
    ground = ground_of(
        Comparison(leading, *groups, True, decay / (2.0 * np.pi)), [], lambda line: None
    )
    assert ground is not None
    return ground


@pytest.fixture(scope="module")
def three_runs(stage, record):  # type: ignore[no-untyped-def]
    """Two recordings of one kind of moves and one of another, of a machine with friction."""
    rubbing = replace(stage, effects=(FRICTION,))
    runs = [record(rubbing, 0)[0], record(rubbing, 1)[0], record(rubbing, 2)[1]]
    return [replace(r, source=f"run_{k}.csv") for k, r in enumerate(runs)]


@pytest.mark.parametrize("samples", [3, -6])
def test_one_recording_whose_command_is_stamped_otherwise_is_told_by_its_name(
    three_runs, stage, samples
):
    first, second, judging = three_runs
    ground = ground_on(stage, [first, late(second, samples)], [judging])
    fault = off_clock(ground, judge(ground.scene, ground.held, ground.told))
    assert (fault.kind, fault.recording) == ("shift", "run_1.csv")
    way = "late" if samples > 0 else "early"
    assert f"u is {abs(samples)} samples" in fault.mend
    assert f"{way} against y in this recording, not in the others" in fault.mend


def test_so_is_one_that_judges(three_runs, stage):
    first, second, judging = three_runs
    for samples, said in ((0, None), (4, "run_2.csv")):
        logged = late(judging, samples) if samples else judging
        ground = ground_on(stage, [first, second], [logged])
        standing = judge(ground.scene, ground.held, ground.told.with_effect(FRICTION))
        fault = off_clock(ground, standing)
        assert (fault and fault.recording) == said


def late(recording, k):  # type: ignore[no-untyped-def]
    """Its command stamped k samples late."""
    n = len(recording)
    sent = recording[: n - k] if k > 0 else recording[-k:]
    return replace(recording[k:] if k > 0 else recording[:k], u=sent.u, f=sent.f)


def slow(recording, rate):  # type: ignore[no-untyped-def]
    """Its y logged by a clock that is so much slow."""
    at = recording.t * (1.0 + rate)
    known = at <= recording.t[-1]
    y = CubicSpline(recording.t, recording.y)(at[known])
    return replace(recording[: int(known.sum())], y=y)


@pytest.mark.parametrize("k", [1, 6, 23])
def test_a_command_that_is_stamped_late_beside_a_friction_is_said(said, k):
    fault = said(lambda r: late(r, k), FRICTION)
    assert (fault.kind, fault.recording) == ("shift", "run_0.csv")
    assert told(fault) == (k, 0.0)


def told(fault):  # type: ignore[no-untyped-def]
    """(samples late, per cent that y's clock is slow) of what is said."""
    late = re.search(r"answers u (\d+) sample", fault.mend)
    rate = re.search(r"clock is ([\d.e-]+) % (slow|fast)", fault.mend)
    sign = 0.0 if rate is None else 1.0 if rate[2] == "slow" else -1.0
    return int(late[1]) if late else 0, sign * float(rate[1]) if rate else 0.0


@pytest.mark.parametrize("rate", [2e-3, -3e-3])
def test_a_clock_that_runs_otherwise_is_said(said, rate):
    fault = said(lambda r: slow(r, rate), FRICTION)
    assert fault.kind == "shift"
    assert told(fault) == (0, pytest.approx(100.0 * rate, rel=0.1))


def test_both_are_said_of_recordings_that_begin_by_day(said):
    def by_day(recording):  # type: ignore[no-untyped-def]
        logged = late(slow(recording, 2e-3), 5)
        return replace(logged, t=logged.t + 4e4)

    fault = said(by_day, FRICTION)
    assert told(fault) == (pytest.approx(5, abs=1), pytest.approx(0.2, rel=0.2))


@pytest.mark.parametrize(
    "effect",
    [
        FRICTION,
        EffectSpec("stribeck_friction", {"coulomb_level": 2.0, "static_level": 5.0,
                                         "stribeck_velocity": 0.02}),
        EffectSpec("input_delay", {"delay": 5e-3}),
        EffectSpec("actuator_lag", {"time_constant": 8e-3}),
        EffectSpec("hardening_spring", {"cubic_coefficient": 6e4, "centre": 0.05}),
        EffectSpec("cogging", {"amplitude": 3.0, "period": 0.02, "phase": 0.3}),
    ],
)  # fmt: skip
def test_physics_is_no_clock(said, effect):
    assert said(lambda r: r, effect) is None


def test_a_command_that_is_stamped_early_is_a_delay(said):
    assert said(lambda r: late(r, -6), FRICTION) is None


def test_what_is_left_as_noise_is_not_asked(said):
    assert said(lambda r: late(r, 6)) is not None
    assert said(lambda r: r) is None

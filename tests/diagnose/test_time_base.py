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
        bare = replace(stage, controller=None)
        decay = decay_for(logs)
        one, other = ([r] for r in led(moving(logs)))
        seen = Comparison(with_observer(bare, decay), one, other, True, decay / (2.0 * np.pi))
        ground = ground_of(seen, [], lambda line: None)
        assert ground is not None
        return off_clock(ground, judge(ground.scene, ground.held, ground.told))

    return of


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

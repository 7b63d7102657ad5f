"""Samples that are missing with their time counted on, and angles that start again after a turn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.recordings import Recording
from ffl.recordings.jumps import jumps, missing, missing_findings, turns, unwrapped

STEP = 0.001
LOST = ((900, 40), (1700, 25))


def path(n: int = 3000) -> np.ndarray:
    t = STEP * np.arange(n)
    return 0.3 * np.sin(2 * np.pi * 0.8 * t) + 0.1 * np.sin(2 * np.pi * 2.3 * t)


def recorded(kept: np.ndarray | slice = slice(None), noise: float = 1e-5) -> Recording:
    """Samples `kept` of a run, their times counted anew."""
    r = path()
    rng = np.random.default_rng(0)
    y = np.roll(r, 4) + noise * rng.standard_normal(len(r))
    y[:4] = r[0]
    u = np.gradient(np.gradient(y)) + 0.1 * rng.standard_normal(len(r))
    columns = {"r": r[kept], "u": u[kept], "y": y[kept]}
    n = len(columns["y"])
    return Recording(
        t=STEP * np.arange(n), f=np.zeros(n), source="run", sample_time=STEP, **columns
    )


def without(blocks: tuple[tuple[int, int], ...]) -> np.ndarray:
    kept = np.ones(3000, bool)
    for first, count in blocks:
        kept[first : first + count] = False
    return kept


def test_where_samples_are_missing_r_and_y_jump_together():
    found = missing(recorded(without(LOST)))
    assert [k for k, _ in found] == [900, 1700 - 40]
    (finding,) = missing_findings(recorded(without(LOST)))
    assert (finding.kind, finding.severity, finding.value) == ("samples_missing", "fault", 2.0)
    assert "at 0.9 s and 1 more times" in finding.text


@pytest.mark.parametrize("noise", [0.0, 1e-5, 1e-3])
def test_a_whole_recording_misses_none(noise):
    assert missing(recorded(noise=noise)) == []


def test_a_step_of_the_reference_is_no_gap_nor_a_sensor_that_jumps_alone():
    whole = recorded()
    stepped = np.where(np.arange(3000) < 1500, whole.r, whole.r + 0.2)
    assert len(jumps(stepped)) == 1
    assert missing(replace(whole, r=stepped)) == []
    assert missing(replace(whole, y=whole.y + stepped - whole.r)) == []


@pytest.mark.parametrize("turn", [360.0, 2 * np.pi, 1.0])
def test_an_angle_goes_on_over_the_turn(turn):
    whole = recorded()
    whole = replace(whole, r=6.0 * turn * whole.r, y=6.0 * turn * whole.y)
    wrapped = replace(whole, y=np.mod(whole.y, turn))
    assert len(turns(wrapped.y, turn)) > 5
    mended, often = unwrapped(wrapped, turn)
    assert often == len(turns(wrapped.y, turn))
    np.testing.assert_allclose(mended.y, whole.y, atol=1e-9 * turn)
    both, _ = unwrapped(replace(whole, y=wrapped.y, r=np.mod(whole.r, turn)), turn)
    apart = (both.r - both.y) - (whole.r - whole.y)
    np.testing.assert_allclose(apart, 0.0, atol=1e-9 * turn)


def test_what_does_not_turn_over_is_as_it_was():
    whole = recorded()
    assert unwrapped(whole, 360.0) == (whole, 0)
    stepped = np.where(np.arange(3000) < 1500, whole.y, whole.y + 250.0)
    assert len(turns(stepped, 360.0)) == 0  # no turn is left over by this much

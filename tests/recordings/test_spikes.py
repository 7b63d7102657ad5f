"""Samples of y that no machine moved to are told from stops, steps and noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_loops import loop

from ffl.recordings import soundness
from ffl.recordings.spikes import spikes, without_spikes


def glitched(recording, at, height):
    y = recording.y.copy()
    y[at] += height
    return replace(recording, y=y)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.floats(60.0, 1e4), st.sampled_from([-1.0, 1.0]))
def test_spikes_are_found_where_they_are_and_nowhere_else(seed, far, sign):
    """Of 60 standard deviations of the noise and more. (Of 800 sets of five one is missed in 10 at 40, in 1
    at 50, in none at 60.)"""
    rng = np.random.default_rng(seed)
    recording = loop(rng)
    at = np.sort(rng.choice(np.arange(10, 3990, 7), 5, replace=False))
    bad = glitched(recording, at, sign * far * 2e-6)
    assert spikes(bad.y).tolist() == at.tolist()
    assert np.abs(without_spikes(bad.y, at) - recording.y).max() < 20e-6


@pytest.mark.parametrize("friction", [0.0, 2.0])
def test_a_machine_that_moves_sticks_and_stops_has_none(rng, friction):
    assert len(spikes(loop(rng, friction=friction).y)) == 0


@pytest.mark.parametrize(
    "spoilt",
    [
        lambda y: np.minimum(y, 0.7 * y.max()),  # a sensor that ends
        lambda y: np.where(np.arange(len(y)) // 400 == 2, y[800], y),  # one that freezes
        lambda y: y + 1e-3 * (np.arange(len(y)) > 1000),  # one that loses its counts
        lambda y: y + 1e-3 * np.isin(np.arange(len(y)), (1000, 1001)),  # two samples: not one
        lambda y: np.abs(y - 0.05),  # a kink that is alone
    ],
)
def test_what_is_no_single_sample_is_no_spike(rng, spoilt):
    assert len(spikes(spoilt(loop(rng).y))) == 0


def test_many_are_no_accidents(rng):
    recording = loop(rng)
    assert len(spikes(glitched(recording, np.arange(10, 3990, 20), 1e-3).y)) == 0


def test_soundness_says_when(rng):
    found = soundness(glitched(loop(rng), [500, 900], 1e-3)).of("spikes")
    assert [f.severity for f in found] == ["warning"]
    assert "2 times, at 0.5 s, 0.9 s" in found[0].text
    assert found[0].time_s == ((0.5, 0.5), (0.9, 0.9))

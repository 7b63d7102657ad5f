"""Columns of maps of a history: what a motion or a command leaves behind, at many time constants."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ffl.effects import Motion
from ffl.systems.state_space import Array

Ranges = Mapping[str, tuple[float, float]]

MEMORIES = 7  # time constants of a history, from a few samples to the length of a recording


def memories(ranges: Ranges) -> Array:
    """Time constants of a history, s."""
    step, duration = ranges["step"]
    return np.geomspace(4 * step, duration, MEMORIES)


def low_pass(x: Array, tau: float, step: float, begun: float = 0.0) -> Array:
    """First-order lag that stood at `begun` before the first sample."""
    from scipy.signal import lfilter

    a = np.exp(-step / tau)
    return lfilter([1 - a], [1, -a], x, zi=[a * begun])[0]


def faded(m: Motion, ranges: Ranges, taus: Array) -> Array:
    x = m.x - m.x[0]
    return np.column_stack([x - low_pass(x, tau, m.sample_time) for tau in taus])


def heat(m: Motion, ranges: Ranges, taus: Array) -> Array:
    return np.column_stack([low_pass(m.u**2, tau, m.sample_time, m.warm) for tau in taus])


def hot_gain(m: Motion, ranges: Ranges, taus: Array) -> Array:
    return m.u[:, None] * heat(m, ranges, taus)

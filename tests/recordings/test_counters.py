"""A counter that is full and starts again, told from other jumps of y."""

from __future__ import annotations

import numpy as np
import pytest

from ffl.recordings.counters import Counter, counter_of, equal_jumps
from ffl.recordings.sensor_findings import quantisation_step

STEP = 2.5e-6
T = 0.001 * np.arange(3000)
PATH = 0.2 * np.sin(2 * np.pi * 0.8 * T) + 0.06 * np.sin(2 * np.pi * 2.3 * T)


def counted(x: np.ndarray, step: float = STEP) -> np.ndarray:
    return step * np.round(x / step)


def wrapped(x: np.ndarray, bits: int, step: float = STEP) -> np.ndarray:
    half = 2 ** (bits - 1)
    return step * (np.mod(np.round(x / step) + half, 2 * half) - half)


@pytest.mark.parametrize(
    ("bits", "resolution"), [(8, 0.0), (12, 0.0), (16, 0.0), (8, 1.0), (16, 1.0), (24, 1.0)]
)
def test_a_full_counter_is_told_by_its_bits(bits, resolution):
    """Of steps as y shows them, or as stated (of 2^24 no 3,000 samples show one)."""
    step = 0.16384 / 2**bits
    y = wrapped(PATH, bits, step)
    found = counter_of(y, resolution * step)
    assert found is not None
    assert found.bits == bits
    assert found.range == pytest.approx(0.16384, rel=1e-9)


def test_one_way_and_once_is_enough():
    y = wrapped(0.1 * (T / T[-1]) ** 2, 16)
    assert np.sum(np.abs(np.diff(y)) > 0.1) == 1
    assert counter_of(y) == Counter(pytest.approx(STEP), 16)


def test_a_resolution_that_is_not_the_counter_s_does_not_hide_it():
    found = counter_of(wrapped(PATH, 16), 1e-6)
    assert found == Counter(pytest.approx(STEP), 16)


def test_a_range_of_no_power_of_two_is_none_but_its_jumps_are_equal():
    y = STEP * np.mod(np.round(PATH / STEP), 50_000)
    assert counter_of(y) is None
    assert equal_jumps(y) == pytest.approx(50_000 * STEP, rel=1e-3)


def test_where_noise_hides_the_steps_the_jumps_are_equal():
    y = wrapped(PATH, 16) + 1e-6 * np.random.default_rng(0).standard_normal(len(T))
    assert counter_of(y) is None
    assert equal_jumps(y) == pytest.approx(0.16384, rel=1e-3)


def cut(rows: np.ndarray | slice) -> np.ndarray:
    return np.delete(counted(PATH), rows)


RESTS = np.where((T // 0.5) % 2 == 0, 0.0, 2**16 * STEP)  # all moves between two places cut out
TOGGLES = np.where((T // 0.1) % 2 == 0, 0.0, 4079 * STEP)  # two levels 2^12 steps apart, or nearly
TREMBLE = STEP * np.random.default_rng(3).integers(-8, 9, len(T))
LIMIT_CYCLE = STEP * (np.arange(3000) // 7 % 2)


@pytest.mark.parametrize(
    "y",
    [
        counted(PATH),
        PATH,
        cut(slice(900, 1000)),
        cut(np.r_[900:960, 1700:1760]),
        counted(np.where(T < 1.5, PATH, PATH + 2**16 * STEP)),  # counts lost: as many as there are
        counted(np.where(T // 0.4 % 2 == 0, PATH, PATH - 0.1)),
        RESTS,
        RESTS + STEP * np.random.default_rng(1).integers(-1, 2, len(T)),
        TOGGLES + TREMBLE,
        LIMIT_CYCLE,
        1e6 * LIMIT_CYCLE,
        counted(1e-3 * np.random.default_rng(2).standard_normal(len(T))),
        counted(PATH[::150]),  # 0.2 of the range in a sample
        np.full(100, 0.3),
        np.where(T > 2.9, np.nan, PATH),
        PATH[:2],
    ],
)
def test_other_jumps_are_no_counter(y):
    assert counter_of(y) is None
    assert counter_of(y, STEP) is None
    assert equal_jumps(y) is None


def test_a_sample_that_moves_by_a_quarter_of_the_range_is_carried_on_too():
    fast = 0.5 * np.sin(2 * np.pi * 0.5 * T[::25])
    y = wrapped(fast, 16)
    assert np.abs(np.diff(fast)).max() > 0.2 * 2**16 * STEP
    assert quantisation_step(y) != pytest.approx(STEP)  # too few samples to show it
    assert counter_of(y, STEP) == Counter(STEP, 16)

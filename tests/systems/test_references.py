"""Moves respect every limit; multisines have the lines and the size asked for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ffl.errors import InputError
from ffl.systems import Move, moves, multisine

T = 1e-3
limit = st.floats(-1.5, 1.5).map(lambda x: 10.0**x)


@given(st.floats(-3, 0.5), limit, limit, limit)
def test_moves_arrive_and_keep_their_limits(log_distance, velocity, acceleration, ratio):
    distance, jerk = 10.0**log_distance, acceleration * 10 * ratio
    move = Move(0.1, distance, velocity, acceleration, jerk)
    from ffl.systems.references import move_times

    duration = 0.2 + sum(move_times(move)) + 5 * T
    if duration > 60:
        return
    r = moves([move], duration, T)
    assert r[0] == 0
    assert r[-1] == pytest.approx(distance)
    steps = np.diff(r)
    slack = 1 + 1e-9
    assert np.abs(steps).max() / T <= velocity * slack
    assert np.abs(np.diff(r, 2)).max() / T**2 <= acceleration * slack
    third = np.abs(np.diff(r, 3)).max() / T**3
    assert third <= jerk * slack + 1e-6 * jerk + 1e-13 / T**3


@pytest.mark.parametrize("distance", [0.0, 1e-30, 1e-9])
def test_a_move_of_next_to_nothing_takes_next_to_no_time(distance):
    from ffl.systems.references import move_times

    times = move_times(Move(0.1, distance, 1.0, 1.0, 50.0))
    assert sum(times) <= 0.01
    if distance:
        assert distance / times[0] <= 1.0
        assert distance / np.prod(times[:3]) <= 50.0 * (1 + 1e-9)


def test_a_long_move_uses_its_limits_and_rests_before():
    r = moves([Move(1.0, 0.5, 0.2, 2.0, 50.0)], 6.0, T)
    assert np.all(r[:1000] == 0)
    assert np.abs(np.diff(r)).max() / T == pytest.approx(0.2, rel=1e-6)
    assert np.abs(np.diff(r, 2)).max() / T**2 == pytest.approx(2.0, rel=0.03)


@pytest.mark.parametrize(
    ("sequence", "duration", "message"),
    [
        ([Move(0.0, 0.1, 1, 1, 10)], 5.0, "at rest"),
        ([Move(0.5, 0.1, 1, 1, 10), Move(0.6, 0.1, 1, 1, 10)], 9.0, r"moves\[1\].start"),
        ([Move(0.5, 10.0, 1, 1, 10)], 3.0, "lengthen"),
        ([Move(0.5, 0.1, -1, 1, 10)], 3.0, "velocity = -1"),
        ([Move(0.5, np.nan, 1, 1, 10)], 3.0, "distance"),
        ([], 1e-4, "fewer than 2"),
    ],
)
def test_impossible_moves_are_refused(sequence, duration, message):
    with pytest.raises(InputError, match=message):
        moves(sequence, duration, T)


def test_multisine_has_its_band_size_and_rest():
    rng = np.random.default_rng(3)
    r = multisine((2.0, 20.0), 0.01, 3.0, T, rng, rest=0.5)
    body = r[500:2500]
    assert np.all(r[:500] == 0)
    assert np.all(r[2500:] == 0)
    assert np.sqrt(np.mean(body**2)) == pytest.approx(0.01)
    power = np.abs(np.fft.rfft(body)) ** 2
    f = np.fft.rfftfreq(2000, T)
    inside = (f >= 2.0) & (f <= 20.0)
    assert power[~inside].max() < 1e-20 * power.max() + 1e-18
    tapered = multisine((2.0, 20.0), 0.01, 3.0, T, rng, rest=0.5, taper=0.1)
    assert abs(tapered[500]) < 1e-12
    whole = multisine((2.0, 20.0), 0.01, 3.0, T, rng, rest=0.5, taper=1.0)
    for r in (tapered, whole):
        assert np.sqrt(np.mean(r[500:2500] ** 2)) == pytest.approx(0.01)
    with pytest.raises(InputError, match="holds no multiple"):
        multisine((2.01, 2.02), 0.01, 3.0, T, rng)
    with pytest.raises(InputError, match="no room"):
        multisine((2.0, 20.0), 0.01, 1.0, T, rng, rest=0.5)

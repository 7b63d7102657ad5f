"""What is said where a held-out recording goes beyond all that was fitted."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose.proof.unvisited import unvisited

STEP = 1e-3
T = STEP * np.arange(4000)


def _swing(size, frequency=1.0):  # type: ignore[no-untyped-def]
    return SimpleNamespace(y=size * np.sin(2 * np.pi * frequency * T), sample_time=STEP)


def test_places_that_no_fitted_recording_passed_are_told_with_their_share():
    said = unvisited(
        ["position_dependent_friction"], [_swing(0.1), _swing(0.2)], [_swing(0.4)], "m"
    )
    assert said is not None
    assert "65 % of them at a position outside -0.2 to 0.2 m" in said  # 1 - 2/pi asin 0.52
    assert "velocity" not in said


def test_speeds_that_no_fitted_recording_had_are_told():
    said = unvisited(["quadratic_drag"], [_swing(0.2)], [_swing(0.2, 2.0)], "m")
    assert said is not None
    assert "at a velocity outside" in said
    assert float(said.split(" to ")[1].split(" ")[0]) == pytest.approx(0.4 * np.pi, rel=0.01)


@pytest.mark.parametrize("name", ["position_dependent_friction", "viscous_friction"])
def test_within_what_was_fitted_nothing_is_said(name):
    assert unvisited([name], [_swing(0.2)], [_swing(0.2), _swing(0.1)], "m") is None


def test_an_effect_that_asks_for_neither_is_known_everywhere():
    assert unvisited(["drift"], [_swing(0.1)], [_swing(0.4)], "m") is None
    assert unvisited([], [_swing(0.1)], [_swing(0.4)], "m") is None


def test_of_an_output_that_is_a_speed_the_speed_itself_is_looked_at():
    """Other accelerations are no other speeds."""
    slow, faster, quicker = _swing(10.0), _swing(60.0), _swing(10.0, 5.0)
    assert unvisited(["stribeck_friction"], [slow], [quicker], "rad/s") is None
    said = unvisited(["stribeck_friction"], [slow], [faster], "rad/s")
    assert said is not None
    assert "at a velocity outside -10 to 10 rad/s:" in said

"""A map in proportion to the speed, at the sensor: y is early, which is a matter of clocks."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.maps.formula import Formula
from ffl.diagnose.maps.outcome import Contest
from ffl.diagnose.proof.conclude import ahead

SPEEDS = np.linspace(-0.4, 0.6, 33)


def found(values, port="output", variables=("velocity",)):  # type: ignore[no-untyped-def]
    """A contest that one map won."""
    part = SimpleNamespace(place=Place(port, "motor"))
    winner = SimpleNamespace(parts=(part,))
    said = Formula("", SPEEDS, values, 1.0)
    return Contest("unnamed", winner, None, 0.0, 0.0, None, variables, formulas=(said,))  # type: ignore[arg-type]


def test_the_slope_over_the_speed_is_the_lead():
    assert ahead(found(5e-4 * SPEEDS)) == pytest.approx(5e-4)


@pytest.mark.parametrize(
    "contest",
    [
        found(-5e-4 * SPEEDS),  # late: a delay, which has a name
        found(5e-4 * SPEEDS + 1e-6),
        found(5e-4 * SPEEDS**3),
        found(5e-4 * SPEEDS, port="force"),
        found(5e-4 * SPEEDS, variables=("position",)),
        Contest("unnamed", None, None, 0.0, 0.0, None),
    ],
)
def test_nothing_else_is(contest):
    assert ahead(contest) is None

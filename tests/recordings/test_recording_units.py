"""Units that measure the same, and the mistakes that leave a factor."""

import math

import pytest

from ffl.recordings.units import factor_between, looks_like, turn_in

TURN = math.pi / 180


@pytest.mark.parametrize(
    ("one", "other", "factor"),
    [
        ("mm", "m", 1e-3), ("[µm]", "mm", 1e-3), ("rpm", "rad/s", 6 * TURN),
        ("°", "rad", TURN), ("N·m", "Nm", 1.0), ("km/h", "m/s", 1 / 3.6), ("kN", "N", 1e3),
        ("mm / s", "m/s", 1e-3), ("V", "A", None), ("mm", "rad", None),
        ("counts", "m", None), ("", "m", None),
    ],
)  # fmt: skip
def test_factor_between_units(one, other, factor):
    found = factor_between(one, other)
    assert found is None if factor is None else found == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (9.6, "rpm for rad/s"), (1.01 / 57.3, "degrees for radians"), (1003.0, "a thousand"),
        (9.9, "the earth's pull or ten"), (7.7, ""), (-1000.0, "a thousand"), (39.5, "inches for metres"),
    ],
)  # fmt: skip
def test_a_factor_has_the_name_of_the_mistake(factor, said):
    assert looks_like(factor) == said


def test_arcseconds_are_angles():
    assert factor_between("arcsec", "deg") == pytest.approx(1.0 / 3600.0)
    assert turn_in("arcsec") == pytest.approx(1_296_000.0)
    assert turn_in("arcmin") == pytest.approx(21_600.0)

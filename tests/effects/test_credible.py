"""Numbers that stand in for other physics are not those of the effect they are named for."""

from __future__ import annotations

import numpy as np
import pytest

from ffl.effects import EFFECTS
from ffl.effects.base import Extent
from ffl.systems import Zpk
from ffl.systems.plant import EffectSpec, Plant


@pytest.mark.parametrize(("centre", "believed"), [(0.0, True), (9.0, True), (33.7, False)])
def test_a_spring_that_begins_far_beyond_the_travel_is_another_curve(centre, believed):
    extent = Extent(5.0, travel=12.0, lowest=-6.0, highest=6.0)
    spec = EffectSpec("hardening_spring", {"cubic_coefficient": 1.0, "centre": centre})
    assert EFFECTS[spec.name].credible(spec, extent) is believed


def test_a_slow_lag_is_told_in_seconds():
    plant = Plant("mass", Zpk(np.array([-1.0]), np.array([1.0, 1.0]), 1e-6, 1e-3))
    said = EFFECTS["actuator_lag"].says
    assert said({"time_constant": 4.97}, plant).endswith("lag of 4.97 s.")
    assert said({"time_constant": 0.002}, plant).endswith("lag of 2 ms.")

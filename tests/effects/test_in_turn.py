"""The order of a plant file's entries is of no matter to a mass that changes everywhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.effects import effect_of
from ffl.effects.linear_mechanics import in_turn, mechanics_with_effects
from ffl.machines import Simulator
from ffl.systems import EffectSpec, Physics, Plant, Zpk

T = 1e-3
PLANT = Plant(
    "cart", Zpk([-1.0], [1.0, 1.0], T * T / 4, T), None, "N", "m", "", Physics(2.0, 1.0)
)  # 2 kg
HEAVIER = EffectSpec("mass_change", {"change": 1.0}, {"side": "all"})
DAMPER = EffectSpec("viscous_friction", {"coefficient": 4.0})
SPRING = EffectSpec("linear_stiffness", {"stiffness": 10.0, "centre": 0.1})


@pytest.mark.parametrize("beside", [DAMPER, SPRING])
def test_who_was_found_first_is_no_matter(beside):
    u = np.ones(9000)
    one, other = (
        Simulator(PLANT).run(effects, feedforward=u)
        for effects in ((HEAVIER, beside), (beside, HEAVIER))
    )
    np.testing.assert_array_equal(one.y, other.y)
    heavier = replace(PLANT, system=replace(PLANT.system, gain=PLANT.system.gain / 2))
    np.testing.assert_allclose(one.y, Simulator(heavier).run((beside,), feedforward=u).y, rtol=1e-6)


def test_a_damper_is_what_it_is_whatever_the_mass():
    """1 N over 4 N s/m is 0.25 m/s in the end."""
    run = Simulator(PLANT).run((DAMPER, HEAVIER), feedforward=np.ones(9000))
    assert run.v[-1] == pytest.approx(0.25, abs=1e-4)


def test_the_linear_part_is_the_same_by_either_order():
    a, b = (
        mechanics_with_effects(replace(PLANT, effects=effects)).a
        for effects in ((HEAVIER, DAMPER, SPRING), (DAMPER, SPRING, HEAVIER))
    )
    np.testing.assert_array_equal(a, b)


def test_a_part_that_hangs_is_more_as_well():
    """Parts first, then the mass of all, then forces; without such a mass the order is the file's."""
    part = EffectSpec("flexible_mode", {"frequency": 40.0, "damping": 0.1, "mass_fraction": 0.3})
    effects = (DAMPER, HEAVIER, part)
    catalogue = [effect_of(spec) for spec in effects]
    assert in_turn(catalogue, effects) == [2, 1, 0]
    assert in_turn(catalogue[::2], effects[::2]) == [0, 1]
    u = np.sin(0.05 * np.arange(4000))
    one, other = (Simulator(PLANT).run(e, feedforward=u).y for e in (effects, effects[::-1]))
    np.testing.assert_array_equal(one, other)
    heavier = replace(PLANT, system=replace(PLANT.system, gain=PLANT.system.gain / 2))
    alone = Simulator(heavier).run((part, DAMPER), feedforward=u).y
    np.testing.assert_allclose(one, alone, atol=1e-6 * np.abs(alone).max())

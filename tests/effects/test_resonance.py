"""A part on a spring told by the pole that it gives the machine."""

from dataclasses import replace

import numpy as np
import pytest
from cases import STAGE
from two_masses import FREQUENCY, two_mass_plant

from ffl.effects.linear_mechanics import as_seen, mechanics_with_effects
from ffl.effects.mechanics import Mechanics
from ffl.effects.resonance import pole_of, resonance_of
from ffl.errors import InputError
from ffl.systems.plant import EffectSpec

PART = {"frequency": 1.4 * FREQUENCY, "damping": 0.012, "mass_fraction": 0.11}


def with_part(options=(), **numbers):
    spec = EffectSpec("flexible_mode", {**PART, **numbers}, {"side": "motor", **dict(options)})
    return replace(two_mass_plant("motor"), effects=(spec,))


def poles(plant):
    found = np.linalg.eigvals(mechanics_with_effects(plant).a)
    return found[found.imag > 0.0]


def nearest(plant, frequency, damping):
    pole = pole_of(frequency, damping)
    return np.min(np.abs(poles(plant) - pole)) / abs(pole)


@pytest.mark.parametrize("frequency", [0.55 * FREQUENCY, 1.4 * FREQUENCY, 3.0 * FREQUENCY])
def test_the_machine_resonates_where_it_is_told_to(frequency):
    whole = with_part({"resonance": "machine"}, frequency=frequency, damping=0.03)
    assert nearest(whole, frequency, 0.03) < 1e-9
    assert nearest(with_part(frequency=frequency, damping=0.03), frequency, 0.03) > 1e-3


def test_what_is_seen_is_a_pole_and_the_same_machine():
    plant = with_part()
    seen = as_seen(plant, 1)
    (told,) = seen.effects
    assert told.options["resonance"] == "machine"
    assert nearest(plant, told.parameters["frequency"], told.parameters["damping"]) < 1e-9
    assert abs(told.parameters["frequency"] / PART["frequency"] - 1.0) > 0.02
    before, after = mechanics_with_effects(plant).a, mechanics_with_effects(seen).a
    assert np.abs(before - after).max() < 1e-10 * np.abs(before).max()
    assert as_seen(plant, 0) == plant  # what a plant file states stays as it states it
    again = as_seen(seen, 1).effects[0].parameters
    assert again == pytest.approx(told.parameters, rel=1e-7)


def test_the_pole_of_a_part_is_the_one_that_its_spring_stores_most_of():
    """The own mode of a machine does not become the part's, wherever the part is put."""
    for ratio in (0.4, 0.7, 1.4, 2.5):
        whole: Mechanics = mechanics_with_effects(with_part(frequency=ratio * FREQUENCY))
        frequency, _ = resonance_of(whole.a, whole.point("flexible_mode"))
        assert (frequency > FREQUENCY) == (ratio > 1.0)


def test_no_part_takes_a_machine_to_where_its_own_mode_is():
    with pytest.raises(InputError, match=r'no spring and damper .* take resonance = "nearby"'):
        poles(with_part({"resonance": "machine"}, frequency=FREQUENCY))
    with pytest.raises(InputError, match="damping below 1"):
        poles(with_part({"resonance": "machine"}, damping=1.0))


def test_a_part_that_does_not_ring_stays_as_it_is():
    """A rigid stage and a part damped beyond ringing: no pole oscillates."""
    slack = EffectSpec("flexible_mode", {**PART, "damping": 1.0, "mass_fraction": 0.5})
    plant = replace(STAGE, effects=(slack,))
    assert all(pole.imag < 1e-4 for pole in poles(plant))
    assert as_seen(plant, 1) == plant

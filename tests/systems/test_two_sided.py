"""Two-sided filtering against closed forms and frequency responses."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ffl.errors import InputError
from ffl.systems import (
    Move,
    Zpk,
    exact_inverse,
    load_plant,
    moves,
    settling_samples,
    split,
    two_sided_filter,
    two_sided_impulse,
)


def test_example_6_of_the_kernel_paper():
    """P = (z-2)/z, r = 0.5^t: the bounded feedforward is -4/3 2^t before 0, -1/3 0.5^t after."""
    plant = Zpk([2.0], [0.0], 1.0, 1.0)
    t = np.arange(-80, 80)
    r = np.where(t >= 0, 0.5 ** np.maximum(t, 0), 0.0)
    f = two_sided_filter(plant.inverse(), r[80:], before=80)
    expected = np.where(t < 0, -4 / 3 * 2.0**t, -1 / 3 * 0.5 ** np.maximum(t, 0))
    assert np.abs(f - expected).max() < 1e-12
    assert np.abs(plant.filter(f) - r).max() < 1e-12


@pytest.mark.parametrize("name", ["flatbed_printer", "flatbed_printer_built"])
def test_inverse_of_the_printer_is_exact_at_every_frequency(name):
    plant = load_plant(name).system
    before, after = settling_samples(plant.inverse())
    theta = two_sided_impulse(plant.inverse(), before, after)
    f = np.geomspace(0.1, 499, 60)
    transform = np.exp(-2j * np.pi * np.outer(f, np.arange(-before, after + 1)) * 1e-3) @ theta
    inverse = 1 / plant.response(f)
    # P^-1 spans six decades, so the taps of 8e5 leave 1e-13 of that at its lowest frequencies
    assert np.abs(transform - inverse).max() < 1e-12 * np.abs(inverse).max()
    assert np.abs(transform / inverse - 1).max() < 1e-6


def test_inverse_followed_by_the_plant_gives_the_reference_back():
    plant = load_plant("kernel2018_loop")
    from ffl.systems import as_zpk

    tracking = as_zpk(plant.loop.reference_to_output)
    reference = np.random.default_rng(0).standard_normal(400)
    inversion = exact_inverse(tracking, reference)
    y = tracking.filter(inversion.feedforward)
    target = np.concatenate([np.zeros(inversion.before), reference, np.zeros(inversion.after)])
    assert np.abs(y - target).max() < 1e-7
    assert inversion.tail == 0.0


def test_a_short_window_states_what_it_cuts():
    plant = load_plant("flatbed_printer").system
    reference = np.zeros(300)
    reference[150] = 1.0
    short = exact_inverse(plant, reference, before=20, after=20)
    whole = exact_inverse(plant, reference)
    lost = np.linalg.norm(whole.feedforward) ** 2 - np.linalg.norm(short.feedforward) ** 2
    assert len(short.feedforward) == 340
    assert short.tail == pytest.approx(np.sqrt(lost) / np.linalg.norm(whole.feedforward), rel=1e-6)


@given(
    st.floats(0.1, 0.97),
    st.floats(1.05, 3.0),
    st.floats(0.05, 3.0),
    st.booleans(),
    st.integers(0, 3),
)
def test_split_reproduces_the_system_on_the_unit_circle(inside, outside, angle, pair, delay):
    poles = [inside, outside]
    if pair:
        poles += [outside * np.exp(1j * angle), outside * np.exp(-1j * angle)]
    system = Zpk([0.3, -0.2], poles, 1.7, 1.0, delay)
    parts = split(system)
    z = np.exp(1j * np.linspace(0.01, np.pi, 25))
    total = z**parts.advance * (parts.causal.at(z) + parts.anticausal.at(1 / z))
    assert np.abs(total / system.at(z) - 1).max() < 1e-9
    assert parts.causal.d[0, 0] == 0.0  # the feedthrough sits with the anti-causal part, (5)
    assert np.abs(parts.anticausal.poles).max() < 1


def test_hold_keeps_a_reference_at_rest_after_its_last_sample():
    system = Zpk([0.4], [0.9, 1.2], 1.0, 1.0)
    step = np.concatenate([np.zeros(50), np.ones(50)])
    held = two_sided_filter(system, step, hold=True)
    long = two_sided_filter(system, np.concatenate([step, np.ones(400)]))[:100]
    assert np.abs(held - long).max() < 1e-12


def test_a_zero_on_the_unit_circle_is_refused_in_one_line():
    with pytest.raises(InputError, match=r"zero at -1.* on the unit circle"):
        exact_inverse(load_plant("emps").system, np.ones(10))
    with pytest.raises(InputError, match=r"pole at 1.* on the unit circle"):
        split(load_plant("emps").system)


def test_inverse_of_a_relative_degree_two_plant_starts_two_samples_ahead():
    plant = Zpk([0.5], [0.2, 0.3, -0.4], 2.0, 1.0)
    theta = two_sided_impulse(plant.inverse(), 4, 4)
    assert theta[:2] == pytest.approx([0, 0], abs=1e-15)
    assert theta[2] == pytest.approx(0.5)


def test_an_inverse_of_a_reference_that_rests_elsewhere_rests_with_it():
    """As if r fell back to zero f jumps at its last sample; held, it ends at r over the gain at rest."""
    plant = Zpk(np.array([1.2]), np.array([0.9, 0.8]), -0.5, 1e-3)
    reference = moves([Move(0.1, 0.3, 0.6, 3.0, 60.0)], 2.0, 1e-3)
    at_rest = 0.3 / float(plant.response([0.0])[0].real)
    held = exact_inverse(plant, reference, hold=True)
    dropped = exact_inverse(plant, reference)
    ends = slice(held.before, held.before + len(reference))
    assert held.feedforward[ends][-1] == pytest.approx(at_rest, rel=1e-9)
    assert np.abs(dropped.feedforward[ends]).max() > 5.0 * np.abs(held.feedforward).max()
    y = plant.filter(held.feedforward)
    assert np.abs(y[ends] - reference).max() < 1e-9
    longer = exact_inverse(plant, reference, held.before, held.after + 50, hold=True)
    assert longer.feedforward[-1] == pytest.approx(at_rest, rel=1e-9)
    assert longer.tail < 1e-9


@pytest.mark.parametrize("wrong", [{"before": -5}, {"after": 2.5}])
def test_an_inverse_wants_whole_numbers_of_samples(wrong):
    plant = Zpk(np.array([1.2]), np.array([0.9, 0.8]), -0.5, 1e-3)
    with pytest.raises(InputError, match="give a whole number from 0 on"):
        exact_inverse(plant, np.zeros(10), **wrong)

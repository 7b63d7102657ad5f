"""Sections keep every zero and pole; state space, zpk and frequency response agree."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import freqz_zpk

from ffl.errors import InputError
from ffl.systems import (
    StateSpace,
    Zpk,
    as_zpk,
    from_control,
    load_plant,
    series,
    to_control,
    zero_order_hold,
)

roots = st.tuples(
    st.lists(st.floats(-0.95, 0.95), min_size=0, max_size=3),
    st.lists(st.tuples(st.floats(0.1, 0.97), st.floats(0.1, 3.0)), max_size=2),
)


def both(parts):
    real, polar = parts
    pairs = [r * np.exp(s * 1j * a) for r, a in polar for s in (1, -1)]
    return np.array([*real, *pairs], complex)


@given(roots, roots, st.integers(0, 3))
def test_section_state_space_has_the_response_of_the_factors(zeros, poles, delay):
    z, p = both(zeros), both(poles)
    z = (
        z[: len(p) + delay]
        if not np.iscomplex(z).any()
        else (z if len(z) <= len(p) + delay else z[:0])
    )
    system = Zpk(z, p, -0.7, 0.01, delay)
    f = np.linspace(0.3, 49, 20)
    w, expected = freqz_zpk(z, p, -0.7, worN=2 * np.pi * f * 0.01)
    expected = expected * np.exp(1j * w * (-delay))
    scale = np.abs(expected).max()
    assert np.abs(system.response(f) - expected).max() <= 1e-9 * scale
    assert np.abs(system.state_space().response(f) - expected).max() <= 1e-8 * scale


def test_excess_poles_are_a_delay_not_lost_as_in_zpk2sos():
    """zpk2sos([], [0.5], 1) comes one sample early; 1/(z - 0.5) starts at t = 1."""
    assert Zpk([], [0.5], 1.0, 1.0).impulse_response(4) == pytest.approx([0, 1, 0.5, 0.25])
    assert Zpk([], [], 2.0, 1.0, 3).impulse_response(5) == pytest.approx([0, 0, 0, 2, 0])


def test_printer_loop_is_stable_where_polynomials_say_it_is_not():
    plant = load_plant("flatbed_printer")
    assert np.abs(plant.loop.poles).max() < 0.9995
    assert len(plant.loop.poles) == 10 + 3


def test_zeros_and_poles_survive_the_way_through_state_space():
    system = load_plant("flatbed_printer").system
    back = as_zpk(system.state_space())
    assert np.abs(np.sort_complex(back.zeros) - np.sort_complex(system.zeros)).max() < 1e-9
    # the double integrator of two nearby poles is the least certain: sqrt(eps) apart
    assert np.abs(np.sort_complex(back.poles) - np.sort_complex(system.poles)).max() < 1e-9
    assert back.gain == pytest.approx(system.gain, rel=1e-9)


def test_control_objects_in_and_out():
    system = load_plant("flatbed_printer").system
    again = from_control(to_control(system))
    f = np.geomspace(0.5, 400, 30)
    assert np.abs(again.response(f) / system.response(f) - 1).max() < 1e-9
    import control

    tf = control.tf([1.0, -0.5], [1.0, -1.6, 0.68], 0.1)
    assert (
        np.abs(
            from_control(tf).response([1.0]) - control.frequency_response(tf, 2 * np.pi).complex
        ).max()
        < 1e-12
    )


def test_continuous_control_objects_are_refused():
    import control

    with pytest.raises(InputError, match="did you forget to discretise"):
        from_control(control.tf([1.0], [1.0, 1.0]))
    with pytest.raises(InputError, match="2 inputs"):
        from_control(control.ss(np.eye(2) * 0.1, np.eye(2), np.eye(2), np.zeros((2, 2)), 0.1))


def test_zero_order_hold_of_a_double_integrator_and_a_mode():
    t = 0.01
    mass = zero_order_hold([], [0.0, 0.0], 1 / 3.0, t)
    k = np.arange(6)
    step = mass.filter(np.ones(6))
    assert step == pytest.approx((k * t) ** 2 / 2 / 3.0)
    w, d = 20.0, 0.05
    s = -d * w + 1j * w * np.sqrt(1 - d**2)
    mode = zero_order_hold([], [s, s.conjugate()], w**2, t)
    tk = np.arange(200) * t
    wd = w * np.sqrt(1 - d**2)
    exact = 1 - np.exp(-d * w * tk) * (np.cos(wd * tk) + d * w / wd * np.sin(wd * tk))
    assert mode.filter(np.ones(200)) == pytest.approx(exact, abs=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Zpk([0.5 + 0.1j], [0.2, 0.1], 1, 1.0), "without its conjugate"),
        (lambda: Zpk([], [np.nan], 1, 1.0), "NaN"),
        (lambda: Zpk([], [0.5], 0.0, 1.0), "gain"),
        (lambda: Zpk([], [0.5], 1.0, -1.0), "sample_time"),
        (lambda: Zpk([], [0.5], 1.0, 1.0, 0.5), "whole number"),
        (lambda: Zpk([1, 2.0], [0.5], 1.0, 1.0).state_space(), "more zeros than poles"),
        (lambda: StateSpace(np.eye(2), np.ones(3), np.ones(2), 0.0, 1.0), "state space: b"),
        (lambda: StateSpace(np.eye(1) * np.inf, 1, 1, 0.0, 1.0), "NaN or infinity"),
        (lambda: Zpk([], [0.5], 1, 1.0) * Zpk([], [0.5], 1, 2.0), "sample times"),
        (
            lambda: series(
                Zpk([], [0.5], 1, 1.0).state_space(), Zpk([], [0.5], 1, 2.0).state_space()
            ),
            "sample times",
        ),
        (lambda: Zpk([], [0.5], 1, 1.0).state_space().filter(np.ones((5, 2))), "2 columns"),
    ],
)
def test_wrong_systems_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()

"""Closed loops: against the frequency response, and against a loop written out by hand."""

import numpy as np
import pytest

from ffl.errors import InputError
from ffl.systems import Controller, StateSpace, Zpk, closed_loop, load_plant, zero_order_hold


@pytest.mark.parametrize("name", ["flatbed_printer", "kernel2018_loop", "emps"])
def test_transfers_of_the_loop_match_their_formulas(name):
    plant = load_plant(name)
    f = np.geomspace(0.5, 450, 40)
    p = plant.system.response(f)
    cr, cy = plant.controller.reference.response(f), plant.controller.output.response(f)
    s = 1 / (1 + p * cy)
    loop = plant.loop
    for system, expected in (
        (loop.sensitivity, s),
        (loop.process_sensitivity, s * p),
        (loop.reference_to_output, s * p * cr),
        (loop.system.select([1], [1]), s),
        (loop.system.select([1], [0]), s * cr),
        (loop.system.select([1], [2]), -s * p * cy),
    ):
        assert np.abs(system.response(f) / expected - 1).max() < 1e-7


def test_loop_equals_a_simulation_step_by_step():
    plant = load_plant("emps")
    rng = np.random.default_rng(0)
    n = 200
    r, f, w, v = rng.standard_normal((4, n)) * np.array([[1e-3], [5.0], [5.0], [1e-6]])
    y, u = plant.loop.system.filter(np.column_stack([r, f, w, v])).T
    kp, kv, gtau, t = 160.18, 243.45, 35.15, 1e-3
    measured, position, velocity = np.zeros(n), 0.0, 0.0
    for k in range(n):
        measured[k] = position + v[k]
        older = measured[k - 2] if k >= 2 else 0.0
        force = gtau * kv * (kp * (r[k] - measured[k]) - (measured[k] - older) / (2 * t)) + f[k]
        assert force == pytest.approx(u[k], rel=1e-6, abs=1e-6)
        a = (force + w[k]) / 95.1
        position, velocity = position + velocity * t + a * t**2 / 2, velocity + a * t
    assert measured == pytest.approx(y, abs=1e-12)


def test_margins_of_a_loop_with_known_ones():
    """L = 0.5/(z - 1): S = (z - 1)/(z - 0.5), |S| <= 4/3 at Nyquist; gain margin 4."""
    loop = closed_loop(Zpk([], [1.0], 0.5, 1.0), Controller.of_error(Zpk([], [], 1.0, 1.0)))
    margins = loop.margins(200_000)
    assert margins.modulus == pytest.approx(0.75, rel=1e-4)
    crossover = 2 * np.arcsin(0.25) / (2 * np.pi)
    assert margins.crossover == pytest.approx(crossover, rel=1e-3)
    assert loop.poles == pytest.approx([0.5])


def test_margins_are_roots_and_not_points_of_a_grid():
    """L = k/(z - 1): |L| = 1 at 2 sin(w/2) = k, arg L = -(pi + w)/2, L(-1) = -k/2; 50 points suffice."""
    for k in (0.5, 0.9):
        loop = closed_loop(Zpk([], [1.0], k, 1.0), Controller.of_error(Zpk([], [], 1.0, 1.0)))
        margins = loop.margins(50)
        w = 2 * np.arcsin(k / 2)
        assert margins.crossover == pytest.approx(w / (2 * np.pi), rel=1e-12)
        assert margins.phase == pytest.approx(90 - np.degrees(w / 2), rel=1e-10)
        assert (margins.gain, margins.gain_frequency) == pytest.approx((2 / k, 0.5), rel=1e-12)
        assert (margins.gain_reduction, margins.gain_reduction_frequency) == (0.0, 0.0)
        assert margins.modulus == pytest.approx(1 - k / 2, rel=1e-6)


def test_both_limits_of_the_gain_are_those_at_which_the_loop_becomes_unstable():
    """Stable in between only: the double integrator with integral action of the printer's kind."""
    plant = Zpk([], [1.0, 1.0], 1e-4, 1e-2)
    lead = Zpk([0.97, 0.99], [0.4, 1.0], 150.0, 1e-2)

    def largest(factor):
        scaled = Zpk(lead.zeros, lead.poles, lead.gain * factor, 1e-2)
        return np.abs(closed_loop(plant, Controller.of_error(scaled)).poles).max()

    margins = closed_loop(plant, Controller.of_error(lead)).margins()
    assert largest(1.0) < 1
    assert margins.gain_reduction < 1 < margins.gain < np.inf
    for factor in (margins.gain, margins.gain_reduction):
        assert largest(factor) == pytest.approx(1.0, abs=1e-7)
    assert 0 < margins.gain_reduction_frequency < margins.crossover < margins.gain_frequency


def test_the_phase_margin_stands_with_its_own_crossover():
    """A resonance crosses |L| = 1 three times; the least phase margin is not at the last."""
    mode = -10.0 + 502.5j
    plant = zero_order_hold([-12566.4], [0, 0, mode, mode.conjugate()], 3351.0, 5e-4)
    controller = zero_order_hold([-16.755, -5.0265], [0, -301.593], 87.047, 5e-4)
    margins = closed_loop(plant, Controller.of_error(controller)).margins()
    f = np.geomspace(1.0, 900.0, 400_000)
    gain = plant.response(f) * controller.response(f)
    crossings = np.flatnonzero(np.diff(np.sign(np.abs(gain) - 1)))
    phases = np.abs(np.degrees(np.angle(-gain[crossings])))
    assert len(crossings) == 3
    assert np.argmin(phases) == 1
    assert margins.phase == pytest.approx(phases[1], abs=0.05)
    assert margins.crossover == pytest.approx(f[crossings[1]], rel=1e-4)


def test_unstable_loops_and_algebraic_loops_are_refused():
    plant = load_plant("flatbed_printer")
    from dataclasses import replace

    strong = replace(plant.controller.reference, gain=plant.controller.reference.gain * 50)
    with pytest.raises(InputError, match="closed loop is unstable, pole"):
        replace(plant, controller=Controller.of_error(strong)).require_stable()
    unstable = replace(plant, system=Zpk([], [1.2], 1.0, 1e-3), controller=None)
    with pytest.raises(InputError, match=r"open-loop plant is unstable.*give a \[controller\]"):
        unstable.require_stable()
    gain = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), -1.0, 1.0)
    with pytest.raises(InputError, match="algebraic loop"):
        closed_loop(gain, Controller.of_error(Zpk([], [], 1.0, 1.0)))
    with pytest.raises(InputError, match="sample_time"):
        closed_loop(Zpk([], [0.5], 1, 1.0), Controller.of_error(Zpk([], [], 1.0, 2.0)))


@pytest.mark.parametrize("integrators", [1, 2])
def test_integrators_in_both_branches_are_those_of_the_error(integrators):
    """PID with the derivative of y alone: its integral acts on r - y, whichever branch it is written in."""
    step, ones = 1e-3, np.ones(integrators)
    mass = Zpk([-1.0], [1.0, 0.99], 1e-6, step)
    leads = np.full(integrators, 0.998)
    reference = Zpk(leads, ones, 800.0, step)
    error = Controller.of_error(reference)
    apart = Controller(reference, Zpk(leads, ones, 800.0, step))
    assert not apart.one_degree
    one, two = (closed_loop(mass, c) for c in (error, apart))
    assert two.system.order == one.system.order
    grid = np.geomspace(0.1, 400.0, 30) * step
    assert np.allclose(one.system.response(grid), two.system.response(grid), rtol=1e-8)
    with_derivative = Zpk([*leads, 0.97], [*ones, 0.7], 8000.0, step)
    weighted = Controller(Zpk(leads, ones, 800.0, step), with_derivative)
    assert weighted.state_space.order == integrators + 1
    loop = closed_loop(mass, weighted)
    assert loop.is_stable
    # At rest y is r, times what one integral makes of it for what the other does.
    at_rest = loop.system.at(np.array([1.0 + 0.0j]))[0, 0, 0].real
    assert at_rest == pytest.approx(800.0 / (8000.0 * 0.03 / 0.3), rel=1e-6)


def test_what_no_other_branch_has_stays():
    step = 1e-3
    integrates, leads = Zpk([0.998], [1.0], 800.0, step), Zpk([0.97], [0.7], 8000.0, step)
    for reference, output in ((integrates, leads), (leads, integrates)):
        assert Controller(reference, output).state_space.order == 2
    gains = Controller(Zpk([], [], 3.0, step), Zpk([], [], 2.0, step)).state_space
    assert gains.order == 0
    assert gains.d.tolist() == [[3.0, -2.0]]


def test_an_open_loop_machine_may_integrate():
    from dataclasses import replace

    plant = replace(load_plant("emps"), controller=None)
    assert plant.require_stable().system.select([1], [1]).response([3.0]) == pytest.approx([1.0])


def test_margins_of_a_loop_slower_than_its_sampling_by_far():
    slow = Zpk(np.zeros(0), np.array([1.0]), 1e-5, 1e-3)  # 0.01/s
    one = Zpk(np.zeros(0), np.zeros(0), 1.0, 1e-3)
    margins = closed_loop(slow, Controller.of_error(one)).margins()
    assert margins.crossover == pytest.approx(0.01 / (2 * np.pi), rel=1e-2)
    assert margins.phase == pytest.approx(90.0, abs=0.1)

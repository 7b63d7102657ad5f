"""Closed loops: against the frequency response, and against a loop written out by hand."""

import numpy as np
import pytest

from ffl.errors import InputError
from ffl.systems import Controller, StateSpace, Zpk, closed_loop, load_plant


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

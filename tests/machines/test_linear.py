"""The simulated machine without effects is the linear closed loop, to rounding."""

import numpy as np
import pytest

from ffl.errors import InputError
from ffl.machines import SimulatedMachine, Simulator
from ffl.systems.loop import Controller
from ffl.systems.plant import Imperfections, Plant
from ffl.systems.plant_file import load_plant
from ffl.systems.references import Move, moves
from ffl.systems.state_space import StateSpace
from ffl.systems.zpk import Zpk

PLANTS = ("emps", "flatbed_printer", "flatbed_printer_built", "kernel2018_loop", "bayes2025_system")


def worst(ours, truth):
    return np.abs(ours - truth).max() / np.abs(truth).max()


def stage(delay=0, controller=True, **imperfections):
    """A 2 kg mass under PD control, `delay` whole samples late."""
    system = Zpk([-1.0], [1.0, 1.0], 2.5e-7, 1e-3, delay)
    lead = Controller.of_error(Zpk([0.98], [0.8], 4000.0, 1e-3)) if controller else None
    return Plant("stage", system, lead, "N", "m", machine=Imperfections(**imperfections))


def move(n=800):
    return moves([Move(0.1, 0.05, 0.3, 5.0, 200.0)], n * 1e-3, 1e-3)


def signals(seed=0, n=3000):
    return np.random.default_rng(seed).standard_normal((4, n))


@pytest.mark.parametrize("name", PLANTS)
def test_equals_linear_closed_loop(name):
    plant = load_plant(name)
    r, f, w, v = signals()
    run = Simulator(plant).run((), r, f, force=w, noise=v)
    truth = plant.loop.system.filter(np.column_stack([r, f, w, v]))
    assert worst(run.y, truth[:, 0]) < 1e-12
    assert worst(run.u, truth[:, 1]) < 1e-12


@pytest.mark.parametrize(
    "system",
    [
        Zpk([-1.0], [1.0, 1.0], 2.5e-7, 1e-3, 3),
        Zpk([-1.0], [1.0, 1.0, 0.0, 0.0], 2.5e-7, 1e-3),
        Zpk([-1.0], [1.0, 1.0], 2.5e-7, 1e-3, 2).state_space(),
        Zpk([-0.2, 0.9], [1.0, 0.98, -0.4, 0.0], 2.5e-6, 1e-3),
    ],
    ids=["delay", "poles_at_zero", "delay_in_states", "negative_pole"],
)
def test_plants_without_continuous_counterpart(system):
    plant = Plant("late", system, Controller.of_error(Zpk([0.98], [0.8], 1500.0, 1e-3)))
    r, f, w, v = signals()
    run = Simulator(plant).run((), r, f, force=w, noise=v)
    truth = plant.loop.system.filter(np.column_stack([r, f, w, v]))
    assert worst(run.y, truth[:, 0]) < 1e-12
    assert worst(run.u, truth[:, 1]) < 1e-12


def test_feedthrough_in_plant_and_controller():
    plant = Plant("direct", StateSpace([[0.9]], [[0.3]], [[0.2]], 0.5, 1e-3),
                  Controller.of_error(StateSpace([[0.5]], [[0.1]], [[1.0]], 0.7, 1e-3)))  # fmt: skip
    r, f, w, v = signals()
    run = Simulator(plant).run((), r, f, force=w, noise=v)
    truth = plant.loop.system.filter(np.column_stack([r, f, w, v]))
    assert worst(run.y, truth[:, 0]) < 1e-12
    assert worst(run.u, truth[:, 1]) < 1e-12


def test_open_loop_replays_the_closed_one():
    plant = load_plant("flatbed_printer")
    r, f, _, _ = signals()
    closed = Simulator(plant).run((), np.cumsum(np.cumsum(r)) * 1e-6, f)
    replay = Simulator(plant, open_loop=True).run((), None, closed.u)
    assert worst(replay.y, closed.y) < 1e-9  # the open loop integrates the rounding


@pytest.mark.parametrize("delay", [0, 3])
def test_end_state_continues_the_run(delay):
    simulator = Simulator(stage(delay))
    r, f, _, v = signals(n=1000)
    whole = simulator.run((), r, f, noise=v)
    first = simulator.run((), r[:401], f[:401], noise=v[:401])
    second = simulator.run((), r[401:], f[401:], noise=v[401:], start=first.end)
    assert worst(np.concatenate([first.y, second.y]), whole.y) < 1e-13
    assert np.allclose(second.end, whole.end, rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("name", ["emps", "flatbed_printer_built", "kernel2018_loop"])
def test_at_rest_stays_at_rest(name):
    simulator = Simulator(load_plant(name))
    run = simulator.run((), np.full(500, 0.3), start=simulator.at_rest(0.3))
    assert np.abs(run.y - 0.3).max() < 1e-9
    assert np.abs(run.v).max() < 1e-6


def test_substeps_change_nothing_in_a_linear_loop():
    simulator = Simulator(load_plant("flatbed_printer"))
    r, f, _, _ = signals()
    one, many = simulator.run((), r, f), simulator.run((), r, f, substeps=7)
    assert worst(many.y, one.y) < 1e-9


def test_velocity_is_the_derivative_of_the_position():
    """Exact for a held force: v[k] = (x[k+1] - x[k-1])/2T + T/4 (u[k-1] - u[k])/m."""
    run = Simulator(stage()).run((), move())
    central = (run.x[2:] - run.x[:-2]) / 2e-3 - 1e-3 * (run.u[1:-1] - run.u[:-2]) / (4 * 2.0)
    assert worst(run.v[1:-1], central) < 1e-9


def test_noise_differs_between_trials_and_repeats_with_the_seed():
    machine = SimulatedMachine(stage(sensor_noise=1e-6, force_noise=0.1))
    first, second = np.random.default_rng(1).spawn(2)
    one = machine.run(move(), None, first)
    two = machine.run(move(), None, second)
    again = machine.run(move(), None, np.random.default_rng(1).spawn(2)[0])
    assert np.abs(one.y - two.y).max() > 1e-7
    assert np.array_equal(one.y, again.y)
    assert np.array_equal(one.u, again.u)


def test_force_noise_is_not_in_the_recorded_command():
    machine = SimulatedMachine(stage(force_noise=0.1))
    trial = machine.run(move(), None, np.random.default_rng(1))
    feedback = machine.plant.controller.output.state_space().filter(trial.r - trial.y)
    assert worst(trial.u, feedback) < 1e-9


def test_sensor_noise_is_seen_by_the_feedback():
    machine = SimulatedMachine(stage(sensor_noise=1e-6))
    rng = np.random.default_rng(3)
    trial = machine.run(move(), None, np.random.default_rng(3))
    noise = 1e-6 * rng.standard_normal((2, len(move())))[1]
    inputs = np.column_stack([move(), 0 * noise, 0 * noise, noise])
    truth = machine.plant.loop.system.filter(inputs)
    assert worst(trial.y, truth[:, 0]) < 1e-11
    assert worst(trial.u, truth[:, 1]) < 1e-10


def test_encoder_rounds_what_is_fed_back():
    machine = SimulatedMachine(stage(encoder_resolution=1e-4))
    trial = machine.run(move(), None, np.random.default_rng(0))
    counts = trial.y / 1e-4
    assert np.abs(counts - np.round(counts)).max() < 1e-9
    feedback = machine.plant.controller.output.state_space().filter(trial.r - trial.y)
    assert worst(trial.u, feedback) < 1e-9


def test_command_limit_holds_and_is_recorded():
    free = SimulatedMachine(stage()).run(move(), None, np.random.default_rng(0))
    limit = 0.5 * np.abs(free.u).max()
    trial = SimulatedMachine(stage(command_limit=limit)).run(move(), None, np.random.default_rng(0))
    assert np.abs(trial.u).max() == pytest.approx(limit)
    assert np.abs(trial.y - free.y).max() > 1e-5


def test_load_is_recorded_and_acts_like_a_force():
    machine = SimulatedMachine(stage())
    load = np.sin(np.arange(len(move())) * 0.01)
    trial = machine.run(move(), None, np.random.default_rng(0), load=load)
    truth = machine.plant.loop.system.filter(np.column_stack([move(), 0 * load, load, 0 * load]))
    assert np.array_equal(trial.d, load)
    assert worst(trial.y, truth[:, 0]) < 1e-12


def test_unstable_loop_is_refused():
    plant = Plant("wild", stage().system, Controller.of_error(Zpk([], [], -10.0, 1e-3)))
    with pytest.raises(InputError, match="closed loop is unstable"):
        SimulatedMachine(plant)


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        (move() + 0.01, "starts at 0.01 m, not at 0"),
        (0.01 * np.sin(0.05 * np.arange(500)), "starts with velocity"),
        (np.append(move(), np.nan), "reference holds NaN"),
        (move()[:, None], "one value per sample"),
    ],
)
def test_bad_references_are_refused(reference, message):
    with pytest.raises(InputError, match=message):
        SimulatedMachine(stage()).run(reference, None, np.random.default_rng(0))


def test_signals_of_unequal_length_are_refused():
    with pytest.raises(InputError, match="lengths"):
        Simulator(stage()).run((), np.zeros(5), np.zeros(6))
    with pytest.raises(InputError, match="start has shape"):
        Simulator(stage()).run((), np.zeros(5), start=np.zeros(2))


def test_exponential_is_scipys():
    import scipy.linalg

    from ffl.machines.exponential import exponential

    rng = np.random.default_rng(0)
    for n, size in ((1, 0.0), (3, 1e-6), (8, 1.0), (14, 30.0)):
        a = size * rng.standard_normal((n, n)) / max(n, 1)
        truth = scipy.linalg.expm(a)
        assert np.abs(exponential(a) - truth).max() < 1e-11 * np.abs(truth).max()
    assert np.abs(exponential(np.array([[0.0, 2.0], [-2.0, 0.0]]))
                  - [[np.cos(2), np.sin(2)], [-np.sin(2), np.cos(2)]]).max() < 1e-15  # fmt: skip

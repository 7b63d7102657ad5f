"""linear_part against the kernel: its response is the simulated response, effect by effect."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.machines import Simulator, linear_part
from ffl.systems import EffectSpec, load_plant, plant_from_dict

LINEAR = {
    "mass": [EffectSpec("mass_change", {"change": 0.2})],
    "damping": [EffectSpec("viscous_friction", {"coefficient": 40.0})],
    "spring": [EffectSpec("linear_stiffness", {"stiffness": 300.0})],
    "mode": [EffectSpec("flexible_mode", {"frequency": 30.0, "mass_fraction": 0.02})],
    "delay": [EffectSpec("input_delay", {"delay": 2.4e-3})],
    "whole delay": [EffectSpec("input_delay", {"delay": 3e-3})],
    "all": [
        EffectSpec("mass_change", {"change": 0.1}),
        EffectSpec("linear_stiffness", {"stiffness": 200.0}),
        EffectSpec("viscous_friction", {"coefficient": 10.0}, {"side": "motor"}),
        EffectSpec("input_delay", {"delay": 1.7e-3}),
    ],
}


def reference(n):
    t = 1e-3 * np.arange(n)
    return 1e-3 * np.sin(2 * np.pi * 1.5 * t) ** 3 * (t > 0.05)


def feedforward(n):
    return 1e-2 * np.random.default_rng(3).standard_normal(n)


def both(plant, n=1500):
    """Output and command of the kernel, and of the linear loop of `linear_part`."""
    r, f = reference(n), feedforward(n)
    run = Simulator(plant).run(plant.effects, r, f)
    zero = np.zeros(n)
    linear = linear_part(plant).loop.system.filter(np.column_stack([r, f, zero, zero]))
    return np.column_stack([run.y, run.u]), linear


@pytest.mark.parametrize("name", LINEAR)
@pytest.mark.parametrize("plant", ["flatbed_printer", "emps"])
def test_the_response_is_the_simulated_one(plant, name):
    simulated, linear = both(replace(load_plant(plant), effects=tuple(LINEAR[name])))
    # Fractions of a sample: the kernel hands on mean and first moment of the command, no more.
    exact = 1e-6 if name in ("delay", "all") else 1e-8
    assert np.abs((simulated - linear) / simulated.std(axis=0)).max() < exact
    without, _ = both(load_plant(plant))
    assert np.abs(simulated - without).max() > 1e-4 * np.abs(simulated).max()


def test_a_lag_is_the_simulated_one_up_to_the_kernels_straight_line():
    """The kernel hands on mean and first moment of the lagged command over the sample."""
    plant = replace(
        load_plant("flatbed_printer"),
        effects=(EffectSpec("actuator_lag", {"time_constant": 4e-3}),),
    )
    simulated, linear = both(plant)
    assert np.abs(simulated - linear).max() < 1e-5 * np.abs(simulated).max()
    twice = replace(plant, effects=2 * plant.effects)
    simulated, linear = both(twice)
    assert np.abs(simulated - linear).max() < 1e-5 * np.abs(simulated).max()


def test_other_effects_are_left_out_and_the_plant_stays_as_it_is():
    plant = load_plant("flatbed_printer")
    with_friction = replace(plant, effects=(EffectSpec("coulomb_friction", {"level": 20.0}),))
    assert linear_part(with_friction).system is plant.system
    assert linear_part(with_friction).effects == ()


SPEED = {
    "name": "elevator",
    "sample_time": 5e-3,
    "units": {"input": "A", "output": "m/s"},
    "plant": {"form": "czpk", "zeros": [], "poles": [-0.056], "gain": 0.03},
    "controller": {"form": "zpk", "zeros": [], "poles": [], "gain": 240.0},
    "physics": {"mass": 3168.0, "motor_constant": 95.0},
}


@pytest.mark.parametrize("name", ["mass", "damping", "spring", "mode", "delay", "all"])
def test_a_speed_loses_no_stability_to_the_way_that_it_makes(name):
    """The way is simulated beside it, an integrator that no loop brings back."""
    plant = replace(plant_from_dict(SPEED), effects=tuple(LINEAR[name]))
    simulated, linear = both(plant)
    linear_part(plant).require_stable()
    exact = 1e-6 if name in ("delay", "all") else 1e-8
    assert np.abs((simulated - linear) / simulated.std(axis=0)).max() < exact


@pytest.mark.parametrize("name", ["coulomb_friction", "constant_load"])
def test_the_plant_of_a_speed_stays_as_it_is_beside_other_effects(name):
    number = {"coulomb_friction": "level", "constant_load": "force"}[name]
    plant = replace(plant_from_dict(SPEED), effects=(EffectSpec(name, {number: 350.0}),))
    assert linear_part(plant).system is plant.system

"""Every effect against an independent adaptive integration of a rigid stage under servo control."""

import numpy as np
import pytest
from cases import ORACLE, STAGE, reference, slip
from oracle import Case, run

from ffl.effects import EFFECTS
from ffl.machines import Simulator
from ffl.systems.plant import EffectSpec

SIMULATOR = Simulator(STAGE)


def test_the_oracle_itself_is_the_linear_loop():
    r = reference()
    truth = STAGE.loop.reference_to_output.filter(r)
    assert np.abs(run(Case(), r) - truth).max() < 1e-12 * np.abs(truth).max()


@pytest.mark.parametrize("name", ORACLE)
def test_against_adaptive_integration(name):
    parameters, case, bound = ORACLE[name]
    r = reference()
    linear = SIMULATOR.run((), r).y
    truth = run(case, r)
    effect = np.abs(truth - linear).max()
    one = np.abs(SIMULATOR.run([EffectSpec(name, parameters)], r).y - truth).max() / effect
    assert one < bound
    if bound > 1e-9:  # not exact by construction: then of second order in the step, or better
        four = SIMULATOR.run([EffectSpec(name, parameters)], r, substeps=8).y
        assert np.abs(four - truth).max() / effect < bound / 8


def test_two_effects_at_once_and_in_the_order_of_the_list():
    """Friction and a spring share a mass; a dead zone before a clip is not a clip before it."""
    r = reference()
    both = Case(levels=lambda x, v: (5.0, 3.0), force=lambda t, x, v, z: -1e6 * (x - 0.001) ** 3)
    specs = [
        EffectSpec(name, ORACLE[name][0]) for name in ("asymmetric_friction", "hardening_spring")
    ]
    truth = run(both, r)
    for order in (specs, specs[::-1]):
        assert np.abs(SIMULATOR.run(order, r).y - truth).max() < 1e-4 * np.abs(truth).max()

    chain = Case(drive=lambda u, x, z: np.clip(np.sign(u) * max(abs(u) - 1.0, 0.0), -5.0, 5.0))
    specs = [EffectSpec("dead_zone", {"half_width": 1.0}), EffectSpec("saturation", {"limit": 5.0})]
    truth = run(chain, r)
    assert np.abs(SIMULATOR.run(specs, r).y - truth).max() < 1e-12
    assert np.abs(SIMULATOR.run(specs[::-1], r).y - truth).max() > 1e-7


def test_a_spring_that_softens():
    r = reference()
    truth = run(Case(force=lambda t, x, v, z: 1e4 * (x - 0.001) ** 3), r)
    spec = EffectSpec("hardening_spring", {"cubic_coefficient": -1e4, "centre": 0.001})
    effect = np.abs(truth - SIMULATOR.run((), r).y).max()
    assert np.abs(SIMULATOR.run([spec], r).y - truth).max() < 1e-8 * effect


@pytest.mark.parametrize("name", ["sine", "ramp"])
def test_other_forms_of_drift(name):
    forms = {
        "sine": lambda t: 3 * np.sin(2 * np.pi * t / 0.2),
        "ramp": lambda t: 3 * t / 0.2,
    }
    r = reference()
    truth = run(Case(force=lambda t, x, v, z: forms[name](t)), r)
    spec = EffectSpec("drift", {"amplitude": 3.0, "time_constant": 0.2}, {"kind": name})
    assert np.abs(SIMULATOR.run([spec], r).y - truth).max() < 1e-7 * np.abs(truth).max()


@pytest.mark.parametrize("damping", [0.0, 100.0])
def test_elements_that_slide_one_after_the_other(damping):
    r = reference()
    values = {"level": 5.0, "stiffness": 2e5, "micro_damping": damping}
    truth, linear = run(slip(**values), r), SIMULATOR.run((), r).y
    spec = EffectSpec("presliding_friction", values, {"kind": "maxwell_slip"})
    one, eight = (np.abs(SIMULATOR.run([spec], r, substeps=n).y - truth).max() for n in (1, 8))
    effect = np.abs(truth - linear).max()
    assert one < 6e-5 * effect
    assert eight < 1.5e-6 * effect


def test_rectifying_sensor():
    r = reference()
    spec = EffectSpec("sensor_nonlinearity", {"kind": "rectified"})
    drive = 0.01 * np.sin(np.arange(300) * 0.05)  # in open loop: with feedback it drives away
    y = Simulator(STAGE, open_loop=True).run([spec], None, drive).y
    plain = Simulator(STAGE, open_loop=True).run((), None, drive).y
    assert np.array_equal(y, np.abs(plain))
    assert len(r)


def test_every_effect_has_an_oracle_here_or_in_the_files_beside():
    from cases import FLOW, PARAMETERS

    assert {*PARAMETERS, *FLOW} == set(EFFECTS)


@pytest.mark.parametrize(
    "late",
    [
        EffectSpec("actuator_lag", {"time_constant": 5e-4}),
        EffectSpec("saturation", {"limit": 5.0}),
        EffectSpec("dead_zone", {"half_width": 1.0}),
    ],
    ids=lambda spec: spec.name,
)
def test_a_motor_has_its_gain_after_what_becomes_of_the_command(late):
    """Whichever is named first."""
    gain = EffectSpec(
        "position_dependent_gain",
        {"linear_coefficient": 3.0, "quadratic_coefficient": -20.0, "centre": 0.0},
    )
    r = reference()
    one, other = (SIMULATOR.run(order, r).y for order in ((gain, late), (late, gain)))
    assert np.array_equal(one, other)
    assert np.abs(one - SIMULATOR.run((late,), r).y).max() > 1e-6 * np.abs(one).max()

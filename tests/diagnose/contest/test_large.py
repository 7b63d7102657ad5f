"""Large effects named on the free-running error while the linear part is calibrated beside them."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest.large import Tried, _Desk, large_effects, noise_left
from ffl.diagnose.screen.simulated_scan import cogging_of
from ffl.machines import SimulatedMachine
from ffl.systems import EffectSpec, Imperfections, Move, Zpk, as_zpk, load_plant, moves


@pytest.fixture(scope="module")
def emps():
    return replace(load_plant("emps"), machine=Imperfections(1e-7, 1e-7, 0.05, None))


def scans(machine, key):
    r = moves([Move(0.1, 0.06, 0.2, 3.0, 60.0), Move(0.7, -0.04, 0.1, 2.0, 60.0)], 1.4, 1e-3)
    shorter = moves([Move(0.1, -0.05, 0.15, 3.0, 60.0)], 0.8, 1e-3)
    return [machine.run(x, 0 * x, np.random.default_rng(key)) for x in (r if key else shorter,)]


def test_friction_is_named_beside_a_gain_that_is_off(emps):
    zpk = as_zpk(emps.system)
    built = replace(
        emps,
        system=Zpk(zpk.zeros, zpk.poles, 0.96 * zpk.gain, zpk.sample_time),
        effects=(EffectSpec("coulomb_friction", {"level": 60.0}),),
    )
    machine = SimulatedMachine(built)
    found = large_effects(emps, scans(machine, 1), scans(machine, 0))
    assert [e.name for e in found.plant.effects] == ["coulomb_friction"]
    assert found.plant.effects[0].parameters["level"] == pytest.approx(60.0, rel=0.01)
    assert found.after.fitted < 0.05 * found.before.fitted
    assert found.after.held_out < 0.05 * found.before.held_out


def test_nothing_is_named_where_only_the_gain_is_off(emps):
    zpk = as_zpk(emps.system)
    off = Zpk(zpk.zeros, zpk.poles, 0.98 * zpk.gain, zpk.sample_time)
    machine = SimulatedMachine(replace(emps, system=off))
    found = large_effects(emps, scans(machine, 1), scans(machine, 0))
    assert found.plant.effects == ()


def test_cogging_is_named_beside_friction_that_holds_the_machine_for_a_part_of_the_time(emps):
    wave = {"amplitude": 25.0, "period": 0.0083, "phase": 0.7}
    effects = (
        EffectSpec("coulomb_friction", {"level": 60.0}),
        EffectSpec("cogging", wave),
    )
    machine = SimulatedMachine(replace(emps, effects=effects))
    found = large_effects(emps, scans(machine, 1), scans(machine, 0)).plant.effects
    assert {e.name for e in found} == {"coulomb_friction", "cogging"}
    cogging = next(e for e in found if e.name == "cogging")
    assert cogging.parameters["period"] == pytest.approx(0.0083, rel=0.002)
    assert cogging.parameters["amplitude"] == pytest.approx(25.0, rel=0.02)


def test_the_scan_puts_the_true_period_first(emps):
    friction = EffectSpec("coulomb_friction", {"level": 60.0})
    wave = EffectSpec("cogging", {"amplitude": 8.0, "period": 0.0071, "phase": -1.0})
    machine = SimulatedMachine(replace(emps, effects=(friction, wave)))
    found = cogging_of(replace(emps, effects=(friction,)), scans(machine, 1), {})
    assert found[0].parameters["period"] == pytest.approx(0.0071, rel=0.02)
    assert found[0].parameters["amplitude"] == pytest.approx(8.0, rel=0.3)


def test_what_noise_may_have_done_explains_nothing_that_the_linear_part_does_not(emps):
    """A wrong cogging about which noise makes the machine hop ended the search (printer 2 of ten)."""
    loud = replace(emps, machine=Imperfections(1e-7, 1e-2, 0.0, None))
    desk = _Desk(loud, scans(SimulatedMachine(loud), 0), (), lambda line: None)
    rubbing = replace(loud, effects=(EffectSpec("coulomb_friction", {"level": 60.0}),))
    left = min(noise_left(plant, desk.recordings) for plant in (loud, rubbing))
    named, linear = Tried(rubbing, left, left), Tried(loud, left, left)
    assert not desk.mismatch(named)
    assert replace(desk, linear=linear).mismatch(named)
    assert not replace(desk, linear=replace(linear, fitted=2.0 * left)).mismatch(named)
    assert not replace(desk, linear=linear).mismatch(linear)


def test_a_cable_is_no_preloaded_spring_as_wide_as_the_travel(emps):
    """Its force is the same wherever the machine went (printer 3 of ten)."""
    cable = EffectSpec("linear_stiffness", {"stiffness": 900.0, "centre": 0.0})
    machine = SimulatedMachine(replace(emps, effects=(cable,)))
    desk = _Desk(emps, scans(machine, 1), scans(machine, 0), print)
    assert desk.reach.travel == pytest.approx(0.06, rel=0.1)
    wide = EffectSpec("preloaded_spring", {"preload": 90.0, "centre": 0.0, "width": 0.1})
    assert desk.fitted((wide,), 1) is None
    assert desk.fitted((cable,), 1) is not None

"""Points of a plant with a mode: motor side, load side, coupling; the mode as an effect."""

import numpy as np
import pytest
import scipy.linalg
from cases import STAGE, reference
from two_masses import (
    DAMPER,
    DAMPING,
    FREQUENCY,
    LOAD,
    MOTOR,
    SPRING,
    simulate,
    two_mass_plant,
)

from ffl.effects import EFFECTS, mechanics_of, modal
from ffl.effects.base import Setting
from ffl.errors import InputError
from ffl.machines import Simulator
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import StateSpace

COMMAND = 3.0 * np.sin(2 * np.pi * 3.0 * np.arange(400) * 1e-3)


def worst(ours, truth):
    return np.abs(ours - truth).max() / np.abs(truth).max()


@pytest.mark.parametrize("measured", ["motor", "load"])
def test_points_have_the_masses_they_should(measured):
    mechanics = mechanics_of(two_mass_plant(measured).system)
    ratio = None if measured == "motor" else LOAD / MOTOR
    assert mechanics.moving_mass == pytest.approx(MOTOR + LOAD, rel=1e-9)
    masses = {"motor": MOTOR, "load": LOAD, "sensor": MOTOR if measured == "motor" else LOAD}
    masses["coupling"] = MOTOR * LOAD / (MOTOR + LOAD)
    for side, mass in masses.items():
        point = mechanics.point(side, ratio)
        assert 1 / point.mobility == pytest.approx(mass, rel=1e-7)
        assert abs(point.position @ point.force) < 1e-9 * point.mobility
    modes = mechanics.modes
    assert modes[0].rigid
    assert np.sqrt(modes[1].stiffness) == pytest.approx(2 * np.pi * FREQUENCY, rel=1e-8)


@pytest.mark.parametrize("measured", ["motor", "load"])
@pytest.mark.parametrize("side", ["motor", "load"])
def test_friction_on_either_side(measured, side):
    ratio = None if measured == "motor" else LOAD / MOTOR
    options = {"side": side} if ratio is None else {"side": side, "mass_ratio": ratio}
    spec = EffectSpec("coulomb_friction", {"level": 1.5}, options)
    simulator = Simulator(two_mass_plant(measured), open_loop=True)
    run, linear = simulator.run([spec], None, COMMAND), simulator.run((), None, COMMAND)
    truth = simulate(lambda t, s: (0.0, 0.0), COMMAND, side, 1.5)
    truth = truth[:, 0 if measured == "motor" else 1]
    assert np.abs(run.y - truth).max() < 5e-4 * np.abs(truth - linear.y).max()


@pytest.mark.parametrize("measured", ["motor", "load"])
@pytest.mark.parametrize("side", ["motor", "load"])
def test_spring_and_cogging_on_either_side(measured, side):
    ratio = None if measured == "motor" else LOAD / MOTOR
    options = {"side": side} if ratio is None else {"side": side, "mass_ratio": ratio}
    specs = [
        EffectSpec("linear_stiffness", {"stiffness": 200.0, "centre": 0.001}, options),
        EffectSpec("cogging", {"amplitude": 0.5, "period": 0.004, "phase": 0.2}, options),
    ]

    def force(t, s):
        x = s[0] if side == "motor" else s[2]
        value = -200 * (x - 0.001) + 0.5 * np.sin(2 * np.pi * x / 0.004 + 0.2)
        return (value, 0.0) if side == "motor" else (0.0, value)

    run = Simulator(two_mass_plant(measured), open_loop=True).run(specs, None, COMMAND)
    truth = simulate(force, COMMAND)
    assert worst(run.y, truth[:, 0 if measured == "motor" else 1]) < 3e-5


def contact(stretch, rate, gap):
    """Spring and damper beyond a gap, pushing only."""
    if stretch > gap / 2:
        return min(0.0, -SPRING * (stretch - gap / 2) - DAMPER * rate)
    if stretch < -gap / 2:
        return max(0.0, -SPRING * (stretch + gap / 2) - DAMPER * rate)
    return 0.0


def test_backlash_in_the_coupling():
    gap = 2e-4

    def force(t, s):
        stretch, rate = s[0] - s[2], s[1] - s[3]
        back = SPRING * stretch + DAMPER * rate + contact(stretch, rate, gap)
        return back, -back

    run = Simulator(two_mass_plant(), open_loop=True).run(
        [EffectSpec("backlash", {"gap": gap})], None, COMMAND[:250]
    )
    fine = Simulator(two_mass_plant(), open_loop=True).run(
        [EffectSpec("backlash", {"gap": gap})], None, COMMAND[:250], substeps=32
    )
    truth = simulate(force, COMMAND[:250])[:, 0]
    linear = simulate(lambda t, s: (0.0, 0.0), COMMAND[:250])[:, 0]
    effect = np.abs(truth - linear).max()
    assert effect > 1e-6
    assert np.abs(run.y - truth).max() < 2e-4 * effect
    assert np.abs(fine.y - truth).max() < 6e-5 * effect


@pytest.mark.parametrize("measured", ["motor", "load"])
def test_load_behind_a_gap_on_a_rigid_stage(measured):
    """The rigid stage with a part of its mass behind a gap is the two-mass system with that gap."""
    gap, share = 2e-4, LOAD / (MOTOR + LOAD)

    def force(t, s):
        stretch, rate = s[0] - s[2], s[1] - s[3]
        back = SPRING * stretch + DAMPER * rate + contact(stretch, rate, gap)
        return back, -back

    keys = {"kind": "load", "load_fraction": share, "frequency": FREQUENCY, "damping": DAMPING}
    spec = EffectSpec("backlash", {"gap": gap}, {**keys, "measured": measured})
    run = Simulator(STAGE, open_loop=True).run([spec], None, COMMAND[:250])
    truth = simulate(force, COMMAND[:250])[:, 0 if measured == "motor" else 1]
    linear = simulate(lambda t, s: (0.0, 0.0), COMMAND[:250])[:, 0 if measured == "motor" else 1]
    assert np.abs(run.y - truth).max() < 2e-4 * np.abs(truth - linear).max()


def test_damping_in_contact_only():
    """With the mode's own damping ratio nothing changes; with more, the rattling dies faster."""
    simulator = Simulator(two_mass_plant(), open_loop=True)
    push = np.where(np.arange(600) < 20, 3.0, 0.0)

    def rattle(options):
        spec = EffectSpec("backlash", {"gap": 1e-4}, options)
        run = simulator.run([spec], None, push, watch=[("coupling", None)])
        return run.y, np.ptp(run.motion("coupling").v[-100:])

    own, same = rattle({}), rattle({"damping": DAMPING})
    assert np.abs(own[0] - same[0]).max() < 1e-9 * np.abs(own[0]).max()
    assert rattle({"damping": 0.3})[1] < 0.5 * own[1]


def test_coupling_needs_a_mode():
    spec = EffectSpec("backlash", {"gap": 1e-4}, {"kind": "coupling"})
    with pytest.raises(InputError, match="needs a plant with a mode"):
        Simulator(STAGE).run([spec], reference())


@pytest.mark.parametrize("measured", ["motor", "load"])
def test_flexible_mode_makes_the_rigid_stage_a_two_mass_system(measured):
    share = LOAD / (MOTOR + LOAD)
    spec = EffectSpec(
        "flexible_mode",
        {"frequency": FREQUENCY, "damping": DAMPING, "mass_fraction": share},
        {"measured": measured},
    )
    ours = Simulator(STAGE, open_loop=True).run([spec], None, COMMAND)
    truth = two_mass_plant(measured).system.filter(COMMAND)
    assert worst(ours.y, truth) < 1e-10


@pytest.mark.parametrize(("frequency", "share"), [(160.0, 0.1), (250.0, 0.03)])
def test_a_part_resonates_at_its_frequency_on_a_machine_with_modes_of_its_own(frequency, share):
    """Against the whole mass it was 12 to 24 % higher in place."""
    mechanics = mechanics_of(two_mass_plant("motor").system)
    whole = mechanics.with_part_on_spring("part", ("motor", None), share, frequency, 0.02, False)
    poles = np.linalg.eigvals(whole.a)
    top = poles[np.argmax(poles.imag)]
    assert abs(top) / (2 * np.pi) == pytest.approx(frequency, rel=0.02)
    assert -top.real / abs(top) == pytest.approx(0.02, rel=0.1)


def test_mass_change_is_the_plant_with_that_mass():
    ours = Simulator(STAGE, open_loop=True).run(
        [EffectSpec("mass_change", {"change": 0.1})], None, COMMAND
    )
    assert worst(ours.y, STAGE.system.filter(COMMAND) / 1.1) < 1e-11


@pytest.mark.parametrize("side", ["motor", "load"])
def test_mass_added_to_either_side(side):
    change = 0.2 / (MOTOR + LOAD)
    spec = EffectSpec("mass_change", {"change": change}, {"side": side})
    ours = Simulator(two_mass_plant(), open_loop=True).run([spec], None, COMMAND)
    heavier = {"motor": (MOTOR + 0.2, LOAD), "load": (MOTOR, LOAD + 0.2)}[side]
    assert worst(ours.y, two_mass_plant("motor", *heavier).system.filter(COMMAND)) < 1e-10


def test_mode_starts_at_rest_beside_a_machine_at_rest():
    simulator = Simulator(STAGE)
    spec = EffectSpec("flexible_mode", {"frequency": 60.0, "damping": 0.02, "mass_fraction": 0.3})
    run = simulator.run([spec, spec], np.full(300, 0.02), start=simulator.at_rest(0.02))
    assert np.abs(run.y - 0.02).max() < 1e-11


def test_mass_cannot_vanish():
    with pytest.raises(InputError, match="no positive mass"):
        Simulator(two_mass_plant()).run([EffectSpec("mass_change", {"change": -0.9})], reference())


@pytest.mark.parametrize("measured", ["motor", "load"])
@pytest.mark.parametrize("guide", [0.0, 4.0, 40.0])
def test_two_masses_on_a_rubbing_guide_are_read_off_exactly(measured, guide):
    """A guide that rubs on the motor makes the damping non-classical; the points stay exact."""
    plant = two_mass_plant(measured, guide=guide)
    ratio = None if measured == "motor" else LOAD / MOTOR
    mechanics = mechanics_of(plant.system)
    pair = mechanics.two_masses(ratio)
    assert pair.stiffness == pytest.approx(SPRING, rel=1e-6)
    assert pair.damping == pytest.approx(DAMPER, rel=1e-4)
    assert 1 / pair.motor.mobility == pytest.approx(MOTOR, rel=1e-6)
    assert 1 / pair.load.mobility == pytest.approx(LOAD, rel=1e-6)
    for side in ("motor", "load"):
        keys = {"side": side} if ratio is None else {"side": side, "mass_ratio": ratio}
        spec = EffectSpec("linear_stiffness", {"stiffness": 300.0, "centre": 0.0}, keys)
        ours = Simulator(plant, open_loop=True).run([spec], None, COMMAND).y
        grounded = {side: 300.0}
        truth = two_mass_plant(measured, guide=guide, ground=grounded).system.filter(COMMAND)
        assert worst(ours, truth) < 1e-7


def test_what_is_not_two_masses_is_taken_for_modes():
    mechanics = mechanics_of(two_mass_plant().system)
    assert mechanics.two_masses() is not None
    assert mechanics.two_masses(0.3) is None  # a ratio that contradicts the plant: shapes by modes
    held = two_mass_plant(ground={"motor": 500.0})
    assert mechanics_of(held.system).two_masses() is None
    assert mechanics_of(held.system).point("load").mobility > 0


@pytest.mark.parametrize("measured", ["motor", "load"])
def test_a_play_between_masses_that_are_all_heavier_is_a_play_under_less_command(measured):
    """The spring between them is as much stiffer, for the mode keeps its frequency: all of it must go."""
    play = EffectSpec("backlash", {"gap": 4e-4}, {"kind": "coupling"})
    heavier = EffectSpec("mass_change", {"change": 0.3}, {"side": "all"})
    simulator = Simulator(two_mass_plant(measured), open_loop=True)
    alone = simulator.run([play], None, COMMAND)
    for specs in ([play, heavier], [heavier, play]):
        assert worst(simulator.run(specs, None, 1.3 * COMMAND).y, alone.y) < 1e-9


@pytest.mark.parametrize("damped", ["motor", "load"])
def test_a_part_on_a_spring_may_take_the_damping_with_it(damped):
    """m1 x1'' = -F - b1 x1', m2 x2'' = F - b2 x2', F = k (x1 - x2) + c (x1' - x2'), against its matrix."""
    mass, rate, share, step = 5.0, 6.0, 0.4, 1e-3
    a = np.array([[0.0, 1.0], [0.0, -rate]])
    block = np.zeros((3, 3))
    block[:2, :2], block[1, 2] = a, 1.0 / mass
    held = scipy.linalg.expm(block * step)
    system = StateSpace(held[:2, :2], held[:2, 2:], np.array([[1.0, 0.0]]), 0.0, step)
    setting = Setting(1.0, mechanics_of(system), {"kind": "load", "load_fraction": share,
                      "frequency": 40.0, "damping": 0.1, "damped": damped})  # fmt: skip
    found = EFFECTS["backlash"].modify(setting.mechanics, {"gap": 1e-4}, setting)
    m1, m2, w = mass * (1.0 - share), mass * share, 2 * np.pi * 40.0
    reduced = m1 * m2 / (m1 + m2)
    k, c, b = w**2 * reduced, 0.2 * w * reduced, mass * rate
    b1, b2 = (b, 0.0) if damped == "motor" else (0.0, b)
    by_hand = np.array([
        [0.0, 1.0, 0.0, 0.0], [-k / m1, -(c + b1) / m1, k / m1, c / m1],
        [0.0, 0.0, 0.0, 1.0], [k / m2, c / m2, -k / m2, -(c + b2) / m2],
    ])  # fmt: skip
    np.testing.assert_allclose(
        np.poly(found.a), np.poly(by_hand), rtol=1e-8, atol=1e-8 * np.abs(np.poly(by_hand)).max()
    )


def test_only_a_rigid_plant_has_one_damping():
    plant = two_mass_plant("load")
    spec = EffectSpec("backlash", {"gap": 1e-4}, {"kind": "load", "damped": "load"})
    with pytest.raises(InputError, match="damped"):
        Simulator(plant).run([spec], np.zeros(10))


def test_digits_that_a_logarithm_loses_come_back(monkeypatch):
    """Roots that are off by 1e-8 are a logarithm that is off by as much."""
    system = two_mass_plant("load").system
    exact = modal.taken_apart(system)
    real = scipy.linalg.sqrtm
    monkeypatch.setattr(scipy.linalg, "sqrtm", lambda block: real(block) * (1.0 + 1e-8))
    again = modal.taken_apart(system)
    np.testing.assert_allclose(again.a, exact.a, rtol=0, atol=1e-12 * np.abs(exact.a).max())


@pytest.mark.parametrize(("sample_time", "looked_for"), [(1e-3, True), (0.09, True), (0.1, False)])
def test_a_part_that_knocks_is_looked_for_where_samples_follow_its_slowest_contact(
    sample_time, looked_for
):
    """5 Hz; an oven sampled once a second was followed in 64 steps a sample."""
    kinds = [form["kind"] for form in EFFECTS["backlash"].forms(False, sample_time)]
    assert kinds == ["play", *["load"] * (2 * looked_for)]


def test_modes_are_those_of_the_eigenvectors():
    """Projectors from one Schur form against left and right eigenvectors, a mode at a time."""
    rng = np.random.default_rng(1)
    for order in (4, 7, 12):
        a = rng.standard_normal((order, order))
        form = modal.SchurForm.of(a)
        np.testing.assert_allclose(
            np.sort_complex(form.poles), np.sort_complex(np.linalg.eigvals(a)), rtol=1e-10
        )
        poles, left, right = scipy.linalg.eig(a, left=True)
        for own in modal._pairs(form.poles):
            projector, basis = form.projector(own)
            at = [int(np.argmin(np.abs(poles - p))) for p in form.poles[own]]
            v, w = right[:, at], left[:, at].conj()
            expected = (v / np.sum(v * w, axis=0)) @ w.T
            np.testing.assert_allclose(projector, expected.real, atol=1e-9 * np.abs(expected).max())
            np.testing.assert_allclose(projector @ basis, basis, atol=1e-9)


def test_modes_that_are_one_to_rounding_are_not_parted():
    a = np.diag([-1.0, -1.0, -1.0, -3.0])
    projector, basis = modal.SchurForm.of(a).projector([0, 1])
    np.testing.assert_array_equal(projector, np.eye(4))
    np.testing.assert_array_equal(basis, np.eye(4))


def test_friction_on_a_load_that_an_effect_hangs_on_a_rigid_stage():
    """It is the two-mass system whose load rubs: the load of a machine of one body hangs on that spring."""
    mode = {"frequency": FREQUENCY, "damping": DAMPING, "mass_fraction": LOAD / (MOTOR + LOAD)}
    rubs = EffectSpec("coulomb_friction", {"level": 1.5}, {"side": "load"})
    hung = EffectSpec("flexible_mode", mode)
    simulator = Simulator(STAGE, open_loop=True)
    linear = simulator.run([hung], None, COMMAND)
    truth = simulate(lambda t, s: (0.0, 0.0), COMMAND, "load", 1.5)[:, 0]
    for effects in ([hung, rubs], [rubs, hung]):
        run = simulator.run(effects, None, COMMAND)
        assert np.abs(run.y - truth).max() < 5e-4 * np.abs(truth - linear.y).max()

"""Feedforward from a diagnosis: exact on a rigid machine, two-sided on one with modes."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.bases import Compensation, Derivatives, SumBasis, make_basis
from ffl.effects import EFFECTS, Motion
from ffl.effects.slip import slip
from ffl.errors import InputError
from ffl.learn import AlongTrajectory, Weights
from ffl.machines import Simulator
from ffl.systems import EffectSpec, Move, Zpk, load_plant, moves

T = 1e-3
REFERENCE = moves([Move(0.3, 0.1, 0.4, 4.0, 200.0), Move(1.2, -0.06, 0.4, 4.0, 200.0)], 2.0, T)
FRICTION = EffectSpec("coulomb_friction", {"level": 20.0})
COGGING = EffectSpec(
    "cogging", {"amplitude": 8.0, "period": 0.03, "phase": 0.4, "amplitude_2": 3.0, "phase_2": 1.0}
)
SPRING = EffectSpec("linear_stiffness", {"stiffness": 90.0, "centre": 0.02})
LAG = EffectSpec("actuator_lag", {"time_constant": 2e-3})


def plant(*effects, name="emps"):
    return replace(load_plant(name), effects=effects)


def test_one_column_per_coefficient_and_what_has_none_is_said():
    basis = Compensation(plant(FRICTION, COGGING, LAG, SPRING))
    assert basis.names == [
        "coulomb_friction",
        *[f"cogging[{k}]" for k in range(4)],
        "linear_stiffness[0]",
        "linear_stiffness[1]",
    ]
    assert basis.without == ["actuator_lag"]
    assert basis.regressors(REFERENCE).shape == (len(REFERENCE), 7)
    with pytest.raises(InputError, match=r"no effect with a compensation \(actuator_lag have none"):
        Compensation(plant(LAG))
    with pytest.raises(InputError, match="sample_time"):
        Compensation(plant(FRICTION), 2e-3)


def test_true_coefficients_cancel_the_effects_on_a_rigid_machine():
    """Beside the same machine without effects, both with the rigid body fed forward: while it moves
    the compensation takes away what the effects do, up to half a sample of hold."""
    machine = plant(FRICTION, COGGING, SPRING)
    basis = make_basis([{"kind": "from_diagnosis"}], T, machine)
    harmonics = [8 * np.cos(0.4), 8 * np.sin(0.4), 3 * np.cos(1.0), 3 * np.sin(1.0)]
    theta = np.array([20.0, *harmonics, 90.0, 90.0 * 0.02])
    rigid = make_basis([{"kind": "derivatives", "orders": ["velocity", "acceleration"]}], T)
    # The servo brakes with gtau kv = 35.15 * 243.45 N s/m, which the feedforward makes good.
    mass = rigid.regressors(REFERENCE) @ [35.15 * 243.45, machine.physics.mass]
    simulator = Simulator(machine)

    def error(feedforward):
        y = simulator.run(machine.effects, REFERENCE, feedforward).y
        free = simulator.run((), REFERENCE, mass).y
        moving = np.abs(np.gradient(REFERENCE, T)) > 0.1
        return np.linalg.norm((free - y)[moving])

    assert error(mass + basis.regressors(REFERENCE) @ theta) < 0.15 * error(mass)
    wrong = theta * np.where(np.arange(7) == 1, -1.0, 1.0)
    assert error(mass + basis.regressors(REFERENCE) @ wrong) > 0.4 * error(mass)


@pytest.mark.parametrize("side", ["sensor", "motor"])
def test_a_force_anywhere_on_the_printer_is_cancelled_from_the_motor(side):
    """The non-minimum-phase printer in closed loop: a smooth force of position (a cubic spring) at
    the sensor or at the motor, and the two-sided command against it. In the output they cancel."""
    effect = EffectSpec(
        "hardening_spring", {"cubic_coefficient": 3e3, "centre": 0.03}, {"side": side}
    )
    machine = plant(effect, name="flatbed_printer")
    reference = np.concatenate([np.zeros(1500), REFERENCE, np.full(1500, REFERENCE[-1])])
    basis = Compensation(machine)
    f = basis.regressors(reference)[:, 0] * 3e3
    # A feedforward that tracks without the effect: the two-sided inverse of the plant.
    inverse = _tracking(machine, reference)
    simulator = Simulator(machine)
    free = np.linalg.norm(reference - simulator.run((), reference, inverse).y)
    spoilt = np.linalg.norm(reference - simulator.run(machine.effects, reference, inverse).y)
    mended = np.linalg.norm(reference - simulator.run(machine.effects, reference, inverse + f).y)
    assert spoilt > 100 * free
    assert mended < 0.05 * spoilt  # half a sample of hold


def _tracking(machine, reference):
    from ffl.systems.two_sided import two_sided_filter
    from ffl.systems.zpk import Zpk

    p = machine.system
    return two_sided_filter(
        Zpk(p.poles, p.zeros, 1.0 / p.gain, p.sample_time), reference, hold=True
    )


@pytest.mark.parametrize("name", sorted(n for n in EFFECTS if EFFECTS[n].port != "flow"))
def test_every_effect_reads_its_own_parameters_back(name):
    """`nonlinear_of` is what `from_coefficients` was given: fitted and read back, the columns are
    the same."""
    effect = EFFECTS[name]
    t = T * np.arange(1200)
    x = 0.1 * np.sin(2 * np.pi * 1.5 * t) + 0.02 * t
    motion = replace(Motion.of_reference(x, T, 2.0), u=np.cos(9 * t))
    nonlinear = effect.grid(motion)[0]
    columns = effect.regressors(motion, **nonlinear)
    if effect.port != "force" or effect.compensation(motion, **nonlinear) is None:
        return
    coefficients = 0.3 + 0.1 * np.arange(columns.shape[1])
    values = effect.from_coefficients(coefficients, nonlinear)
    spec = EffectSpec(name, values)
    again = effect.compensation(motion, **effect.nonlinear_of(effect.check(spec)))
    assert effect.coefficients_of(effect.check(spec)) == pytest.approx(coefficients)
    assert again == pytest.approx(-columns, rel=1e-9, abs=1e-12)


def test_a_compensation_has_the_form_of_its_effect():
    values = {"level": 4.0, "stiffness": 4e3, "micro_damping": 0.0}
    forms = [
        EffectSpec("presliding_friction", values, {"kind": k}) for k in ("lugre", "maxwell_slip")
    ]
    machine = plant()
    columns = [Compensation(replace(machine, effects=(e,))).regressors(REFERENCE) for e in forms]
    one, other = (machine.physics.motor_constant * c[:, 0] for c in columns)
    assert other == pytest.approx(slip(REFERENCE, 1e-3))
    assert np.abs(one - other).max() > 0.1


def test_the_word_stands_for_derivatives_and_compensations():
    model = plant(FRICTION, SPRING)
    basis = make_basis("from_diagnosis", T, model)
    assert isinstance(basis, SumBasis)
    assert basis.names[:4] == ["velocity", "acceleration", "jerk", "snap"]
    assert basis.names[4] == "coulomb_friction"
    with pytest.raises(InputError, match="only basis that a word names"):
        make_basis("from_thin_air", T, model)
    with pytest.raises(InputError, match=r"\[0\].plant is missing"):
        make_basis([{"kind": "from_diagnosis"}], T)


@pytest.fixture(scope="module")
def hasty():
    """(machine, reference) of EMPS over moves that its effects show in."""
    return lambda *effects: (plant(FRICTION, *effects), REFERENCE)


def left_by(machine, reference, stated_of):
    """|r - y| over what feedback alone leaves, with derivatives and the compensation of `stated_of`."""
    basis = SumBasis(
        [
            Derivatives(["velocity", "acceleration", "jerk", "snap"], T),
            Compensation(stated_of),
        ]
    )
    update = AlongTrajectory(machine, basis, reference, Weights(1e9, 1e-9, 0.0))
    plan = update.plan(np.zeros(basis.n_parameters))
    errors = [reference - update.output(f) for f in (plan.feedforward, 0 * reference)]
    return np.linalg.norm(errors[0]) / np.linalg.norm(errors[1]), plan.theta


@pytest.mark.parametrize(
    "late",
    [
        EffectSpec("input_delay", {"delay": 2.6e-3}),
        EffectSpec("input_delay", {"delay": 3e-3}),
        EffectSpec("actuator_lag", {"time_constant": 4e-3}),
    ],
)
def test_what_arrives_late_is_sent_earlier(hasty, late):
    machine, reference = hasty(late)
    left, theta = left_by(machine, reference, machine)
    at_once, _ = left_by(machine, reference, plant(FRICTION))
    assert left < 0.5 * at_once
    assert theta[-1] == pytest.approx(20.0, rel=0.05)


def test_a_motor_that_is_weaker_elsewhere_is_asked_for_more():
    """With the stated numbers it is exact: what friction and mass take, by 1/k - 1."""
    gain = EffectSpec(
        "position_dependent_gain",
        {"linear_coefficient": 1.2, "quadratic_coefficient": -14.0, "centre": 0.01},
    )
    machine = plant(FRICTION, gain)
    basis = Compensation(machine)
    assert basis.names == [
        "coulomb_friction",
        "position_dependent_gain[0]",
        "position_dependent_gain[1]",
    ]
    left, theta = left_by(machine, REFERENCE, machine)
    without, _ = left_by(machine, REFERENCE, plant(FRICTION))
    assert left < 0.2 * without
    assert theta[-2:] == pytest.approx([1.2, -14.0], rel=0.1)
    v, a = np.gradient(REFERENCE, T), np.gradient(np.gradient(REFERENCE, T), T)
    away = REFERENCE - 0.01
    k = 1.0 + 1.2 * away - 14.0 * away**2
    taken = machine.physics.mass * a + basis.regressors(REFERENCE)[:, 0] * 20.0
    asked = basis.regressors(REFERENCE)[:, 1:] @ [1.2, -14.0]
    assert asked == pytest.approx((1.0 / k - 1.0) * taken, rel=1e-6, abs=1e-3 * np.abs(taken).max())
    assert np.abs(v).max() > 0.3


@pytest.mark.parametrize("name", ["emps", "flatbed_printer"])
def test_a_plants_own_delay_counts_once(name):
    """Whatever point a force acts at, its compensation comes as many samples earlier."""
    for side in ("sensor", "motor", "load"):
        if side == "load" and name == "emps":
            continue
        options = {"side": side, "mass_ratio": 1.5} if side == "load" else {"side": side}
        spring = EffectSpec("hardening_spring", {"cubic_coefficient": 3e3, "centre": 0.03}, options)
        at_once = plant(spring, name=name)
        late = replace(at_once, system=replace(at_once.system, delay=at_once.system.delay + 3))
        reference = np.concatenate([np.zeros(1500), REFERENCE, np.full(1500, REFERENCE[-1])])
        columns = Compensation(at_once).regressors(reference)
        earlier = Compensation(late).regressors(reference)
        most = np.abs(columns).max()
        assert earlier[1000:-1000] == pytest.approx(columns[1003:-997], abs=1e-3 * most), side


def test_of_a_motor_that_drives_y_down_the_command_turns():
    """Its coefficients are the effects' own, and with the stated ones it tracks as the other does."""
    gain = EffectSpec("position_dependent_gain", {"linear_coefficient": 1.2, "centre": 0.01})
    up = plant(FRICTION, SPRING, gain)
    system = replace(up.system, gain=-up.system.gain)
    controller = replace(
        up.controller,
        **{
            name: replace(part, gain=-part.gain)
            for name, part in vars(up.controller).items()
            if isinstance(part, Zpk)
        },
    )
    down = replace(up, system=system, controller=controller)
    assert Compensation(down).regressors(REFERENCE) == pytest.approx(
        -Compensation(up).regressors(REFERENCE), rel=1e-6, abs=1e-9
    )
    left, theta = left_by(down, REFERENCE, down)
    other, same = left_by(up, REFERENCE, up)
    assert left == pytest.approx(other, rel=0.05)
    assert theta[4:6] == pytest.approx(same[4:6], rel=0.02)

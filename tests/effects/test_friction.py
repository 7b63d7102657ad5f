"""Stick-slip done properly: standstill, breakaway, energy."""

import numpy as np
import pytest
from cases import ORACLE, STAGE, reference
from oracle import Case, run

from ffl.effects import EFFECTS
from ffl.effects.motion import Motion
from ffl.effects.position_dependent_friction import FINE, drawn_out
from ffl.effects.slip import slip
from ffl.errors import InputError
from ffl.machines import Simulator
from ffl.systems.plant import EffectSpec

DRY = (
    "coulomb_friction",
    "asymmetric_friction",
    "stribeck_friction",
    "position_dependent_friction",
)
OPEN = Simulator(STAGE, open_loop=True)
CLOSED = Simulator(STAGE)


def spec(name):
    return EffectSpec(name, ORACLE[name][0])


@pytest.mark.parametrize("name", DRY)
def test_no_motion_at_all_below_the_static_level(name):
    force = 1.9 * np.sin(np.arange(2000) * 0.01)
    run = OPEN.run([spec(name)], None, force)
    assert np.abs(run.x).max() < 1e-18
    assert np.abs(run.v).max() < 1e-15
    assert np.allclose(run.contribution[:, 0], -force, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "level"),
    [("coulomb_friction", 5.0), ("asymmetric_friction", 5.0), ("stribeck_friction", 6.0)],
)
def test_breaks_away_where_the_force_exceeds_the_static_level(name, level):
    ramp = np.linspace(0.0, 10.0, 1001)
    run = OPEN.run([spec(name)], None, ramp)
    first = int(np.argmax(run.v > 1e-12))
    assert ramp[first - 2] <= level < ramp[first]


@pytest.mark.parametrize("name", DRY)
def test_comes_to_rest_and_stays_without_chatter(name):
    push = np.where(np.arange(600) < 50, 20.0, 0.0)
    run = OPEN.run([spec(name)], None, push)
    assert run.v.max() > 0.1
    rest = run.v[-150:]
    assert np.abs(rest).max() < 1e-15
    assert np.ptp(run.x[-150:]) < 1e-18


@pytest.mark.parametrize("name", [*DRY, "presliding_friction", "hysteresis", "quadratic_drag"])
def test_power_of_friction_is_not_positive(name):
    """Energy taken from the mass over the run; a spring-like part gives back what it stored."""
    run = CLOSED.run([spec(name)], reference())
    work = run.contribution[:-1, 0] @ np.diff(run.x)
    assert work < 0
    if name in DRY:
        power = run.contribution[:-1, 0] * np.diff(run.x)
        assert power.max() < 1e-12


def test_a_stuck_mass_holds_a_servo_error():
    """Friction stops the creep of the weak servo (400 N/m) up to level/stiffness = 12.5 mm off."""
    r = np.concatenate([reference(), np.full(1500, reference()[-1])])
    linear, held = CLOSED.run((), r), CLOSED.run([spec("coulomb_friction")], r)
    assert np.ptp(held.y[-50:]) < 1e-18
    assert 1e-4 < abs(held.y[-1] - r[-1]) < 5.0 / 400.0
    assert abs(linear.y[-1] - r[-1]) < 1e-4


def test_stiff_presliding_converges_to_coulomb():
    r = reference()
    dry = CLOSED.run([spec("coulomb_friction")], r).y
    errors = []
    for stiffness in (1e5, 1e6, 1e7):
        damping = 2 * np.sqrt(stiffness * 2.0)
        lugre = EffectSpec(
            "presliding_friction",
            {"level": 5.0, "stiffness": stiffness, "micro_damping": damping},
        )
        run = CLOSED.run([lugre], r)
        errors.append(np.abs(run.y - dry).max())
        assert not run.diverged
    assert errors[0] > 3 * errors[1] > 9 * errors[2]


def test_friction_on_two_masses_clamps_only_its_own_side():
    from two_masses import two_mass_plant

    plant = two_mass_plant(measured="motor")
    push = np.where(np.arange(800) < 40, 3.0, 0.0)
    stuck_load = EffectSpec("coulomb_friction", {"level": 100.0}, {"side": "load"})
    run = Simulator(plant, open_loop=True).run([stuck_load], None, push, watch=[("load", None)])
    load = run.motion("load")
    assert np.abs(load.v).max() < 1e-12
    assert np.abs(load.x).max() < 0.01 * np.abs(run.x).max()
    assert np.abs(run.v).max() > 1e-3


@pytest.mark.parametrize("pair", [("coulomb_friction", "coulomb_friction"),
                                  ("asymmetric_friction", "stribeck_friction")])  # fmt: skip
def test_two_frictions_on_one_mass_hold_and_slide_together(pair):
    """Split in two, friction stays what it is: 3 + 2 = 5; and asymmetric beside Stribeck adds up."""
    parts = {
        "coulomb_friction": ({"level": 3.0}, {"level": 2.0}),
        "asymmetric_friction": ({"level_positive": 2.0, "level_negative": 1.0},),
        "stribeck_friction": (
            {"coulomb_level": 1.0, "static_level": 2.0, "stribeck_velocity": 0.02},
        ),
    }
    if pair[0] == pair[1]:
        specs = [EffectSpec(pair[0], p) for p in parts[pair[0]]]
        case = Case(levels=lambda x, v: (5.0, 5.0))
    else:
        specs = [EffectSpec(name, parts[name][0]) for name in pair]

        def levels(x, v):
            near = 1.0 + np.exp(-((v / 0.02) ** 2))
            return 2.0 + near, 1.0 + near

        case = Case(levels=levels)
    r = reference()
    truth, linear = run(case, r), CLOSED.run((), r).y
    for order in (specs, specs[::-1]):
        y = CLOSED.run(order, r).y
        assert np.abs(y - truth).max() < 1e-4 * np.abs(truth - linear).max()


def test_asymmetric_friction_is_coulomb_beside_a_load():
    """What the data cannot tell apart is the same here, standstill included."""
    one = [EffectSpec("asymmetric_friction", {"level_positive": 5.0, "level_negative": 3.0})]
    two = [
        EffectSpec("coulomb_friction", {"level": 4.0}),
        EffectSpec("constant_load", {"force": -1.0}),
    ]
    y = [CLOSED.run(specs, reference()).y for specs in (one, two)]
    assert np.abs(y[0] - y[1])[60:].max() < 1e-12


def test_a_slipping_contact_loads_like_one_bristle_and_returns_by_masings_rule():
    """From rest 1 - exp(-x); from a reversal at x0 the same curve twice as large; a small loop closes
    and leaves no trace."""
    there = np.linspace(0.0, 1.5, 301)
    back = np.linspace(1.5, -0.2, 341)[1:]
    loading, returning = np.split(slip(np.concatenate([there, back]), 1.0), [301])
    assert np.abs(loading - (1.0 - np.exp(-there))).max() < 0.005
    assert np.abs(loading[-1] - returning - 2 * (1 - np.exp(-(1.5 - back) / 2))).max() < 0.01
    detour = np.concatenate([there, [1.1, 1.5], [2.0]])
    assert slip(detour, 1.0)[-1] == pytest.approx(slip(np.append(there, 2.0), 1.0)[-1], rel=1e-12)


def test_a_slipping_contact_holds_a_push_below_its_level_and_drifts_no_further():
    """One bristle creeps under a push that swings; elements that slide one by one hold it."""
    push = 3.0 + 1.0 * np.sin(np.arange(6000) * 0.05)
    values = {"level": 5.0, "stiffness": 2e5, "micro_damping": 300.0}
    crept = []
    for kind in ("maxwell_slip", "lugre"):
        run = OPEN.run([EffectSpec("presliding_friction", values, {"kind": kind})], None, push)
        crept.append(run.x[4000:].max() - run.x[1500:3500].max())
    assert abs(crept[0]) < 1e-3 * crept[1]


def table(**contact):
    flat = {"grid": [-1.0, 1.0], "positive": [5.0, 5.0], "negative": [5.0, 5.0]}
    return EffectSpec("position_dependent_friction", {"table": flat, **contact})


SLIDES = {"level": 5.0, "stiffness": 2e5, "micro_damping": 100.0}
BOUC_WEN = {"force": 5.0, "displacement": 1e-4, "exponent": 1.0, "beta": 0.5}


@pytest.mark.parametrize(
    "contact",
    [
        EffectSpec("presliding_friction", SLIDES, {"kind": "lugre"}),
        EffectSpec("presliding_friction", SLIDES, {"kind": "maxwell_slip"}),
        EffectSpec("hysteresis", BOUC_WEN),
        table(stiffness=2e5),
    ],
    ids=["lugre", "slip", "bouc_wen", "table"],
)
def test_a_run_cut_in_motion_goes_on_from_the_travel_until_then(contact):
    r = reference()
    whole = CLOSED.run([contact], r)
    cut = int(np.argmin(whole.v))  # at full speed on the way back
    first = CLOSED.run([contact], r[:cut])
    travel = whole.y[cut] - whole.y[:cut].max()
    assert travel < -0.003
    later = CLOSED.run([contact], r[cut:], start=first.end, travel=travel).y - whole.y[cut:]
    fresh = CLOSED.run([contact], r[cut:], start=first.end).y - whole.y[cut:]
    assert np.abs(later).max() < 1e-9 * np.abs(fresh).max()


def test_a_flat_table_that_yields_is_presliding_friction():
    r = reference()
    lugre = EffectSpec(
        "presliding_friction", {"level": 5.0, "stiffness": 2e5, "micro_damping": 0.0}
    )
    a, b = CLOSED.run([lugre], r), CLOSED.run([table(stiffness=2e5)], r)
    assert np.allclose(a.y, b.y, rtol=1e-12, atol=1e-15)


def test_a_table_may_ease_near_standstill():
    """At a crawl friction is static_ratio times the table, at speed the table."""
    eases = table(stiffness=2e5, static_ratio=0.6, stribeck_velocity=0.05)
    for speed, level in ((2e-3, 3.0), (0.5, 5.0)):
        run = CLOSED.run([eases], speed * 1e-3 * np.arange(10000))
        assert run.contribution[-1, 0] == pytest.approx(-level, rel=2e-3)


@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_a_yielding_table_takes_energy(ratio):
    eases = table(stiffness=2e5, static_ratio=ratio, stribeck_velocity=0.02)
    run = CLOSED.run([eases], reference())
    assert run.contribution[:-1, 0] @ np.diff(run.x) < 0


def test_another_velocity_of_logarithmic_friction_keeps_the_force_at_the_first():
    effect, values = EFFECTS["logarithmic_friction"], {"level": 2.0, "velocity": 0.03}
    other = effect.rung(values, "velocity", 0.002)
    assert other["velocity"] == 0.002
    force = [p["level"] * np.arcsinh(0.03 / p["velocity"]) for p in (values, other)]
    assert force[0] == pytest.approx(force[1], rel=1e-12)


def waved(count):
    """A level that goes as a wave over position, at so many knots."""
    grid = np.linspace(-0.03, 0.03, count)
    up, down = 5.0 + 2.0 * np.sin(140.0 * grid), 5.0 - 1.5 * np.cos(100.0 * grid)
    return {"grid": grid.tolist(), "positive": up.tolist(), "negative": down.tolist()}


def waves(count, **options):
    return EffectSpec("position_dependent_friction", {"table": waved(count)}, options)


def test_a_smooth_table_goes_on_the_spline_through_its_knots():
    smooth = waves(9, interpolation="cubic")
    finer = EffectSpec(smooth.name, {"table": drawn_out(waved(9))})
    assert len(finer.parameters["table"]["grid"]) == 8 * FINE + 1
    r = reference()
    run = CLOSED.run([smooth], r)
    assert np.array_equal(run.y, CLOSED.run([finer], r).y)
    exact = CLOSED.run([waves(2001)], r).y
    left = [np.abs(y - exact).max() for y in (run.y, CLOSED.run([waves(9)], r).y)]
    assert 0.0 < 10.0 * left[0] < left[1]


def test_a_smooth_table_never_falls_below_zero():
    dips = {"grid": [0.0, 1.0, 2.0, 3.0, 4.0], "positive": [9.0, 0.0, 0.0, 0.0, 9.0]}
    levels = drawn_out({**dips, "negative": [1.0, 1.0, 1.0, 1.0, 1.0]})
    assert min(levels["positive"]) == 0.0
    assert np.allclose(levels["negative"], 1.0)


def test_regressors_of_a_smooth_table_make_its_force():
    spec = waves(9, interpolation="cubic")
    effect = EFFECTS[spec.name]
    motion = Motion.of_reference(reference(), STAGE.sample_time)
    form = {**effect.nonlinear_of(spec.parameters), **spec.options}
    force = effect.regressors(motion, **form) @ effect.coefficients_of(spec.parameters)
    levels = drawn_out(spec.parameters["table"])
    up, down = (np.interp(motion.x, levels["grid"], levels[k]) for k in ("positive", "negative"))
    wanted = -np.where(motion.direction > 0, up, down) * motion.direction
    assert np.allclose(force, wanted, rtol=1e-9, atol=1e-12)


def test_an_interpolation_that_nobody_knows_is_told():
    with pytest.raises(InputError, match="cubic"):
        CLOSED.run([waves(9, interpolation="cubics")], reference())

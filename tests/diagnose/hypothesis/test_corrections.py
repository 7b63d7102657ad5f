"""Corrections of the linear model: what unit each is told in."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg

from ffl.diagnose.contest.line import LATE, slight
from ffl.diagnose.hypothesis.amounts import effect_values, own_damping
from ffl.diagnose.hypothesis.coordinate import Coordinate
from ffl.diagnose.hypothesis.corrections import as_gain, beside_maps, corrections
from ffl.diagnose.hypothesis.linear import (
    changed_stiffness,
    corrected,
    corrected_plant,
    corrections_of,
)
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.result import ModelCorrection
from ffl.effects.cascade import lags
from ffl.machines.simulator import Simulator
from ffl.systems import EffectSpec, Physics, Plant, Zpk, load_plant
from ffl.systems.plant_file import plant_from_dict
from ffl.systems.state_space import StateSpace

T = 1e-3


def standing(pole, values, effects=()):  # type: ignore[no-untyped-def]
    """A judged model with the named corrections, each known to a tenth."""
    plant = Plant("mass", Zpk([-1.0], [1.0, pole], 5e-8, T), None)
    base = Base.of(plant)
    coordinates = [Coordinate("correction", name) for name in values]
    coordinates += [
        Coordinate("effect", name, effect=k)
        for k, effect in enumerate(effects)
        for name in effect.parameters
    ]
    spread = [0.1 * abs(value) for value in values.values()] + [1e-6] * len(effects)
    model = SimpleNamespace(
        base=base, coordinates=coordinates, corrections=values, effects=tuple(effects)
    )
    return SimpleNamespace(model=model, spread=spread)


def test_damping_is_relative_where_the_plant_has_some():
    found = corrections(standing(0.999, {"mass": 0.01, "damping": 0.1}))  # type: ignore[arg-type]
    assert [(c.name, c.unit) for c in found] == [("mass", ""), ("damping", "")]
    assert found[1].relative == pytest.approx(0.1, rel=0.01)  # d = 1/s


@pytest.mark.parametrize("pole", [1.0, 1.0 - 1e-14])
def test_damping_of_a_free_mass_is_told_as_it_is(pole):
    (found,) = corrections(standing(pole, {"damping": -0.4}))  # type: ignore[arg-type]
    assert (found.relative, found.unit) == (-0.4, "1/s")


def test_a_slight_delay_is_told_in_samples():
    delay = EffectSpec("input_delay", {"delay": 5e-5})
    (found,) = corrections(standing(0.999, {}, [delay]))  # type: ignore[arg-type]
    assert found.relative == pytest.approx(0.05)
    assert found.unit == "samples"


@pytest.mark.parametrize(("source", "most"), [("", 0.1), ("ffl identify linear of a run", 1.0)])
@pytest.mark.parametrize(("name", "number"), LATE.items())
def test_zeros_that_were_identified_hold_a_delay_within_a_sample(stage, source, most, name, number):
    plant = replace(stage, source=source)
    spec = EffectSpec(name, {number: 0.99 * most * plant.sample_time})
    assert slight(spec, plant)
    assert not slight(replace(spec, parameters={number: 1.01 * most * plant.sample_time}), plant)


LAGS = Plant("two lags", Zpk([-0.9], [0.93, 0.975], 6e-4, 2.0), input_unit="%", output_unit="degC")


@pytest.mark.parametrize("apart", [0.1, 0.0, -0.2, -0.48])
def test_two_lags_of_a_process_are_corrected_by_how_far_they_lie_apart(apart):
    """Their rates are d (1 +- r)/2, the gain at rest is the mass's and the stiffness's."""
    base = Base.of(LAGS)
    fast, slow = np.sort(-np.log([0.93, 0.975]) / 2.0)[::-1]
    values = {"mass": 0.25, "damping": 0.1 * (fast + slow), "apart": apart}
    r = (fast - slow) / (fast + slow) + apart
    found = corrected(base.simulator.mechanics, values)
    assert lags(found) == pytest.approx(
        0.55 * (fast + slow) * np.array([1.0 - r, 1.0 + r]), rel=1e-6
    )
    at_rest = [-m.c @ np.linalg.solve(m.a, m.b) for m in (base.simulator.mechanics, found)]
    stiffness = changed_stiffness(base.simulator.mechanics, values)
    gain = 1.0 / (1.25 * (1.0 + stiffness))  # but for the zero of the hold
    assert at_rest[1] / at_rest[0] == pytest.approx(gain, rel=5e-4)
    assert 1.0 + stiffness == pytest.approx(np.prod(lags(found)) / (fast * slow), rel=1e-6)


def test_gain_and_stiffness_of_two_lags_are_told_with_all_doubt_of_what_they_hang_on():
    """As much more of it as coloured misfit makes of each number; none where the lags became one."""
    base = Base.of(LAGS)
    free = {c.name: c for c in base.corrections}
    coordinates = [
        Coordinate("correction", n, lower=c.lower, upper=c.upper) for n, c in free.items()
    ]

    def told(apart: float, more: float) -> dict[str, ModelCorrection]:
        values = {"mass": 0.25, "damping": 0.0, "apart": apart}
        model = SimpleNamespace(
            base=base, coordinates=coordinates, corrections=values, effects=(), stated=()
        )
        plain = np.array([1e-3, 1e-5, 1e-3])
        fit = SimpleNamespace(covariance=np.diag(plain**2), spread=plain)
        found = corrections(SimpleNamespace(model=model, fit=fit, spread=more * plain))  # type: ignore[arg-type]
        return {c.name: c for c in found}

    once, twice, ended = told(-0.2, 1.0), told(-0.2, 2.0), told(free["apart"].lower, 1.0)
    assert set(once) == {"gain", "stiffness"}
    for name, c in once.items():
        assert twice[name].std_error == pytest.approx(2.0 * c.std_error, rel=1e-9)
    r = free["apart"].lower
    slope = 2.0 * abs(-0.2 - r) / (1.0 - r**2)  # of (1 - (r + apart)^2)/(1 - r^2)
    damping = own_damping(Model(base))
    assert once["stiffness"].std_error == pytest.approx(
        np.hypot(1e-3 * slope, 2e-5 / damping * (1.0 + once["stiffness"].relative)), rel=1e-3
    )
    assert ended["stiffness"].std_error is None


def test_two_lags_become_one_without_a_kink():
    """An outflow tells the slow lag from the fast: its y is smooth up to where they are one (as a function
    of the stiffness it would begin like a root, and a fit got stuck there)."""
    base = Base.of(LAGS, 1.0)
    outflow = EffectSpec("outflow", {"empty": -2.0, "centre": 3.0}, {"side": "slow"})
    u = np.repeat([0.0, 30.0, -20.0], 200)
    one = next(c.lower for c in base.corrections if c.name == "apart")

    def made(apart: float) -> np.ndarray:
        model = Model(base, {"mass": 0.0, "damping": 0.0, "apart": apart}, (outflow,))
        return model.simulator.run((outflow,), feedforward=u).y

    ends = [made(one + step) for step in (0.0, 1e-3, 2e-3)]
    first, second = ends[1] - ends[0], ends[2] - ends[1]
    assert np.abs(first).max() > 1e-6
    np.testing.assert_allclose(second, first, atol=0.03 * np.abs(first).max())


AMOUNTS = {"mass": 0.07, "damping": 0.05, "stiffness": 0.05}


@pytest.mark.parametrize("name", ["emps", "flatbed_printer", "kernel2018_loop", "silverbox_linear"])
@pytest.mark.parametrize("side", ["sensor", "motor", "load"])
def test_points_of_a_corrected_plant_are_those_of_its_plant_file(name, side):
    """u to the motion of the point, a force there to y, and to the point's own velocity."""
    plant = load_plant(name)
    nominal = Simulator(plant).mechanics
    values = {
        c.name: AMOUNTS.get(c.name, -0.06 if "frequency" in c.name else 0.2)
        for c in corrections_of(nominal)
    }
    ours = corrected(nominal, values)
    anew = Simulator(corrected_plant(plant, nominal, values)).mechanics
    for w in (3.0, 50.0, 400.0):
        seen = [_paths(m, m.point(side), w) for m in (ours, anew)]
        np.testing.assert_allclose(seen[0], seen[1], rtol=1e-8)


def test_a_further_mode_keeps_what_the_sensor_sees_of_it():
    """y = (g + r s) eta: a mode that is stiffer and better damped changes eta alone."""
    nominal = Simulator(load_plant("kernel2018_loop")).mechanics
    moved = corrected(nominal, {"mode_1_frequency": 0.1, "mode_1_damping": 0.3})
    for w in (3.0, 50.0, 400.0):
        shares = [m.modes[1].position @ _state(m, w) for m in (nominal, moved)]
        own = [
            (1j * w) ** 2 + 1j * w * mode.damping + mode.stiffness
            for mode in (nominal.modes[1], moved.modes[1])
        ]
        assert shares[1] * own[1] == pytest.approx(shares[0] * own[0], rel=1e-9)


def _state(mechanics, w):  # type: ignore[no-untyped-def]
    """The state under u = exp(j w t)."""
    return np.linalg.solve(1j * w * np.eye(mechanics.order) - mechanics.a, mechanics.b)


def _paths(mechanics, point, w):  # type: ignore[no-untyped-def]
    n = mechanics.order
    at = np.linalg.inv(1j * w * np.eye(n) - mechanics.a)
    return [
        point.position @ at @ mechanics.b,
        mechanics.c @ at @ point.force,
        point.velocity @ at @ point.force,
    ]


def moved(standing, **values):  # type: ignore[no-untyped-def]
    """A mass on a spring with a damper whose mass was changed, the rest corrected, to a thousandth."""
    plant = Plant("on a spring", Zpk([-1.0], [0.99 + 0.05j, 0.99 - 0.05j], 5e-8, T), None)
    change = EffectSpec("mass_change", {"change": values.pop("mass")})
    found = standing(0.999, values, [change])
    found.model.base = Base.of(plant)
    found.spread = [2e-3 * abs(v) for v in values.values()] + [2e-5]
    return found


@pytest.mark.parametrize(("stiffness", "one"), [(-0.0291, True), (-0.02, False), (0.0291, False)])
def test_mass_damping_and_stiffness_off_by_one_share_are_the_gain_of_the_drive(stiffness, one):
    plant = moved(standing, mass=-0.0291, damping=1.0).model.base
    damping = own_damping(SimpleNamespace(base=plant))
    found = moved(standing, mass=-0.0291, damping=-0.0291 * damping, stiffness=stiffness)
    gain = as_gain(found)
    assert gain == pytest.approx(0.02997, rel=1e-3) if one else gain is None


@pytest.mark.parametrize(("more", "one"), [(2.0 / 3.0, True), (0.5, False)])
def test_a_mass_and_a_damping_that_are_named_are_one_gain_where_there_is_no_spring(more, one):  # type: ignore[no-untyped-def]
    """A radar antenna whose torque was logged in per cent: 66.7 % more mass and damping, 0.97 each."""
    model = Model(Base.of(Plant("antenna", Zpk([-1.0], [1.0, 0.999], 5e-8, T), None)))
    own = effect_values(replace(model, corrections={"damping": own_damping(model)}), "damping")
    effects = (
        EffectSpec("mass_change", {"change": 2.0 / 3.0}),
        EffectSpec("viscous_friction", {"coefficient": more * own["coefficient"]}),
    )
    model = replace(model, effects=effects, held=frozenset({"mass", "damping"}))
    names = [c.name for c in model.coordinates if c.kind == "effect"]
    assert names == ["change", "coefficient"]
    spread = [1e-4 if c.name == "change" else 1e-3 * own["coefficient"] for c in model.coordinates]
    gain = as_gain(SimpleNamespace(model=model, spread=spread))
    assert gain == pytest.approx(-0.4) if one else gain is None


def test_what_went_into_the_plant_beside_a_map_is_told_without_an_error():
    model = standing(0.999, {"mass": 0.01, "damping": 1.4}).model  # d = 1/s
    (found,) = beside_maps(model)
    assert (found.name, found.std_error) == ("damping", None)
    assert found.relative == pytest.approx(1.4, rel=0.01)


@pytest.mark.parametrize("fast", [(), (-2490.0,)])
def test_one_lag_has_a_gain_and_a_time_constant(fast):
    """Beside a pole so fast that nothing is left of it after a sample as well."""
    poles = [-8.0, *fast]
    plant = plant_from_dict(
        {
            "name": "valve", "sample_time": 0.02, "units": {"input": "bar", "output": "mm"},
            "plant": {"form": "czpk", "zeros": [], "poles": poles, "gain": 25.0 * abs(np.prod(poles))},
        }
    )  # fmt: skip
    mechanics = Simulator(plant).mechanics
    assert [c.name for c in corrections_of(mechanics)] == ["gain", "time_constant"]
    slower = corrected_plant(plant, mechanics, {"gain": 0.01, "time_constant": 0.05}).system
    assert np.abs(np.linalg.eigvals(slower.a)).max() == pytest.approx(np.exp(-8.0 * 0.02 / 1.05))
    steps = np.ones(400)
    assert slower.filter(steps)[-1] == pytest.approx(1.01 * 25.0, rel=2e-4)


def test_a_heavier_machine_without_a_resonance_is_heavier_whatever_else_is_free():
    """1 kg, 50 N s/m, 400 N/m: lags in a row, but a mass that the plant file knows."""

    def machine(mass):  # type: ignore[no-untyped-def]
        a = np.array([[0.0, 1.0], [-400.0 / mass, -50.0 / mass]])
        block = np.zeros((3, 3))
        block[:2, :2], block[1, 2] = a, 1.0 / mass
        held = scipy.linalg.expm(block * T)
        system = StateSpace(held[:2, :2], held[:2, 2:], np.array([[1.0, 0.0]]), 0.0, T)
        return Plant("overdamped", system, None, "N", "m", "", Physics(1.0, 1.0))

    base = Base.of(machine(1.0))
    assert len(lags(base.simulator.mechanics)) == 2
    assert not base.is_process
    u = np.where(np.arange(4000) < 2000, 1.0, -0.5)
    true = Simulator(machine(1.2)).run((), feedforward=u).y
    for others in ({}, {"damping": 0.0}, {"damping": 0.0, "stiffness": 0.0}):
        other = Model(base, {"mass": 0.2, **others}).simulator.run((), feedforward=u).y
        assert np.abs(other - true).max() < 1e-12

"""Tanks in a row against an independent adaptive integration of their own equations."""

import numpy as np
import pytest
from cases import FLOW, STAGE
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from ffl.effects import EFFECTS, Motion, check_effects, mechanics_of
from ffl.effects.cascade import lags
from ffl.errors import InputError
from ffl.machines import Simulator
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import StateSpace
from ffl.systems.zpk import Zpk

STEP = 4.0  # s
SLOW, FAST, GAIN = 0.006, 0.015, 3.0


def tanks(upper, lower):
    """x1' = upper (3 u - x1), x2' = lower (x1 - x2), y = x2 under a zero-order hold."""
    a = np.array([[-upper, 0.0], [lower, -lower]])
    held = expm(a * STEP)
    b = np.linalg.solve(a, (held - np.eye(2)) @ np.array([[upper * GAIN], [0.0]]))
    return Plant("tanks", StateSpace(held, b, [[0.0, 1.0]], 0.0, STEP), None, "V", "V")


def command(n=160):
    """Slow swings and steps that empty the tanks and make them overflow."""
    t = np.arange(n)
    return np.where(t % 40 < 20, 3.6, 0.9) + 0.5 * np.sin(2 * np.pi * t / 23)


def truth(u, upper, lower, empty=None, centre=5.0, height=np.inf, share=1.0, rim=np.inf):
    """Events at the rims, roots of the levels, to 1e-10."""

    def flow(x):
        if empty is None:
            return x
        reach = centre - empty
        return centre + 2 * reach * (np.sqrt(max((x - empty) / reach, 0.0)) - 1)

    def rates(t, x, inflow, full, brimming):
        x1 = height if full else x[0]
        rise = upper * (inflow - flow(x1))
        over = max(rise, 0.0) / upper if full else 0.0
        second = lower * (flow(x1) + share * over - flow(x[1]))
        return [0.0 if full else rise, 0.0 if brimming else second]

    x, y = np.zeros(2), []
    if empty is not None:
        x[:] = 2.0
    for value in u:
        y.append(x[1])
        t, inflow = 0.0, GAIN * value
        while t < STEP - 1e-12:
            full = x[0] >= height - 1e-12 and inflow > flow(height)
            arrives = flow(x[0]) + (share * (inflow - flow(height)) if full else 0.0)
            brimming = x[1] >= rim - 1e-12 and arrives > flow(rim)
            beyond = share * (inflow - flow(height)) if full else 0.0
            events = []
            if not full and np.isfinite(height):
                events.append(lambda t, x, *_: x[0] - height)
            if not brimming and np.isfinite(rim):
                events.append(lambda t, x, *_: x[1] - rim)
            if brimming:  # until less arrives than flows out below the rim
                events.append(lambda t, x, *_, more=beyond: flow(rim) - flow(x[0]) - more)
            for event in events:
                event.terminal, event.direction = True, 1
            one = solve_ivp(
                rates, (t, STEP), x, "DOP853", rtol=1e-10, atol=1e-12,
                args=(inflow, full, brimming), events=events or None,
            )  # fmt: skip
            x, t = one.y[:, -1].copy(), float(one.t[-1])
    return np.array(y)


CASES = {  # parameters, the same for the oracle, largest error relative to the effect
    "outflow": ({"empty": 1.0, "centre": 5.0}, {"empty": 1.0}, 3e-3),
    "overflow": ({"height": 7.0, "share": 0.6}, {"height": 7.0, "share": 0.6}, 5e-5),
    "spill": ({"height": 6.5}, {"rim": 6.5}, 3e-3),
}


def start_of(simulator, level):
    """Both tanks at `level`, standing still."""
    return simulator.at_rest(level)


@pytest.mark.parametrize("upper", ["slow", "fast"])
@pytest.mark.parametrize("name", FLOW)
def test_against_adaptive_integration(name, upper):
    rates = (SLOW, FAST) if upper == "slow" else (FAST, SLOW)
    plant = tanks(*rates)
    parameters, same, bound = CASES[name]
    simulator, u = Simulator(plant), command()
    start = start_of(simulator, 2.0 if name == "outflow" else 0.0)
    side = upper if name != "spill" else f"after_{upper}"
    spec = EffectSpec(name, parameters, {"side": side})
    expected = truth(u, *rates, **same)
    linear = simulator.run((), None, u, start=start).y
    effect = np.abs(linear - expected).max()
    assert effect > 0.1
    error = np.abs(simulator.run([spec], None, u, start=start).y - expected).max()
    assert error < bound * effect
    finer = simulator.run([spec], None, u, start=start, substeps=8).y
    assert np.abs(finer - expected).max() < bound * effect / 8


def test_all_three_share_the_tanks():
    plant = tanks(SLOW, FAST)
    simulator, u = Simulator(plant), command()
    specs = [
        EffectSpec("outflow", {"empty": 1.0, "centre": 5.0}, {"side": "slow"}),
        EffectSpec("overflow", {"height": 7.0, "share": 0.6}, {"side": "slow"}),
    ]
    expected = truth(u, SLOW, FAST, empty=1.0, height=7.0, share=0.6)
    start = start_of(simulator, 2.0)
    for order in (specs, specs[::-1]):
        y = simulator.run(order, None, u, start=start).y
        assert np.abs(y - expected).max() < 2e-3
    rim = EffectSpec("spill", {"height": 6.0}, {"side": "after_slow"})
    y = simulator.run([*specs, rim], None, u, start=start).y
    assert y.max() < 6.0 + 1e-6


def test_a_tank_alone_empties_through_its_orifice():
    plant = Plant("tank", StateSpace([[np.exp(-SLOW * STEP)]], [[1 - np.exp(-SLOW * STEP)]],
                                     [[1.0]], 0.0, STEP))  # fmt: skip
    spec = EffectSpec("outflow", {"empty": 0.0, "centre": 5.0})
    n, full = 120, 8.0
    y = Simulator(plant).run([spec], None, np.full(n, -5.0), start=[full]).y
    # u = -5 is no inflow: sqrt(h) falls by slow sqrt(centre) t, down to nothing.
    t = STEP * np.arange(n)
    root = np.sqrt(full) - SLOW * np.sqrt(5.0) * t
    assert np.abs(y - np.maximum(root, 0.0) ** 2).max() < 1e-3 * full


def test_points_ask_for_lags_in_a_row():
    assert np.allclose(lags(mechanics_of(tanks(FAST, SLOW).system)), [SLOW, FAST])
    assert not len(lags(mechanics_of(STAGE.system)))  # integrates
    ringing = Zpk([], [0.9 + 0.3j, 0.9 - 0.3j], 0.1, 1e-3)
    assert not len(lags(mechanics_of(ringing)))
    with pytest.raises(InputError, match="two real lags in a row"):
        Simulator(STAGE).run([EffectSpec("overflow", {"height": 1.0})], np.zeros(5))
    one = Plant("one", StateSpace([[0.98]], [[0.1]], [[1.0]], 0.0, STEP))
    with pytest.raises(InputError, match="two real lags in a row"):
        Simulator(one).run([EffectSpec("overflow", {"height": 1.0})], None, np.zeros(5))


@pytest.mark.parametrize("name", FLOW)
def test_describes_itself(name):
    effect, (parameters, _, _) = EFFECTS[name], CASES[name]
    words = effect.says(effect.check(EffectSpec(name, parameters)), tanks(SLOW, FAST))
    assert words.endswith(".")
    assert any(character.isdigit() for character in words)
    assert set(effect.siblings) <= set(EFFECTS) - {name}
    motion = Simulator(tanks(SLOW, FAST)).run((), None, command()).motion()
    for point in effect.grid(motion):
        effect.check(EffectSpec(name, effect.from_coefficients(np.ones(1), point)))


def test_an_outlet_above_the_operating_level_is_refused():
    spec = EffectSpec("outflow", {"empty": 6.0, "centre": 5.0})
    with pytest.raises(InputError, match="must lie below centre"):
        check_effects(Plant("t", tanks(SLOW, FAST).system, effects=(spec,)))


def test_the_operating_point_of_a_linear_model_is_tried_as_the_centre():
    """0, where it is written in deviations, beside the middle of what was recorded."""
    x = np.linspace(-40.0, 50.0, 400)
    still = np.zeros_like(x)
    motion = Motion(STEP * np.arange(400), still, still, x, still, still, STEP)
    tried = EFFECTS["outflow"].grid(motion)
    assert {start["centre"] for start in tried} == {0.0, motion.middle}
    assert all(start["empty"] < start["centre"] for start in tried)


def test_the_ladder_of_an_outlet_goes_down_from_the_centre():
    """Whatever the sign of the level that a regressor proposes, far below all that was seen."""
    effect, values = EFFECTS["outflow"], {"empty": -2.6, "centre": 4.8}
    name, factors = effect.ladder
    rungs = effect.scaled(values, name, factors)
    assert rungs.max() > 1.0
    assert any(rung == pytest.approx(-2.6) for rung in rungs)
    for rung in rungs:
        effect.check(EffectSpec("outflow", effect.rung(values, name, float(rung))))

"""Tanks in a row, made by small Euler steps of their own equations: which effect, and when none."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.hypothesis.places import flow_places
from ffl.diagnose.screen.screen import Screen
from ffl.effects import EFFECTS
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec, Physics, Plant
from ffl.systems.zpk import Zpk

STEP, UPPER, LOWER, GAIN = 5.0, 0.010, 0.016, 0.09
BEND = 0.4  # m


def plant(**changes) -> Plant:
    """The lags of both tanks about a flow of 0.5, in litres per minute and metres."""
    poles = np.exp(-STEP * np.array([UPPER, LOWER]))
    gain = GAIN * float(np.prod(1 - poles)) / 2.0
    return Plant("tanks", Zpk([-1.0], poles, gain, STEP), None, "l/min", "m", **changes)


def pump(seed: int, n: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    t = np.arange(n)
    hold = np.repeat(rng.uniform(0.0, 10.0, n // 40 + 1), 40)[:n]
    return hold + 1.5 * np.sin(2 * np.pi * t / 97)


def recording(
    seed: int, root: bool, height: float, share: float, bend: float = 1.0, end: float = np.inf
) -> Recording:
    """Levels about 0.45 m at 5 l/min; orifices as steep there as the lags, empty at 0. Above
    0.4 m the sensor gives `bend` times as much, up to its `end`."""
    n = 500
    u, rng = pump(seed, n), np.random.default_rng(seed + 1)
    first, second, y, fine = 0.3, 0.3, np.empty(n), 200
    middle = 0.45

    def flow(level):
        return 2 * math.sqrt(middle * max(level, 0.0)) - middle if root else level

    for k, pumped in enumerate(u.tolist()):
        y[k] = second
        for _ in range(fine):
            rise = UPPER * (GAIN * pumped - flow(first)) * STEP / fine
            over = max(first + rise - height, 0.0)
            arrives = LOWER * (flow(first) - flow(second)) * STEP / fine
            first += rise - over
            second += arrives + LOWER / UPPER * share * over
    y += (bend - 1.0) * np.maximum(y - BEND, 0.0) + 1e-3 * rng.standard_normal(n)
    y = np.minimum(y, end)
    t = STEP * np.arange(n)
    return Recording(t=t, r=0 * u, f=u, u=u, y=y, d=None, sample_time=STEP, source=f"made, {seed}")


def named(**physics):
    found = diagnose(plant(), [recording(11, **physics)], [recording(12, **physics)])
    return {effect["name"]: effect for effect in found.answer()["effects"]}, found.verdict


def test_an_overflow_is_named_with_its_height_and_share():
    effects, _ = named(root=False, height=0.65, share=0.6)
    assert list(effects) == ["overflow"]
    numbers = effects["overflow"]["parameters"]
    assert numbers["height"]["value"] == pytest.approx(0.65, rel=0.02)
    assert numbers["share"]["value"] == pytest.approx(0.6, abs=0.04)


def test_an_orifice_is_named_with_the_level_where_nothing_flows():
    effects, _ = named(root=True, height=np.inf, share=0.0)
    assert "outflow" in effects
    assert effects["outflow"]["parameters"]["empty"]["value"] == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("bend", [1.7, 0.6])
def test_a_scale_that_bends_is_named_with_where_and_by_how_much(bend):
    effects, _ = named(root=False, height=np.inf, share=0.0, bend=bend)
    assert list(effects) == ["sensor_bend"]
    numbers = effects["sensor_bend"]["parameters"]
    assert numbers["level"]["value"] == pytest.approx(BEND, abs=0.01)
    assert numbers["ratio"]["value"] == pytest.approx(bend, rel=0.05)


@pytest.mark.parametrize("end", [np.inf, 0.75])
def test_a_scale_that_bends_and_ends_over_tanks_that_overflow(end):
    effects, _ = named(root=False, height=0.65, share=0.6, bend=1.7, end=end)
    clipped = set() if end == np.inf else {"sensor_nonlinearity"}
    assert set(effects) == {"overflow", "sensor_bend"} | clipped
    bent, over = (effects[name]["parameters"] for name in ("sensor_bend", "overflow"))
    assert bent["level"]["value"] == pytest.approx(BEND, abs=0.005)
    assert bent["ratio"]["value"] == pytest.approx(1.7, rel=0.02)
    assert over["height"]["value"] == pytest.approx(0.65, rel=0.02)  # on the scale below the bend
    assert over["share"]["value"] == pytest.approx(0.6, abs=0.04)


def test_tanks_under_a_straight_scale_are_no_bend():
    effects, _ = named(root=True, height=0.65, share=0.6)
    assert set(effects) == {"outflow", "overflow"}


def test_lags_that_are_just_lags_miss_nothing():
    effects, verdict = named(root=False, height=np.inf, share=0.0)
    assert not effects
    assert verdict == "nothing_missing"


def test_flows_are_offered_to_lags_in_a_row_alone():
    outflow, overflow = EFFECTS["outflow"], EFFECTS["overflow"]
    tanks = Model(Base.of(plant()))
    assert [p.side for p in flow_places(tanks, overflow)] == ["slow", "fast"]
    decided = tanks.with_effect(EffectSpec("overflow", {"height": 0.6}, {"side": "fast"}))
    assert [p.side for p in flow_places(decided, EFFECTS["spill"])] == ["after_fast"]
    driven = Model(Base.of(plant(physics=Physics(2.0, None))))  # a mass: it moves, it does not fill
    assert not flow_places(driven, outflow)
    ringing = Plant("p", Zpk([], [0.9 + 0.3j, 0.9 - 0.3j], 0.1, STEP))
    assert not flow_places(Model(Base.of(ringing)), outflow)
    one = Model(Base.of(Plant("p", Zpk([], [0.9], 0.1, STEP))))
    assert [p.side for p in flow_places(one, outflow)] == ["after_slow"]
    assert not flow_places(one, overflow)


@pytest.mark.parametrize(
    ("machine", "offered"),
    [
        (plant(), True),
        (plant(physics=Physics(2.0, None)), False),
        (Plant("stage", Zpk([-1.0], [1.0, 1.0], 1e-3, STEP)), False),
    ],
)
def test_a_bend_is_looked_for_where_the_gain_is_free_alone(machine, offered):
    view = SimpleNamespace(model=Model(Base.of(machine)))
    assert bool(Screen.places(view, EFFECTS["sensor_bend"])) is offered

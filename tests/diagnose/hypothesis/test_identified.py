"""Models that `ffl identify linear` made of the machine with the physics in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from ffl.diagnose import diagnose
from ffl.diagnose.hypothesis.corrections import _of_stated
from ffl.diagnose.hypothesis.linear import WITHOUT_ZERO, corrected, discrete, has_zero
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.proof.counsel import other_model
from ffl.effects import mechanics_of
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec, Physics, Plant
from ffl.systems.zpk import Zpk

STEP, POLES = 1.0, np.exp(-1.0 / np.array([20.0, 60.0]))
GAIN = 0.9 * float(np.prod(1 - POLES)) / 2.0


def oven(seed: int, n: int = 900) -> Recording:
    """Two lags of 20 and 60 s, 0.9 degC per per cent, that get no more than 70 %."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.0, 100.0, n // 30), 30)
    y = scipy.signal.lfilter([0.0, GAIN, GAIN], np.poly(POLES), np.minimum(u, 70.0))
    y = y + 0.02 * rng.standard_normal(n)
    t = STEP * np.arange(n)
    return Recording(t=t, r=0 * u, f=u, u=u, y=y, d=None, sample_time=STEP, source=f"oven {seed}")


def bent(**changes) -> Plant:
    """What least squares makes of it: gain too low, lags off, a zero that is not there."""
    poles = np.exp(-1.0 / np.array([15.0, 70.0]))
    gain = 0.8 * float(np.prod(1 - poles)) / (1 - 1.3)
    return Plant("oven", Zpk([1.3], poles, gain, STEP), None, "%", "degC", **changes)


def test_the_zero_goes_and_the_gain_is_a_correction():
    found = diagnose(bent(), [oven(1)], [oven(2)]).answer()
    assert [e["name"] for e in found["effects"]] == ["saturation"]
    limit = found["effects"][0]["parameters"]["limit"]["value"]
    assert limit == pytest.approx(70.0, rel=0.005)
    corrections = {c["name"]: c["relative"] for c in found["model_corrections"]}
    assert "mass" not in corrections
    assert corrections["gain"] == pytest.approx(0.9 / 0.8 - 1.0, abs=0.02)


def test_a_zero_is_taken_out_with_the_gain_at_rest_as_it_was():
    mechanics = mechanics_of(bent().system)
    assert has_zero(mechanics)
    plain = corrected(mechanics, {WITHOUT_ZERO: 1.0})
    assert not has_zero(plain)
    slow = 1e-9
    before, after = (discrete(m).response([slow])[0] for m in (mechanics, plain))
    assert np.ravel(after)[0] == pytest.approx(np.ravel(before)[0], rel=1e-6)
    only_the_holds = Zpk([-0.98], POLES, GAIN, STEP)
    assert not has_zero(mechanics_of(only_the_holds))


def test_a_load_that_was_as_good_as_none_is_given_as_it_is():
    stated = (EffectSpec("constant_load", {"force": 1e-5}),)
    base = Base.of(replace(bent(), effects=stated))
    model = Model(base, given=(EffectSpec("constant_load", {"force": -0.4}),))
    (load,) = _of_stated(model, 0, "force", 0.01, False)
    assert (load.name, load.unit) == ("constant_load.force", "%")
    assert load.relative == pytest.approx(-0.4, rel=1e-3)
    assert load.std_error == pytest.approx(0.01)
    near = Model(base, given=(EffectSpec("constant_load", {"force": 2e-5}),))
    (load,) = _of_stated(near, 0, "force", 1e-6, False)
    assert (load.relative, load.unit) == (pytest.approx(1.0), "")


def test_advice_does_not_lead_in_a_circle():
    assert "ffl identify linear" in other_model(bent(source="by hand"))
    came = other_model(bent(source="ffl identify linear, output_error, order 2, from a.csv"))
    assert "identify linear" not in came
    assert "[controller]" in came


def test_hysteresis_is_fitted_where_it_takes_energy():
    numbers = {"force": 1.0, "displacement": 0.1, "exponent": 1.0, "beta": 0.6}
    stage = Plant("stage", Zpk([-1.0], [1.0, 1.0], 1e-6, 1e-3), physics=Physics(1.0, None))
    model = Model(Base.of(stage), effects=(EffectSpec("hysteresis", numbers),))
    (beta,) = [c for c in model.coordinates if c.name == "beta"]
    assert beta.lower == pytest.approx(np.log(0.5))

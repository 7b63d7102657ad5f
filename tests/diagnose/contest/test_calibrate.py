"""Every number of an augmented plant refitted: the truth comes back from numbers that are off."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest.calibrate import calibrate
from ffl.errors import InputError
from ffl.machines import SimulatedMachine
from ffl.systems import EffectSpec, Move, Zpk, as_zpk, load_plant, moves


@pytest.fixture(scope="module")
def true():
    effects = (EffectSpec("coulomb_friction", {"level": 20.0}),)
    return replace(load_plant("emps"), effects=effects)


@pytest.fixture(scope="module")
def recording(true):
    r = moves([Move(0.1, 0.05, 0.2, 3.0, 60.0), Move(0.7, -0.05, 0.1, 2.0, 60.0)], 1.5, 1e-3)
    return SimulatedMachine(true).run(r, np.zeros(len(r)), np.random.default_rng(0))


def test_truth_comes_back(true, recording):
    zpk = as_zpk(true.system)
    off = replace(
        true,
        system=Zpk(zpk.zeros, zpk.poles, 1.05 * zpk.gain, zpk.sample_time),
        effects=(EffectSpec("coulomb_friction", {"level": 26.0}),),
    )
    done = calibrate(off, [recording])
    assert done.rms[-1] < 1e-2 * done.rms[0]
    assert done.plant.effects[0].parameters["level"] == pytest.approx(20.0, rel=2e-3)
    assert as_zpk(done.plant.system).gain == pytest.approx(zpk.gain, rel=2e-3)
    assert done.changes["coulomb_friction.level"] == pytest.approx(np.log(20 / 26), abs=2e-3)


def test_a_right_plant_stays(true, recording):
    done = calibrate(true, [recording])
    assert max(abs(v) for v in done.changes.values()) < 1e-3


def test_refusals(true, recording):
    with pytest.raises(InputError, match="no recording given"):
        calibrate(true, [])
    with pytest.raises(InputError, match=r"has no \[controller\]"):
        calibrate(replace(true, controller=None), [recording])
    with pytest.raises(InputError, match="resample"):
        calibrate(true, [replace(recording, sample_time=2e-3, t=2 * recording.t)])

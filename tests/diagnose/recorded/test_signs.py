"""The signs that a sensor of |y| lost, read from the motion behind it."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.recorded.signs import MOST, unfolded
from ffl.machines import Simulator
from ffl.recordings import Recording
from ffl.systems.plant import Plant
from ffl.systems.plant_file import plant_from_dict, plant_to_dict
from ffl.systems.zpk import Zpk

STEP, NOISE = 1e-3, 1e-8


@pytest.fixture
def spring(on_a_spring):  # type: ignore[no-untyped-def]
    return on_a_spring(2.0, 25.0, 0.05, STEP, "N", sensor_noise=NOISE, force_noise=1.0)


def waves(samples, phase=0.0):
    t = STEP * np.arange(samples)
    return sum(np.sin(2 * np.pi * f * t + f + phase) for f in (3.0, 7.0, 11.0, 17.0, 23.0)) / 2.0


def run(plant, u, shaken, seed=4):
    """(the recording, y before its sensor) of the plant under u and force noise."""
    rng = np.random.default_rng(seed)
    force = shaken * rng.standard_normal(len(u))
    y = Simulator(plant).run((), feedforward=u, force=force).y
    y = y + NOISE * rng.standard_normal(len(u))
    t = STEP * np.arange(len(u))
    return Recording(t, np.zeros(len(u)), u, u, np.abs(y), sample_time=STEP), y


@pytest.mark.parametrize(("shaken", "most"), [(0.01, 0.0), (1.0, 0.0), (3.0, 0.01)])
def test_signs_come_back_though_noise_shakes_the_machine(spring, shaken, most):
    """Four times as loud as the command an arc that hardly leaves zero may be mistaken; no path goes on
    from it."""
    recording, y = run(spring, waves(4000), shaken)
    found = unfolded(spring, [recording])
    assert found is not None
    clear = np.abs(y) > 5.0 * NOISE
    assert np.count_nonzero(np.diff(np.sign(y)) != 0) > 50
    wrong = found[0].y[clear] != y[clear]
    assert np.mean(wrong) <= most
    assert np.abs(y[clear][wrong]).max(initial=0.0) < 0.2 * np.abs(y).max()
    assert np.array_equal(np.abs(found[0].y), recording.y)


def test_a_recording_cut_out_in_motion_has_its_signs_from_the_first_sample(spring):
    recording, y = run(spring, waves(4000), 1.0)
    for start in (np.flatnonzero(y[500:] < -0.5 * np.abs(y).max())[0] + 500, 1703):
        found = unfolded(spring, [recording[int(start) :]])
        assert found is not None
        assert np.allclose(found[0].y, y[start:], atol=5.0 * NOISE)


def test_one_recording_may_keep_to_one_side(spring):
    both, _ = run(spring, waves(4000), 0.3)
    aside, y = run(spring, 9.0 + waves(2000), 0.3, 5)
    assert y[200:].min() > 0.0
    found = unfolded(spring, [both, aside])
    assert found is not None
    assert np.array_equal(found[1].y[200:], aside.y[200:])


def test_what_only_touches_zero_is_not_unfolded(spring):
    """Strokes out and back: y comes to zero because it was sent there, and the drive brakes both ways."""
    t = STEP * np.arange(4000)
    y = 1e-4 * (1.0 - np.cos(2 * np.pi * 1.5 * t)) + NOISE * np.random.default_rng(2).random(4000)
    u = 2.0 * 157.0**2 * 1e-4 * (1.0 - np.cos(2 * np.pi * 1.5 * t)) - 0.5
    assert unfolded(spring, [Recording(t, 0 * t, u, u, y, sample_time=STEP)]) is None


def test_signs_are_read_of_low_orders_in_open_loop_alone(spring):
    recording, y = run(spring, waves(2000), 0.3)
    assert unfolded(spring, [replace(recording, y=y)]) is None  # not folded
    poles = [0.9 + 0.01 * k for k in range(MOST + 1)]
    slow = Plant("slow", Zpk([], poles, 1e-9, STEP), input_unit="N", output_unit="m")
    assert unfolded(slow, [recording]) is None
    closed = replace(spring, controller=Zpk([], [0.5], 1.0, STEP))
    assert unfolded(closed, [recording]) is None


def test_a_kick_that_no_sign_explains_leaves_them_unread(spring):
    recording, _ = run(spring, waves(4000), 0.1)
    y = recording.y.copy()
    y[2000] += 0.5 * y.max()
    assert unfolded(spring, [replace(recording, y=y)]) is None


def test_a_sensor_blind_to_the_sign_is_all_that_is_named_in_noise(spring):
    fit, _ = run(spring, waves(6000), 1.0)
    judge, _ = run(spring, waves(6000, 1.0), 1.0, 5)
    found = diagnose(spring, [fit], [judge])
    assert [f.name for f in found.findings] == ["sensor_nonlinearity"]
    assert found.verdict == "explained"
    assert found.proof is not None
    (overlay,) = found.proof.overlays
    assert np.array_equal(overlay.y, judge.y)  # as it was recorded
    assert overlay.y_after.min() >= 0.0 > overlay.y_before.min()
    assert found.proof.nrmse_after < 1.2 * found.proof.noise_floor < found.proof.nrmse_before
    plant = plant_from_dict(plant_to_dict(found.augmented))
    (effect,) = plant.effects
    assert effect.parameters["kind"] == "rectified"
    rerun = Simulator(plant).run(plant.effects, feedforward=judge.u).y
    left = [np.std(a - judge.y) for a in (rerun, overlay.y_after)]
    assert left[0] == pytest.approx(left[1], rel=0.01)

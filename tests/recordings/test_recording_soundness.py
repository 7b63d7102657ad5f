"""Soundness: every fault is told, and a healthy machine raises none."""

from dataclasses import replace

import numpy as np
import pytest
from recording_loops import loop, move

from ffl.errors import InputError
from ffl.recordings import Recording, check_recording, resample_recording, soundness
from ffl.recordings.sensor_findings import quantisation_step


def kinds(x, **options):
    return {f.kind for f in soundness(x, **options).findings if f.severity != "note"}


SOUND = {
    "plain": {},
    "coarse encoder": {"step": 2e-4, "noise": 0.0},
    "coarse encoder with noise": {"step": 1e-4, "noise": 3e-5},
    "no noise, no encoder": {"step": 0.0, "noise": 0.0},
    "noise, no encoder": {"step": 0.0},
    "sticking, fine": {"step": 1e-7, "noise": 0.0, "friction": 8.0},
    "sticking, exact": {"step": 0.0, "noise": 0.0, "friction": 8.0},
    "sticking, coarse": {"step": 1e-4, "noise": 0.0, "friction": 20.0, "feedforward": False},
    "sticking, slow sine": {
        "step": 1e-6,
        "noise": 0.0,
        "friction": 12.0,
        "feedforward": False,
        "reference": 0.01 * np.sin(2 * np.pi * np.arange(4000) / 2000),
    },
    "sine": {"reference": 0.05 * np.sin(2 * np.pi * np.arange(4000) / 400)},
}


@pytest.mark.parametrize("name", SOUND)
def test_a_healthy_machine_raises_no_alarm(rng, name):
    x = loop(rng, **SOUND[name])
    assert kinds(x, sample_time=1e-3) == set()
    assert kinds(x[700:]) == set()
    assert kinds(replace(x, y=-x.y, r=-x.r, u=-x.u, f=-x.f)) == set()


@pytest.mark.parametrize("name", ["plain", "coarse encoder", "sticking, fine", "sine"])
@pytest.mark.parametrize("start", [900, 1100, 2700])
def test_frozen_sensor(rng, name, start):
    x = loop(rng, **SOUND[name])
    y = x.y.copy()
    y[start : start + 400] = y[start]
    found = soundness(replace(x, y=y)).of("frozen")
    assert len(found) == 1
    assert found[0].severity == "fault"
    (a, b), *_ = found[0].time_s
    assert a == pytest.approx(x.t[start], abs=0.02)
    assert b == pytest.approx(x.t[start + 399], abs=0.02)


def test_a_sensor_that_loses_its_noise_is_frozen(rng):
    """Slow motion under noise: neither the stop nor the start shows, but the stillness does."""
    slow = 1e-3 * np.sin(2 * np.pi * np.arange(4000) / 4000)
    x = loop(rng, noise=3e-5, reference=slow)
    assert kinds(x) == set()
    y = x.y.copy()
    y[1900:1980] = y[1900]
    (found,) = soundness(replace(x, y=y)).of("frozen")
    assert found.time_s == ((pytest.approx(1.9), pytest.approx(1.979)),)


@pytest.mark.parametrize("name", ["plain", "coarse encoder", "no noise, no encoder", "sine"])
@pytest.mark.parametrize("side", [1, -1])
def test_clipped_sensor(rng, name, side):
    x = loop(rng, **SOUND[name])
    level = 0.8 * np.max(side * x.y) + 0.2 * np.min(side * x.y)
    y = side * np.minimum(side * x.y, level)
    (found,) = soundness(replace(x, y=y)).of("clipped")
    assert found.value == pytest.approx(np.mean(side * x.y >= level), abs=0.02)
    assert "frozen" not in kinds(replace(x, y=y))


def test_saturated_command(rng):
    free = loop(rng)
    x = loop(rng, limit=0.6 * np.abs(free.u).max())
    (found,) = soundness(x).of("saturated")
    assert found.value == pytest.approx(np.mean(np.abs(x.u) == np.abs(x.u).max()), abs=0.05)
    assert found.severity == "warning"
    hard = loop(rng, limit=0.4 * np.abs(free.u).max())
    assert [f.severity for f in soundness(hard).of("saturated")] == ["fault"]


@pytest.mark.parametrize("wave", ["prbs", "trapezoid", "steps"])
def test_an_open_loop_command_may_have_plateaus(rng, wave):
    n = 3000
    u = {
        "prbs": np.repeat(rng.choice([-1.0, 1.0], n // 20), 20),
        "trapezoid": np.clip(3 * np.sin(2 * np.pi * np.arange(n) / 600), -1, 1),
        "steps": np.repeat(rng.uniform(-1, 1, n // 100), 100),
    }[wave]
    y = np.convolve(u, 0.05 * 0.95 ** np.arange(200))[:n] + 1e-3 * rng.standard_normal(n)
    assert kinds(Recording.from_signals(0.01, y=y, u=u)) == set()


@pytest.mark.parametrize("factor", [1e3, 1e-3, -1.0])
def test_unit_and_sign(rng, factor):
    x = loop(rng, reference=move(4000))
    kind = "sign" if factor < 0 else "unit"
    assert kinds(replace(x, y=x.y * factor)) == {kind}
    (found,) = soundness(replace(x, y=x.y * factor)).of(kind)
    assert found.value == pytest.approx(factor, rel=0.05)
    u = np.sin(np.arange(500.0))
    other = Recording.from_signals(0.01, y=np.cumsum(u), u=u, f=factor * u)
    assert kinds(other) == {kind}


def test_feedforward_that_is_not_in_the_command(rng):
    pulses = np.repeat(rng.choice([0.0, 5.0], 40), 100)
    r = move(4000)
    x = loop(rng, step=0.0, noise=0.0, reference=r, feedforward=False)
    y = x.y + 1e-5 * np.convolve(pulses, 0.98 ** np.arange(300))[:4000]
    feedback = 1800.0 * (r - y) - 60e3 * np.diff(y, prepend=y[0])
    good = replace(x, y=y, u=feedback + pulses, f=pulses)
    assert kinds(good) == set()
    assert kinds(replace(good, f=-pulses)) == {"sign"}
    assert kinds(replace(good, f=1e3 * pulses)) == {"unit"}


def test_time_and_length(recording):
    gap = np.r_[0:1000, 1200:4000]
    names = ("t", "r", "f", "u", "y")
    holed = replace(recording, **{n: getattr(recording, n)[gap] for n in names})
    (found,) = soundness(holed).of("gap")
    assert "200 samples missing" in found.text
    assert found.time_s == ((pytest.approx(0.999), pytest.approx(1.2)),)
    with pytest.raises(InputError, match=r"sample 1000, column t: 200 samples missing"):
        check_recording(holed)
    assert kinds(recording, sample_time=2e-3) == {"sample_time"}
    assert kinds(recording[:50]) == {"short"}
    back = replace(recording, t=np.r_[recording.t[:2000], recording.t[:2000]])
    assert "backwards" in kinds(back)
    holed = replace(recording, y=np.where(np.arange(4000) == 7, np.nan, recording.y))
    assert kinds(holed) == {"not_finite"}
    with pytest.raises(InputError, match="sample 7, column y: nan"):
        check_recording(holed)


@pytest.mark.parametrize(("name", "length"), [("plain", 40), ("coarse encoder", 90), ("sine", 300)])
def test_a_block_written_twice(rng, name, length):
    """In a file without time; a period that comes again is none."""
    x = loop(rng, **SOUND[name])
    at = np.concatenate([np.arange(1500), np.arange(1500 - length, len(x))])
    columns = {k: getattr(x, k)[at] for k in ("y", "u", "r", "f")}
    twice = Recording.from_signals(x.sample_time, **columns)
    (found,) = (f for f in soundness(twice).findings if f.kind == "repeated_block")
    assert found.severity == "fault"
    assert found.value == length
    assert found.time_s[0][0] == pytest.approx(1500 * x.sample_time, abs=2 * x.sample_time)
    assert f"{length} samples" in found.text


def test_a_block_written_twice_beside_a_command_of_two_values(rng):
    at = np.concatenate([np.arange(740), np.arange(700, 1500)])
    u, y = np.where(np.arange(1500) % 300 < 150, 20.0, 70.0), rng.normal(size=1500)
    (found,) = (
        f
        for f in soundness(Recording.from_signals(0.02, u=u[at], y=y[at])).findings
        if f.kind == "repeated_block"
    )
    assert (found.value, found.time_s[0][0]) == (40, pytest.approx(740 * 0.02))


def test_what_goes_on_repeating_itself_is_no_block_written_twice(rng):
    y = np.tile(np.round(rng.normal(size=200), 2), 12)
    u = np.tile(rng.normal(size=200), 12)
    for columns in ({"y": y, "u": u}, {"y": y[:650], "u": u[:650]}, {"y": 0.0 * y, "u": u}):
        found = soundness(Recording.from_signals(1e-3, **columns)).findings
        assert "repeated_block" not in {f.kind for f in found}


def test_constant_columns(recording):
    still = replace(recording, y=np.full(4000, 2.0))
    assert "constant" in kinds(still)
    assert not soundness(still).sound
    idle = replace(recording, u=np.zeros(4000), f=np.zeros(4000))
    assert {(f.where, f.severity) for f in soundness(idle).of("constant")} == {("u", "warning")}


@pytest.mark.parametrize("step", [1e-6, 5e-8, 0.004884, 1.0, 2 * np.pi / 4096])
def test_encoder_step(rng, step):
    fine = np.cumsum(rng.standard_normal(3000)) * 7 * step
    assert quantisation_step(step * np.round(fine / step)) == pytest.approx(step, rel=1e-6)
    assert quantisation_step(0.3 + step * np.round(fine / step)) == pytest.approx(step, rel=1e-6)
    assert quantisation_step(fine) is None


def test_findings_come_gravest_first(recording):
    y = recording.y.copy()
    y[1000:1400] = y[1000]
    found = soundness(replace(recording, y=y)[:3000]).findings
    assert [f.severity for f in found] == sorted(
        (f.severity for f in found), key=["fault", "warning", "note"].index
    )
    assert found[0].kind == "frozen"


@pytest.mark.parametrize("new", [0.5e-3, 2e-3, 0.75e-3, 1.6e-3])
def test_resampling_keeps_time_and_sines_below_the_cut(new):
    t = 1e-3 * np.arange(4000) + 5.0
    wave = np.sin(2 * np.pi * 31.0 * t)
    x = Recording.from_signals(1e-3, t=t, y=wave, u=2 * wave, r=np.ones(4000), d=t)
    z = resample_recording(x, new)
    assert z.sample_time == new
    assert z.t[0] == 5.0
    assert abs(z.t[-1] - t[-1]) < 2 * max(new, 1e-3)
    inner = slice(200, -200)
    assert np.allclose(z.y[inner], np.sin(2 * np.pi * 31.0 * z.t[inner]), atol=3e-4)
    assert np.allclose(z.u, 2 * z.y, atol=1e-12)
    assert np.allclose(z.d, z.t, atol=1e-3)
    assert set(z.r) == {1.0}
    assert any("resampled from 0.001 s" in note for note in z.notes)


@pytest.mark.parametrize("frequency", [135.0, 430.0])
def test_resampling_removes_what_the_new_rate_cannot_carry(frequency):
    t = 1e-3 * np.arange(8000)
    high = np.sin(2 * np.pi * frequency * t)
    z = resample_recording(Recording.from_signals(1e-3, y=high, u=high), 4e-3)
    assert np.abs(z.y[50:-50]).max() < 2e-4
    assert np.abs(high[::4]).max() > 0.9, "plain decimation would have kept it"


def test_resampling_limits(recording):
    assert resample_recording(recording, 1.0005e-3) is recording
    with pytest.raises(InputError, match="no ratio of whole numbers"):
        resample_recording(recording, 1e-3 * np.sqrt(2))
    with pytest.raises(InputError, match="positive"):
        resample_recording(recording, -1.0)
    short = recording[:12]
    assert len(resample_recording(short, 0.5e-3)) == 23

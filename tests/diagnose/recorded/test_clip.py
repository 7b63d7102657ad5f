"""A sensor at its limit: known by how it is reached and left, and what it lost judges nobody."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.recorded.clip import clipping, shown
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine, Simulator
from ffl.systems import Physics, Plant, Zpk
from ffl.systems.plant import EffectSpec, Imperfections

STEP, LEVEL = 0.002, 0.8e-3


@pytest.fixture(scope="module")
def table() -> Plant:
    """A stage on springs, 8 Hz, 1 mm to 10 N, whose noise is far below that of the force on it."""
    w, zeta = 2 * np.pi * 8.0, 0.05
    pole = np.exp((-zeta + 1j * np.sqrt(1 - zeta**2)) * w * STEP)
    shape = Zpk([-0.98], [pole, np.conj(pole)], 1.0, STEP)
    gain = 1e-4 / float(np.real(shape.response([1e-6])[0]))
    system = replace(shape, gain=gain)
    mass = 1e4 / w**2
    return Plant(
        "table", system, None, "N", "m", "made here", Physics(mass, 1.0),
        Imperfections(1e-9, 2e-8, 0.1, None),
    )  # fmt: skip


def _force(seed: int, samples: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(samples)
    lines = [(f, rng.uniform(0, 2 * np.pi)) for f in (0.4, 1.1, 2.3, 3.7, 5.2)]
    shape = sum(np.sin(2 * np.pi * f * t + phase) for f, phase in lines)
    return 2.6 * shape * np.minimum(t / 0.5, 1.0)


def _recorded(plant: Plant, *effects: EffectSpec):  # type: ignore[no-untyped-def]
    machine = SimulatedMachine(replace(plant, effects=effects))
    zero = np.zeros(2500)
    return [machine.run(zero, _force(s, 2500), np.random.default_rng(s)) for s in (1, 2, 3)]


CLIPS = EffectSpec("sensor_nonlinearity", {"kind": "clipping", "level": LEVEL})


def test_one_stay_that_is_left_at_speed_is_a_limit_of_the_sensor(table):  # type: ignore[no-untyped-def]
    t = STEP * np.arange(2500)
    force = _force(1, 2500) / 3.0 + 12.0 * np.exp(-(((t - 2.5) / 0.15) ** 2))
    clear = SimulatedMachine(table).run(np.zeros(2500), force, np.random.default_rng(1))
    level = 0.9 * float(np.abs(clear.y).max())
    clipped = replace(clear, y=np.clip(clear.y, -level, level))
    beyond = np.flatnonzero(np.abs(clear.y) > level)
    assert len(beyond) >= 20
    assert np.all(np.diff(beyond) == 1)  # once
    noise = 2e-8 * np.random.default_rng(1).standard_normal(len(clear))
    found = clipping(table, [replace(clipped, y=clipped.y + noise)])
    assert found is not None
    assert found.parameters["level"] == pytest.approx(level, rel=1e-3)
    # A machine that is stopped there begins anew from rest: nothing of its sensor.
    y = clipped.y.copy()
    end, ahead = beyond[-1] + 1, np.arange(40)
    y[end : end + 40] = y[end - 1] + (y[end + 40] - y[end - 1]) * (ahead / 40.0) ** 2
    assert clipping(table, [replace(clear, y=y + noise)]) is None
    # One that friction brings to rest there comes at speed as well, and slower with every sample.
    y, first = clipped.y.copy(), beyond[0]
    side, usual = np.sign(y[first]), np.sqrt(np.mean(np.diff(clipped.y) ** 2))
    y[first - 20 : first] -= side * (np.abs(y[first - 20 : first]) - level)
    y[first - 20 : first] -= side * 0.25 * usual * np.arange(20, 0, -1) ** 2
    assert clipping(table, [replace(clear, y=y + noise)]) is None


@pytest.mark.parametrize(("drift", "clips"), [(0.0, True), (6.0, False)])
def test_what_rests_within_the_noise_of_a_sensor_scatters_by_it(table, drift, clips):  # type: ignore[no-untyped-def]
    """A flow that is highest twice, behind a valve that sticks there, goes on by its own way: of 1.9 times
    the noise, and "the sensor clips" with 0.97. `drift`: standard deviations from end to end of a stay."""
    quiet = replace(table, machine=Imperfections(1e-9, 2e-6, 0.1, None))
    t = STEP * np.arange(2500)
    bumps = sum(12.0 * np.exp(-(((t - at) / 0.15) ** 2)) for at in (1.5, 3.5))
    clear = SimulatedMachine(table).run(np.zeros(2500), bumps, np.random.default_rng(1))
    level = 0.9 * float(np.abs(clear.y).max())
    y = np.clip(clear.y, -level, level)
    at = np.flatnonzero(np.abs(y) == level)
    for stay in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1):
        y[stay] += 2e-6 * np.linspace(-0.5, 0.5, len(stay)) * drift * np.sign(y[stay])
    y += 2e-6 * np.random.default_rng(2).standard_normal(len(y))
    assert (clipping(quiet, [replace(clear, y=y)]) is not None) is clips


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_limit_at_one_end_is_told_where_the_machine_goes_farther_the_other_way(table, way):  # type: ignore[no-untyped-def]
    clear = [way * r.y for r in _recorded(table)]
    runs = _recorded(table)
    end = 0.6 * max(float(y.max()) for y in clear)
    assert min(float(y.min()) for y in clear) < -1.2 * end
    limited = [replace(r, y=way * np.minimum(y, end)) for r, y in zip(runs, clear, strict=True)]
    found = clipping(table, limited)
    assert found is not None
    kind = "clipping_above" if way > 0.0 else "clipping_below"
    assert found.parameters == {"kind": kind, "level": pytest.approx(way * end)}
    trials = shown([prepare(Simulator(table), r, 1e-9) for r in limited], found, table)
    for trial, y in zip(trials, clear, strict=True):
        assert trial.lost is not None
        np.testing.assert_array_equal(trial.lost, y >= end - 9e-8)  # eight of the noise, one step
    assert clipping(table, runs) is None
    # A machine that friction brings to rest at its farthest comes slower and slower.
    t = STEP * np.arange(2500)
    before = np.minimum(np.sin(2 * np.pi * t), 0.0)
    assert clipping(table, [replace(runs[0], y=-1e-3 * way * before**2)]) is None


def test_what_a_clipping_sensor_lost_needs_no_explanation(table):  # type: ignore[no-untyped-def]
    """How force noise moves the machine on behind the limit is no model's business; a gain and a mass were
    found besides before, to explain what it seemed to do there."""
    *fit, held = _recorded(table, CLIPS)
    found = diagnose(table, fit, [held])
    assert found.verdict == "explained"
    assert [f.name for f in found.findings] == ["sensor_nonlinearity"]
    assert found.findings[0].parameters["level"].value == pytest.approx(LEVEL, rel=1e-3)
    assert found.proof is not None
    assert found.proof.nrmse_after < 1.2 * found.proof.noise_floor
    white = found.judged.fit.white  # type: ignore[union-attr]
    share = np.mean(np.abs(np.concatenate([r.y for r in fit])) >= LEVEL - 1e-6)
    assert np.mean(white == 0.0) == pytest.approx(share, abs=0.01)
    assert share > 0.05
    assert float(np.mean(white[white != 0.0] ** 2)) == pytest.approx(1.0, abs=0.1)

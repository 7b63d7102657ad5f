"""What else was recorded: which columns are asked, and what they are told to do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.maps.columns import terms_by
from ffl.diagnose.maps.freeform import free_form
from ffl.diagnose.maps.grids import ranges_of
from ffl.diagnose.maps.terms import variable
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.others import with_others
from ffl.diagnose.recorded.trials import prepare
from ffl.effects import Motion
from ffl.recordings import Recording, read_recording

STEP, MASS, FREQUENCY, DAMPING = 1e-3, 2.0, 25.0, 0.2
W = 2 * np.pi * FREQUENCY
SENSOR = 3e-7  # m: noise
N = 3000
COUPLED, WARMED = 0.1, 60.0  # N s^2 per unit of the other axis; N s/m per unit of warmth


@pytest.fixture(scope="module")
def spring(on_a_spring):  # type: ignore[no-untyped-def]
    return on_a_spring(MASS, FREQUENCY, DAMPING, STEP, "N")


def moved(seed, added=lambda v, k: 0.0):  # type: ignore[no-untyped-def]
    """u, y, v of a stage on a spring under noise of some Hz and a force `added`, in steps of 20 us."""
    rng = np.random.default_rng(seed)
    u = 20.0 * np.convolve(rng.standard_normal(N), np.hanning(41), "same") / 5.0
    x = v = 0.0
    y, speed = np.empty(N), np.empty(N)
    for k in range(N):
        y[k], speed[k] = x, v
        for _ in range(50):
            at, before = x + 1e-5 * v, v
            v += 2e-5 * ((u[k] + added(v, k)) / MASS - 2 * DAMPING * W * v - W**2 * at)
            x += 1e-5 * (before + v)
    return u, y + SENSOR * rng.standard_normal(N), speed


def recorded(seed, others, added=lambda v, k: 0.0):  # type: ignore[no-untyped-def]
    u, y, speed = moved(seed, added)
    made = {"speed": speed + 0.001 * np.random.default_rng(seed).standard_normal(N)}
    made |= {"current": 0.4 * u, "count": np.arange(float(N)), "mode": np.ones(N)}
    return Recording(
        STEP * np.arange(N), np.zeros(N), u, u, y, sample_time=STEP, source=f"run {seed}",
        others={**made, **others},
    )  # fmt: skip


def other_axis(seed):  # type: ignore[no-untyped-def]
    """An angle that turns to and fro by itself, and its acceleration."""
    t = STEP * np.arange(N)
    w = 2 * np.pi * (1.3 + 0.7 * seed)
    return np.sin(w * t), -(w**2) * np.sin(w * t)


def told(plant, runs):  # type: ignore[no-untyped-def]
    runs, names = with_others(runs)
    base = Base.of(plant, float(np.ptp(runs[0].y)), 3.0)
    trials = [prepare(base.simulator, r, SENSOR) for r in runs]
    noise = Noise(SENSOR, 1e-2)
    scene, held = (Scene(plant.loop, tuple(some), noise) for some in (trials[:2], trials[2:]))
    maps = free_form(scene, held, Model(base))
    left = [np.std(held.residuals(one.free)[0]) for one in (maps[0], maps[-1])]
    return names, maps[-1], left[1] / left[0]


def test_another_axis_whose_angle_was_recorded_is_told_by_its_acceleration(spring):  # type: ignore[no-untyped-def]
    runs = []
    for seed in range(3):
        angle, swing = other_axis(seed)
        runs.append(recorded(seed, {"q2": angle}, lambda v, k, swing=swing: -COUPLED * swing[k]))
    names, found, left = told(spring, runs)
    assert names == ("q2",)
    assert [part.term.name for part in found.parts] == ["force by acceleration of q2"]
    assert found.variables == ("column q2",)
    assert found.parts[0].coefficients[0] == pytest.approx(-COUPLED, rel=0.05)
    assert left < 0.1


def test_a_grease_that_warms_is_told_by_the_temperature_that_was_recorded(spring):  # type: ignore[no-untyped-def]
    runs = []
    for seed in range(3):
        warmth = 1.0 + seed + 2.0 * (1.0 - np.exp(-np.arange(N) / 1000.0))
        damped = lambda v, k, w=warmth: -WARMED * (w[k] - 2.5) * v  # noqa: E731
        runs.append(recorded(seed, {"T": warmth}, damped))
    names, found, left = told(spring, runs)
    assert names == ("T",)
    assert [part.term.name for part in found.parts] == ["velocity by T"]
    assert set(found.variables) == {"velocity", "column T"}
    assert left < 0.1


def test_an_experiment_that_nobody_has_run_has_the_column_in_its_middle():
    still = Motion.still(0.1, STEP)
    ranges = {"T": (1.0, 5.0), "step": (STEP, 3.0)}
    by_warmth = terms_by("T")[0]
    values = np.linspace(0.0, 8.0, 9)
    assert np.allclose(by_warmth.signal(still, ranges, values), 4.0)
    assert np.allclose(by_warmth.columns(still, ranges) @ values, 4.0)


def test_a_column_that_drives_nothing_is_not_told(spring):  # type: ignore[no-untyped-def]
    runs = [recorded(seed, {"q2": other_axis(seed)[0]}) for seed in range(3)]
    names, found, left = told(spring, runs)
    assert names == ("q2",)
    assert not found.parts
    assert left == 1.0


def test_columns_that_are_not_in_every_recording_are_not_asked():
    angle = other_axis(0)[0]
    runs = [recorded(0, {"q2": angle}), recorded(1, {})]
    assert with_others(runs)[1] == ()
    assert with_others(runs[:1])[1] == ("q2",)
    assert set(with_others(runs[:1])[0][0].others) == {
        "q2", "rate of q2", "acceleration of q2",
    }  # fmt: skip


def test_a_column_is_not_taken_for_a_signal_of_the_machine():
    """Another axis may be called x: maps of the position do not read it."""
    runs, names = with_others([recorded(0, {"x": other_axis(0)[0]})])
    assert names == ("x column",)
    motion = replace(Motion.still(0.1, STEP), others={k: v[:2] for k, v in runs[0].others.items()})
    own = ranges_of([motion])
    assert own["x"] == (0.1, 0.1)
    assert np.all(variable(motion, "x") == 0.1)


def test_a_switch_has_no_rate():
    grip = (np.arange(N) > 1900).astype(float)
    runs, names = with_others([recorded(0, {"grip": grip})])
    assert names == ("grip",)
    assert set(runs[0].others) == {"grip"}


def test_they_are_cut_with_the_recording_and_go_where_its_samples_do():
    run = recorded(0, {"q2": other_axis(0)[0]})
    assert len(run[100:300].others["q2"]) == 200
    half = slice(None, None, 2)
    parts = {name: getattr(run, name)[half] for name in ("t", "r", "f", "u", "y")}
    assert not replace(run, **parts, sample_time=2 * STEP).others


def test_a_file_s_other_columns_are_read_whether_it_is_mapped_or_not(tmp_path):
    rows = "\n".join(f"{0.01 * k},{k % 3},{k},{20 + k},on" for k in range(50))
    (tmp_path / "run.csv").write_text("t,u,y,temp [degC],state\n" + rows)
    assert list(read_recording(tmp_path / "run.csv").others) == ["temp"]
    (tmp_path / "own.toml").write_text('[columns]\nt = "t"\nu = "u"\ny = "y"\n')
    mapped = read_recording(tmp_path / "run.csv", tmp_path / "own.toml")
    assert np.array_equal(mapped.others["temp"], 20.0 + np.arange(50))

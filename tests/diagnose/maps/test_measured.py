"""A stage that no free run follows: the map is seen along the motion as it was measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose, diagnosis
from ffl.diagnose.contest import work
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.maps import unnamed
from ffl.diagnose.maps.freeform import bare
from ffl.diagnose.maps.measured import measured
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec

STEP, MASS, FREQUENCY, DAMPING, N = 2.5e-4, 2.0, 30.0, 0.03, 6000
SUBSTEPS = 10
W = 2 * np.pi * FREQUENCY
SENSOR, FORCE = 4e-9, 0.02  # m, N: noise
PEAK, SPEED = 2.0, 2e-3  # N, m/s: most drag of the brake, and where it is


def brake(v):  # type: ignore[no-untyped-def]
    return -2 * PEAK * (v / SPEED) / (1 + (v / SPEED) ** 2)


def run(seed, drag, size=8.0):  # type: ignore[no-untyped-def]
    """The stage under steps that are shaped, with noise of the force held over each sample."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(N)
    u = size * np.tanh(10 * np.sin(2 * np.pi * (2.0 + 0.7 * (seed % 10)) * t)) * (t > 0.05)
    pushed, x, v, y = u + FORCE * rng.standard_normal(N), 0.0, 0.0, np.empty(N)
    h = STEP / SUBSTEPS

    def slope(x, v, f):  # type: ignore[no-untyped-def]
        return (f + drag(v)) / MASS - 2 * DAMPING * W * v - W**2 * x

    for k, f in enumerate(pushed):
        y[k] = x
        for _ in range(
            SUBSTEPS
        ):  # the midpoint rule, in steps far shorter than the brake's own time
            x, v = (
                x + h * (v + 0.5 * h * slope(x, v, f)),
                v + h * slope(x + 0.5 * h * v, v + 0.5 * h * slope(x, v, f), f),
            )
    seen = y + SENSOR * rng.standard_normal(N)
    return Recording(t, np.zeros(N), u, u, seen, sample_time=STEP, source=f"run {seed}")


@pytest.fixture(scope="module")
def spring(on_a_spring):  # type: ignore[no-untyped-def]
    """2 kg on a spring of 30 Hz."""
    return on_a_spring(MASS, FREQUENCY, DAMPING, STEP, "N", sensor_noise=SENSOR, force_noise=FORCE)


def scenes(spring, runs):  # type: ignore[no-untyped-def]
    base = Base.of(spring, float(np.ptp(runs[0].y)), N * STEP)
    trials = [prepare(base.simulator, r, SENSOR) for r in runs]
    scene, held = (Scene(spring.loop, (trial,), Noise(SENSOR, FORCE)) for trial in trials)
    return scene, held, Model(base)


def test_a_brake_that_lets_go_is_seen_along_the_motion(spring):  # type: ignore[no-untyped-def]
    scene, held, model = scenes(spring, [run(1, brake), run(2, brake)])
    found = measured(scene, held, fit(scene, model))
    assert found is not None
    assert found.variables == ("velocity",)
    part = found.parts[0]
    at = np.array([-2.0, -1.0, 1.0, 2.0]) * SPEED
    drawn = np.interp(at, part.term.knots(part.ranges), part.coefficients)
    np.testing.assert_allclose(drawn, brake(at), rtol=0.1)


@pytest.mark.slow(10)
@pytest.mark.usefixtures("no_play_sought")
def test_the_answer_says_that_free_runs_part(spring, monkeypatch):  # type: ignore[no-untyped-def]
    runs = [run(1, brake), run(2, brake)]
    scene, held, model = scenes(spring, runs)
    led = measured(scene, held, fit(scene, model))
    alone = lambda scene, held, model, **_: [bare(scene, held, model)]  # noqa: E731
    monkeypatch.setattr(unnamed, "free_form", alone)  # no map is followed,
    monkeypatch.setattr(diagnosis, "THRESHOLD", np.inf)  # no name earns its place,
    monkeypatch.setattr(work, "MOST", 0)  # nor is one looked for, in free runs
    untouched = lambda scene, held, outcome, *_: outcome  # noqa: E731
    monkeypatch.setattr(diagnosis, "with_dry_friction", untouched)  # or by prediction,
    monkeypatch.setattr(unnamed, "measured", lambda *_: led)  # and this is what is seen
    monkeypatch.setattr(diagnosis, "parts", lambda found: False)  # without an observer
    found = diagnose(spring, runs[:1], runs[1:])
    assert found.verdict == "unnamed"
    assert found.place.depends_on == ("velocity",)
    assert "as measured" in found.place.where


def test_recordings_that_judge_may_refuse(spring):  # type: ignore[no-untyped-def]
    scene, held, model = scenes(spring, [run(1, brake), run(2, lambda v: 3.0 * np.sign(v))])
    assert measured(scene, held, fit(scene, model)) is None


def test_noise_alone_draws_no_map(spring):  # type: ignore[no-untyped-def]
    """The stage shaken by somebody: a force that leads there exists, and is no function of the motion."""
    rng = np.random.default_rng(7)
    runs = []
    for seed in (1, 2):
        shaken = 0.5 * np.convolve(rng.standard_normal(N + 30), np.ones(31), "valid")
        runs.append(run(seed, lambda v: 0.0))
        loop = spring.loop.process_sensitivity
        runs[-1] = Recording(
            runs[-1].t, runs[-1].r, runs[-1].f, runs[-1].u, runs[-1].y + loop.filter(shaken),
            sample_time=STEP, source=f"shaken {seed}",
        )  # fmt: skip
    scene, held, model = scenes(spring, runs)
    fitted = fit(scene, model)
    assert fitted.cost > 4.0 * scene.samples
    assert measured(scene, held, fitted) is None


def test_where_free_runs_come_near_nothing_is_to_be_seen(spring):  # type: ignore[no-untyped-def]
    scene, held, model = scenes(spring, [run(1, lambda v: 0.0), run(2, lambda v: 0.0)])
    assert measured(scene, held, fit(scene, model)) is None


@pytest.mark.parametrize("named", [True, False])
def test_numbers_that_stand_for_what_is_missing_are_not_asked(spring, monkeypatch, named):  # type: ignore[no-untyped-def]
    """A linear model that is far off bends until its runs look like the machine's: beside the nominal one
    the motion tells more."""
    scene, held, model = scenes(spring, [run(1, brake), run(2, brake)])
    bent = replace(model, corrections={"damping": 1.0})
    if named:
        bent = bent.with_effect(EffectSpec("coulomb_friction", {"level": 0.1}))
    asked = []
    monkeypatch.setattr(unnamed, "measured", lambda scene, held, found: asked.append(found.model))
    unnamed._led(scene, held, model, bent, scene.residuals(bent))
    assert asked == [bent if named else model]

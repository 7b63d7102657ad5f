"""A scale that is bent, where recordings begin in motion: the plant began where its sensor showed what it
did, and a map of the scale has no kinks."""

from __future__ import annotations

import numpy as np
import pytest

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.maps import unnamed
from ffl.diagnose.maps.freeform import free_form
from ffl.diagnose.maps.freemodel import (
    FreeModel,
    FreeScreen,
    Part,
    Running,
    motions_of,
    tables_of,
)
from ffl.diagnose.maps.gains import in_own_noise
from ffl.diagnose.maps.grids import ranges_of
from ffl.diagnose.maps.mapped import smoothed
from ffl.diagnose.maps.terms import TERMS
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.starts import with_starts
from ffl.diagnose.recorded.trials import prepare
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec

BEND = 0.15  # 1/m
CUT = 330  # samples: in the middle of the first move
PLACE = Place("output")
SCALE = next(t for t in TERMS if t.name == "position at the sensor")


def seen(plant, reference, seed):  # type: ignore[no-untyped-def]
    """The stage about 0.04 m, seen by a scale that shows x + BEND x^2, by repetition."""
    rng = np.random.default_rng(seed)
    n, simulator, noise = len(reference), Simulator(plant), plant.machine
    reference = 0.04 + np.asarray(reference)
    shaken = noise.force_noise * rng.standard_normal(n)
    heard, shown = noise.sensor_noise * rng.standard_normal(n), BEND * reference**2
    start = simulator.at_rest((np.sqrt(1.0 + 4.0 * BEND * reference[0]) - 1.0) / (2.0 * BEND))
    for _ in range(40):
        run = simulator.run((), reference, force=shaken, noise=heard + shown, start=start)
        shown = BEND * run.x**2
    return Recording(
        run.t, reference, np.zeros(n), run.u, run.y, sample_time=plant.sample_time,
        source=f"run_{seed}.csv",
    )  # fmt: skip


@pytest.fixture(scope="module")
def cut(stage, references):  # type: ignore[no-untyped-def]
    """Scenes of recordings that begin in motion, and the model."""
    base = Base.of(stage)
    noise = Noise(stage.machine.sensor_noise, stage.machine.force_noise)
    grounds = [
        Scene(
            stage.loop,
            (prepare(base.simulator, seen(stage, r, k)[CUT:], stage.machine.sensor_noise),),
            noise,
        )
        for k, r in enumerate(references)
    ]
    assert not any(t.at_rest for ground in grounds for t in ground.trials)
    return *grounds, Model(base)


def drawn(free, scene, curve):  # type: ignore[no-untyped-def]
    """A map at the sensor with the values curve(x) over the range of the recordings."""
    motions = motions_of(free, scene, [PLACE])
    ranges = ranges_of([m[PLACE] for m in motions])
    return Part(SCALE, PLACE, curve(SCALE.grid(ranges)), ranges), motions


def test_the_scale_itself_leaves_the_noise(cut):  # type: ignore[no-untyped-def]
    scene, _, model = cut
    free = FreeModel(model)
    part, _ = drawn(free, scene, lambda x: BEND * x**2)
    bent = free.beside(part)
    begun = with_starts(scene, Running(bent))
    left = begun.whiten(begun.residuals(bent))
    assert np.mean(left**2) < 1.15
    assert np.mean(left[:50] ** 2) < 1.5  # and begins where it began


def test_what_it_does_to_first_order_is_what_a_simulation_says(cut):  # type: ignore[no-untyped-def]
    scene, _, model = cut
    free = FreeModel(model)
    part, motions = drawn(free, scene, lambda x: 1e-3 * BEND * x**2)
    view = FreeScreen(scene, free)
    told = tables_of(view, [(SCALE, PLACE)], [part.ranges], motions)[0] @ part.coefficients
    before, after = (scene.residuals(f)[0] for f in (free, free.beside(part)))
    simulated = scene.whiteners[0].steady(before - after)
    assert np.linalg.norm(told - simulated) < 0.02 * np.linalg.norm(simulated)


def test_it_is_found_and_drawn(cut):  # type: ignore[no-untyped-def]
    scene, held, model = cut
    found = free_form(scene, held, model)[-1]
    assert found.name == "position at the sensor"
    assert np.mean(found.white**2) < 1.15
    part = found.parts[0]
    x = SCALE.grid(part.ranges)
    bend = 2.0 * np.polyfit(x, part.coefficients, 2)[0]
    assert bend == pytest.approx(2.0 * BEND, rel=0.1)


@pytest.mark.parametrize(
    ("gains", "alone"),
    [
        ((12.0, -10.0), True),
        ((8.0, -10.0), False),  # the names are the likelier
        ((25.0, -21.0), False),  # where it is judged it is no better
    ],
)
def test_one_map_that_does_as_well_as_two_names_is_what_there_is(cut, gains, alone, monkeypatch):
    scene, held, model = cut
    gain = EffectSpec("position_dependent_gain", {"linear_coefficient": -2.0 * BEND})
    drag = EffectSpec("quadratic_drag", {"coefficient": 1.0})
    both = fit(scene, model.with_effect(gain).with_effect(drag), rounds=6)
    monkeypatch.setattr(unnamed, "gains_of", lambda *_: (*gains, 9.0))
    rng = np.random.default_rng(1)
    found = unnamed.compare(scene, held, model, both, rng)
    assert found.alone.name == "position at the sensor"
    assert (found.verdict == "unnamed") is alone


@pytest.mark.parametrize(("gain", "name"), [(15.0, None), (25.0, SCALE.name)])
def test_a_map_says_more_than_noise_of_its_own_colour(cut, gain, name, monkeypatch):
    scene, held, model = cut
    drawn = free_form(scene, held, model)[-1]
    assert in_own_noise(scene, model, drawn) > 100.0
    monkeypatch.setattr(unnamed, "in_own_noise", lambda *_: gain)
    found = unnamed.compare(
        scene, held, model, fit(scene, model, rounds=6), np.random.default_rng(1)
    )
    assert (found.alone and found.alone.name) == name


def test_a_parabola_is_drawn_as_it_is():
    grid, z = np.linspace(-0.3, 0.5, 9), np.linspace(-0.3, 0.5, 200)
    curve = lambda x: 1.0 - 2.0 * x + 3.0 * x**2  # noqa: E731
    assert np.abs(smoothed(grid, curve(grid)[:, None], z)[:, 0] - curve(z)).max() < 1e-12
    beyond = smoothed(grid, curve(grid)[:, None], np.array([0.55, 0.6, 9.0, 99.0]))[:, 0]
    assert beyond[1] - beyond[0] == pytest.approx(0.05 * (-2.0 + 6.0 * 0.5), rel=1e-6)
    assert beyond[2] == beyond[3]  # constant from there

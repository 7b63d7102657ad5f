"""Maps beside the numbers that go with them, where they begin, and those of the time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.hypothesis.places import Place, places_of
from ffl.diagnose.maps.described import _told
from ffl.diagnose.maps.form import FreeForm
from ffl.diagnose.maps.freeform import BENT, _started, _unbent, free_form, judged
from ffl.diagnose.maps.freemodel import FreeModel, FreeScreen, Part
from ffl.diagnose.maps.grids import MOMENTS, ranges_of
from ffl.diagnose.maps.picture import picture
from ffl.diagnose.maps.retold import (
    beside_formula,
    surprise,
    with_the_stated_mass,
    with_the_stated_number,
)
from ffl.diagnose.maps.shapes import library
from ffl.diagnose.maps.terms import TERMS
from ffl.diagnose.recorded.trials import start_of
from ffl.effects import Motion
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording
from ffl.systems import EffectSpec

DRAG = 40.0  # N s^2/m^2
BESIDE = 2.0  # 1/s of damping that a map takes back
FADES = 0.1  # of the command, per second


def term(name):  # type: ignore[no-untyped-def]
    return next(t for t in TERMS if t.name == name)


def test_a_map_is_told_beside_the_numbers_of_its_formula(stage, record, scenes):  # type: ignore[no-untyped-def]
    """A drag of the square of the speed, found beside damping that the map takes back."""
    machine = replace(stage, effects=(EffectSpec("quadratic_drag", {"coefficient": DRAG}),))
    scene, held, nominal = scenes(list(record(machine)))
    mass, constant = stage.physics.mass, stage.physics.motor_constant
    velocity = term("velocity")
    run = FreeModel(nominal).follow(scene.trials[0], [Place("force")])
    ranges = ranges_of([run[1][Place("force")]])
    grid = velocity.grid(ranges)
    drag = -DRAG * grid * np.abs(grid) / constant
    part = Part(velocity, Place("force"), drag + BESIDE * mass * grid / constant, ranges)
    model = replace(nominal, corrections={"damping": BESIDE})
    alone = judged(scene, held, FreeModel(model, (part,)), 1e3)
    assert alone is not None
    stated = with_the_stated_number(alone)
    assert abs(stated.free.model.corrections["damping"]) < 0.1 * BESIDE
    assert stated.cost < 1.05 * alone.cost
    said, told = _told(FreeScreen(scene, stated.free), stated, 0, constant)
    assert said is not None
    assert "velocity |velocity|" in said.text
    assert abs(told.free.model.corrections["damping"]) < 0.1 * BESIDE
    assert surprise(told.free.model) < 0.1 * surprise(model)
    assert told.cost < 1.05 * alone.cost
    fast = 0.9 * grid[-1]
    for values in (told.parts[0].coefficients, said.values / constant):
        assert np.interp(fast, grid, values) == pytest.approx(-DRAG * fast**2 / constant, rel=0.05)
    poor = replace(said, values=0.0 * said.values)  # a formula that says nothing of it
    assert beside_formula(alone, poor, constant) is None


@pytest.mark.parametrize(("mass", "anew"), [(0.01, False), (0.2, True)])
def test_only_beside_bent_numbers_a_map_begins_once_more_from_the_stated_ones(
    stage, record, scenes, mass, anew
):  # type: ignore[no-untyped-def]
    scene, _, nominal = scenes([record(stage)[0]])
    model = replace(nominal, corrections={"mass": mass})
    doubt = next(c.doubt for c in model.coordinates if c.name == "mass")
    assert (mass > BENT * doubt) is anew
    ranges = {"x": (-0.05, 0.15), "v": (-1.0, 1.0), "u": (-1.0, 1.0), "step": (1e-3, 3.0)}
    position = term("position")
    part = Part(position, Place("force"), 0.0 * position.grid(ranges), ranges)
    current = FreeForm(FreeModel(model), scene, 0.0, *3 * [np.zeros(0)])
    ways = _unbent(current, part)
    assert len(ways) == anew
    assert all(not start.model.corrections for _, start in ways)
    standing = replace(current, free=FreeModel(model, (part,)))
    assert not _unbent(standing, part)  # maps stand beside these numbers


def test_a_map_winds_springs_up_as_a_load_by_name_does(two_masses, record, scenes):  # type: ignore[no-untyped-def]
    scene, _, model = scenes(list(record(two_masses)), two_masses)
    place, force = next(p for p in places_of(model) if p.side == "load"), 3.0
    simulator, trial = model.base.simulator, replace(scene.trials[0], loaded=True)
    position = term("position")
    ranges = {"x": (-0.05, 0.15), "v": (-1.0, 1.0), "u": (-1.0, 1.0), "step": (1e-3, 3.0)}
    level = np.full(len(position.grid(ranges)), force / simulator.force_per_input)
    free = FreeModel(model, (Part(position, place, level, ranges),))
    named = [EffectSpec("constant_load", {"force": force}, place.options)]
    pulled = free._start(trial)
    np.testing.assert_allclose(pulled, start_of(simulator, named, trial), atol=1e-12)
    assert np.abs(pulled - free._start(replace(trial, loaded=False))).max() > 1e-6
    # A machine that stood so before its first sample, read as one that did not.
    y = free.follow(trial)[0].y
    seen = replace(scene, trials=(replace(trial, y=y, loaded=False),))
    found = judged(seen, None, free, 0.0)
    assert found is not None
    assert _started(found).cost < 0.01 * found.cost


def test_a_gain_that_fades_as_time_goes_on_is_a_map_of_the_time(stage, references, scenes):  # type: ignore[no-untyped-def]
    simulator, runs = Simulator(stage), []
    for seed, r in enumerate(references):
        rng, added = np.random.default_rng(seed), np.zeros(len(r))
        noise = stage.machine.sensor_noise * rng.standard_normal(len(r))
        shaken = stage.machine.force_noise * rng.standard_normal(len(r))
        for _ in range(40):
            run = simulator.run((), r, force=shaken + added, noise=noise)
            added = -FADES * run.t * run.u
        t = run.t + 20.0 * seed  # a clock that goes on
        runs.append(
            Recording(t, r, 0.0 * r, run.u, run.y, sample_time=1e-3, source=f"run_{seed}.csv")
        )
    scene, held, model = scenes(runs)
    found = free_form(scene, held, model)[-1]
    assert found.name == "command by time"
    assert np.mean(found.white**2) < 1.3
    assert np.mean(found.held_white**2) < 1.6
    told = with_the_stated_mass(found)
    assert abs(told.free.model.corrections["mass"]) < 0.02
    drawn = picture(told.scene, told.free, 0, None)
    assert drawn.x_label == "time [s]"
    assert np.interp(2.0, drawn.grid, drawn.values) == pytest.approx(-2.0 * FADES, abs=0.02)


def test_time_is_that_since_the_recording_began_and_waves_span_its_knots():  # type: ignore[no-untyped-def]
    t = 20.0 + 1e-3 * np.arange(1000)
    one, zero = np.ones(1000), np.zeros(1000)
    motion = Motion(t, zero, one, zero, zero, zero, 1e-3)
    gain = term("command by time")
    columns = gain.columns(motion, {"step": (1e-3, 1.0)})
    np.testing.assert_allclose(columns[0], np.eye(MOMENTS)[0], atol=1e-12)
    np.testing.assert_allclose(columns.sum(axis=1), 1.0)
    periods = [s.inner[0] for s in library(0.0, 8.0, False, 4.0) if s.text.startswith("sin(")]
    assert len(periods) > 10
    assert min(periods) > 4.0
    assert min(s.inner[0] for s in library(0.0, 8.0, False) if s.text.startswith("sin(")) < 1.0

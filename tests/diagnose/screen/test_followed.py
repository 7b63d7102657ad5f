"""The machine as it went, where its model would have gone another way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.together import sets
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import commanded, prepare
from ffl.diagnose.screen.candidate import Candidate
from ffl.diagnose.screen.drives import blocked
from ffl.diagnose.screen.followed import NEAR, astray, followed
from ffl.diagnose.screen.screen import Screen, as_measured
from ffl.effects import EFFECTS
from ffl.machines import SimulatedMachine
from ffl.systems.plant import EffectSpec

LIMIT = EffectSpec("saturation", {"limit": 1.5})
LOAD = EffectSpec("constant_load", {"force": 5.0})
FRICTION = EffectSpec("coulomb_friction", {"level": 6.0})


@pytest.fixture(scope="module")
def limited(stage, record, scenes):
    """A machine whose command never gets through: with 1.5 A it swings where its model does not."""
    return scenes(record(replace(stage, effects=(LIMIT, LOAD))))


def limit_and_load(along):
    """The pair; a spring about a far centre holds the load too, and has one number more."""
    wanted = {"saturation", "constant_load"}
    return next(
        s for s in sets(along, along.candidates()) if {spec.name for spec in s.specs} == wanted
    )


def test_a_force_leads_the_model_to_where_it_was_measured(limited):
    scene, _, model = limited
    along = followed(scene, model)
    assert astray(scene, model)
    before, after = scene.residuals(model), along.residuals(model)
    assert np.sum(after[0] ** 2) < NEAR * np.sum(before[0] ** 2)
    assert not astray(along, model)


def test_on_its_way_there_is_nothing_to_follow(stage, record, scenes):
    scene, _, model = scenes(record(stage))
    assert not astray(scene, model)
    assert as_measured(scene, fit(scene, model, rounds=0)) is None


def test_one_recording_may_be_on_its_way_and_another_not(on_a_spring):
    plant = on_a_spring(2.0, 25.0, 0.02, 1e-3, "N", sensor_noise=1e-6, force_noise=1e-3)
    machine = SimulatedMachine(replace(plant, effects=(EffectSpec("saturation", {"limit": 2.0}),)))
    rng, t = np.random.default_rng(0), 1e-3 * np.arange(1500)
    wave = np.sin(2 * np.pi * (1.0 + 12.0 * t) * t)
    runs = [machine.run(np.zeros_like(t), size * wave, rng) for size in (5.0, 1.0)]
    base = Base.of(plant, 0.01, 1.5)
    trials = tuple(prepare(base.simulator, commanded(plant, run), 1e-6) for run in runs)
    scene, model = Scene(plant.loop, trials, Noise(1e-6, 1e-3)), Model(base)
    assert astray(scene, model)
    along = as_measured(scene, fit(scene, model, rounds=0))
    assert along is not None
    assert np.isfinite(along.wanted).all()


def test_along_it_first_order_tells_the_pair(limited):
    scene, _, model = limited
    own = Screen(scene, fit(scene, model, rounds=0))
    along = as_measured(scene, own.fit)
    best = limit_and_load(along)
    limit, load = sorted(best.specs, key=lambda s: s.name != "saturation")
    assert limit.parameters["limit"] == pytest.approx(1.5, rel=0.01)
    assert load.parameters["force"] == pytest.approx(5.0, rel=0.01)
    assert best.left < 3.0 * scene.samples


def test_beside_an_effect_that_stands(stage, record, scenes):
    scene, _, model = scenes(record(replace(stage, effects=(FRICTION, LIMIT, LOAD))))
    standing = model.with_effect(FRICTION)
    along = as_measured(scene, fit(scene, standing, rounds=0))
    best = limit_and_load(along)
    assert best.left < 0.05 * float(along.residual @ along.residual)


def test_a_model_that_runs_away_is_not_followed(stage, record, scenes):
    scene, _, model = scenes(record(stage))
    wild = model.with_effect(EffectSpec("viscous_friction", {"coefficient": 1e9}))
    broken = wild.with_effect(EffectSpec("linear_stiffness", {"stiffness": -1e12, "centre": 0.0}))
    assert followed(scene, broken) is None


@pytest.mark.parametrize(
    ("limit", "width", "stopped"), [(1.0, 1.0, True), (1.0, 0.1, False), (1.5, 0.5, False)]
)
def test_a_drive_that_lets_nothing_through_is_none(limited, limit, width, stopped):
    """A limit and a dead zone as wide are minus the command together, and so explain whatever it does."""
    scene, _, model = limited
    along = as_measured(scene, fit(scene, model, rounds=0))
    place = along.places(EFFECTS["saturation"])[0]
    pair = [
        Candidate(LIMIT, 0.0, 1, place, along.fit, {"limit": limit}),
        Candidate(EffectSpec("dead_zone", {}), 0.0, 1, place, along.fit, {"shape": width}),
    ]
    amounts = [np.ones(1), np.array([width])]
    assert blocked(along, pair, amounts) is stopped
    assert not any(blocked(along, [c], [a]) for c, a in zip(pair, amounts, strict=True))
    assert not blocked(along, [], [])

"""Noise as the machine answers it: a motor whose load sticks rings on the shaft."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.noise.unrest import unrest_of, with_unrest, without_unrest
from ffl.diagnose.recorded.trials import prepare
from ffl.diagnose.screen.screen import Screen
from ffl.machines import SimulatedMachine
from ffl.systems import EffectSpec, Imperfections, Move, moves

STEP = 0.001
NOISE = Noise(1e-7, 0.03)
STUCK = EffectSpec("coulomb_friction", {"level": 15.0}, {"side": "load"})


@pytest.fixture(scope="module")
def plant(two_masses):
    return replace(two_masses, machine=Imperfections(0.0, NOISE.sensor, NOISE.force, None))


@pytest.fixture(scope="module")
def scene(plant):
    steps = [Move(1.2, 0.2, 0.2, 3.0, 150.0), Move(2.8, -0.2, 0.2, 3.0, 150.0)]
    reference = moves(steps, 4.2, STEP)
    machine = SimulatedMachine(replace(plant, effects=(STUCK,)))
    run = machine.run(reference, 0 * reference, np.random.default_rng(0))
    base = Base.of(plant, 0.2)
    return Scene(plant.loop, (prepare(base.simulator, run, 1e-7),), NOISE)


@pytest.fixture(scope="module")
def model(plant):
    return Model(Base.of(plant, 0.2), effects=(STUCK,))


def powers(scene, model):
    """Mean squares at rest before the moves, and over the moves."""
    white = scene.whiten(scene.residuals(model))
    return float(np.mean(white[200:1100] ** 2)), float(np.mean(white[1600:2100] ** 2))


def test_the_ring_of_a_stuck_load_is_foretold(scene, model):
    rest, motion = powers(scene, model)
    assert rest > 3.0
    assert motion < 2.0
    rest, motion = powers(unrest_of(scene, model), model)
    assert rest < 2.0
    assert motion < 2.0


def test_where_nothing_sticks_every_sample_counts(scene, model):
    linear = model.without(0)
    assert with_unrest(scene, linear).trials[0].unrest is None
    stiffer = replace(linear, effects=(EffectSpec("viscous_friction", {"coefficient": 3.0}),))
    assert with_unrest(scene, stiffer).trials[0].unrest is None


def test_likelihood_pays_for_what_is_called_loud(scene, model):
    loud = unrest_of(scene, model)
    unrest = loud.trials[0].unrest
    assert unrest.min() == 1.0
    white = loud.whiten(loud.residuals(model))
    whole = scene.log_likelihood(white) - float(np.log(unrest).sum())
    assert loud.log_likelihood(white) == pytest.approx(whole)
    assert without_unrest(loud).log_likelihood(white) == pytest.approx(scene.log_likelihood(white))


def test_noise_is_read_where_it_is_calm(scene, model):
    noise = with_unrest(scene, model).noise
    loud = scene.with_noise_of(scene.residuals(model)).noise
    assert 0.015 < noise.force < 0.06
    assert abs(np.log(noise.force / 0.03)) < abs(
        np.log(np.hypot(loud.force, loud.force_coloured) / 0.03)
    )


def test_screens_weigh_alike(scene, model):
    loud = unrest_of(scene, model)
    screen = Screen(loud, fit(loud, model.without(0), rounds=0))
    plain = Screen(scene, fit(scene, model.without(0), rounds=0))
    (one,) = screen.candidates(["coulomb_friction"])[:1]
    (other,) = [c for c in plain.candidates(["coulomb_friction"]) if c.place == one.place]
    assert np.allclose(
        screen.table_of(one)[:, 0] * loud.trials[0].unrest, plain.table_of(other)[:, 0], rtol=0.02,
        atol=0.02 * np.abs(plain.table_of(other)).max(),
    )  # fmt: skip

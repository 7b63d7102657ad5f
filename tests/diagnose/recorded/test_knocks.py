"""Pushes too faint to make their stretch of a residual loud are told by their shape; noise has none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.maps.bursts import heard_in
from ffl.diagnose.maps.unnamed import _as_open
from ffl.diagnose.noise.doubt import Doubt
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.events import events
from ffl.diagnose.recorded.knocks import knocks
from ffl.diagnose.recorded.trials import prepare
from ffl.systems.plant import EffectSpec

FORCE, AT = 0.0047, (400, 1300, 2200, 2700)  # A, more than twice the noise of a sample; samples


@pytest.fixture(scope="module")
def quiet(record, scenes, stage):  # type: ignore[no-untyped-def]
    scene, _, model = scenes([record(stage, 7)[0]])
    return scene, model, scene.residuals(model)[0]


def pushed(stage, n, force=FORCE, lasting=25):  # type: ignore[no-untyped-def]
    push = np.zeros(n)
    for k, at in enumerate(AT):
        push[at : at + lasting] = force * (-1) ** k
    return stage.loop.process_sensitivity.filter(push)


def test_faint_pushes_are_told_with_their_times(quiet, stage):  # type: ignore[no-untyped-def]
    scene, _, left = quiet
    seen = [left + pushed(stage, len(left))]
    assert not events(scene, seen).found
    assert not events(scene, seen, stage).found
    found = knocks(scene, seen)
    assert found.found
    assert len(found.stretches) == len(AT)
    assert all(a - 0.02 < 1e-3 * at < b for at, (a, b) in zip(AT, found.stretches, strict=True))


@pytest.mark.parametrize("corner", [None, 2.0, 40.0])
@pytest.mark.parametrize("seed", range(3))
def test_noise_of_any_colour_is_no_push(quiet, stage, corner, seed):  # type: ignore[no-untyped-def]
    scene, _, left = quiet
    noise = 3e-3 * np.random.default_rng(seed).standard_normal(len(left))
    if corner is not None:
        pole = np.exp(-2 * np.pi * corner * stage.sample_time)
        noise = lfilter([np.sqrt(1 - pole**2)], [1, -pole], noise)
    made = [left + stage.loop.process_sensitivity.filter(noise)]
    assert knocks(scene, made).ratio < 5.0


def test_one_push_is_none_and_a_beginning_is_none(quiet, stage):  # type: ignore[no-untyped-def]
    scene, _, left = quiet
    once = np.zeros(len(left))
    once[1500:1525] = FORCE
    assert not knocks(scene, [left + stage.loop.process_sensitivity.filter(once)]).found
    begun = left.copy()
    begun[:60] += 20.0 * np.std(left) * np.exp(-np.arange(60) / 15.0)
    assert not knocks(scene, [begun]).found


def test_they_are_heard_where_nothing_stands_and_not_beside_names(quiet, stage):  # type: ignore[no-untyped-def]
    scene, model, left = quiet
    seen = [left + pushed(stage, len(left))]
    rng = np.random.default_rng(0)
    heard = heard_in(scene, model, model, seen, rng)
    assert heard.bursts.found
    assert not heard.at_ease
    assert not heard_in(scene, model, model, [left], rng).bursts.found
    friction = EffectSpec("coulomb_friction", {"level": 1e-6})
    named = replace(model, effects=(friction,))
    assert not heard_in(scene, model, named, seen, rng).bursts.found


def test_what_a_recording_is_judged_by_grants_the_numbers_that_names_hold(two_masses, record):  # type: ignore[no-untyped-def]
    run, other = record(two_masses, 3)
    base = Base.of(two_masses)
    scene, held = (
        Scene(two_masses.loop, (prepare(base.simulator, r, 1e-8),), Noise(1e-8, 0.05))
        for r in (run, other)
    )
    nominal = Model(base)
    names = frozenset(c.name for c in nominal.coordinates)
    assert {"mode_1_frequency", "mode_1_damping"} <= names
    found = fit(scene, replace(nominal, held=frozenset({"mode_1_frequency", "mode_1_damping"})))
    opened = _as_open(scene, nominal, found)
    assert opened.model.held == nominal.held
    before, after = (Doubt.of(held, one) for one in (found, opened))
    assert len(after.chosen) == len(before.chosen) + 2
    assert _as_open(scene, nominal, opened) is opened

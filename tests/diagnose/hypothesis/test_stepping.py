"""Fits along narrow valleys, where one number can nearly undo what another does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ffl.diagnose.hypothesis.fit import fit, jacobian
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.stepping import aligned, principal_steps
from ffl.systems.plant import EffectSpec


def test_principal_steps_move_the_prediction_alike(stage, record, scenes):
    scene, _, model = scenes(record(stage))
    model = model.with_effect(EffectSpec("saturation", {"limit": 1.5}))
    residuals = scene.residuals(model)
    white = scene.whiten(residuals)
    j = scene.whiten_stacked(jacobian(scene, model, residuals))
    steps = principal_steps(j, white, model.theta, model.coordinates)
    moved = j @ steps
    size = np.linalg.norm(moved, axis=0)
    assert np.all(size <= 0.1 * np.linalg.norm(white) * (1 + 1e-9))
    across = (moved / size).T @ (moved / size) - np.eye(len(size))
    assert np.abs(across).max() < 1e-6  # orthogonal in what they change
    usual = np.array([c.step for c in model.coordinates])
    assert np.all(np.abs(steps) <= 5.0 * usual[:, None] * (1 + 1e-9))


def test_steps_that_leave_the_bounds_turn_round(stage, record, scenes):
    scene, _, model = scenes(record(stage))
    model = model.with_effect(EffectSpec("dead_zone", {"half_width": 0.0}))
    residuals = scene.residuals(model)
    j = scene.whiten_stacked(jacobian(scene, model, residuals))
    steps = principal_steps(j, scene.whiten(residuals), model.theta, model.coordinates)
    at = [c.name for c in model.coordinates].index("half_width")
    assert np.all(model.theta[at] + steps[at] >= 0.0)


def test_a_limit_and_a_mass_that_keep_their_ratio_are_told_apart(stage, record, scenes):
    """Limit and mass off alike accelerate alike; differences number by number left 98 % of the way."""
    limit = EffectSpec("saturation", {"limit": 1.0})
    lighter = EffectSpec("mass_change", {"change": -0.08})
    machine = replace(stage, effects=(limit, lighter))
    scene, _, model = scenes(record(machine))
    start = model.with_effect(EffectSpec("saturation", {"limit": 1.0 / 0.92}))
    found = fit(scene, start, rounds=20).model
    assert abs(found.effects[0].parameters["limit"] - 1.0) < 0.01
    assert abs(found.corrections["mass"] + 0.08) < 0.01


def test_aligned_weighs_numbers_by_what_they_change():
    step, other = np.array([1.0, 1e-3]), np.array([1.0, -1e-3])
    assert aligned(step, other, np.array([1.0, 1.0]))
    assert not aligned(step, other, np.array([1.0, 1e4]))
    assert not aligned(step, np.zeros(2), np.ones(2))


def test_where_nothing_is_seen_steps_are_the_usual_ones(stage, scenes, record):
    scene, _, model = scenes(record(stage))
    assert isinstance(model, Model)
    j = np.zeros((scene.samples, len(model.theta)))
    steps = principal_steps(j, np.ones(scene.samples), model.theta, model.coordinates)
    assert np.allclose(np.abs(steps), np.diag([c.step for c in model.coordinates]))

"""Fits along narrow valleys, where one number can nearly undo what another does."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose.hypothesis import fit as fitting
from ffl.diagnose.hypothesis.coordinate import Coordinate
from ffl.diagnose.hypothesis.fit import fit, jacobian, jacobian_along
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


@pytest.fixture
def many():  # type: ignore[no-untyped-def]
    """(model of twenty numbers, their columns, what is left) that a few directions explain."""
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((200, 20)) @ rng.standard_normal((20, 20))
    left = columns @ rng.standard_normal(20) + 0.1 * rng.standard_normal(200)
    coordinates = [Coordinate("effect", f"c{k}") for k in range(20)]
    return SimpleNamespace(theta=np.zeros(20), coordinates=coordinates), columns, left


def test_of_many_directions_only_those_of_the_step_are_looked_along(many):  # type: ignore[no-untyped-def]
    model, j, white = many
    steps = principal_steps(j, white, model.theta, model.coordinates, 1e-4)
    assert 1 <= steps.shape[1] < 20
    size = np.linalg.norm(j, axis=0)
    stacked = np.vstack([j / size, 1e-2 * np.eye(20)])
    step = np.linalg.lstsq(stacked, np.append(white, np.zeros(20)), rcond=None)[0]
    ways = np.linalg.qr(steps * size[:, None])[0]
    assert np.linalg.norm(ways.T @ step) ** 2 > 0.9 * np.linalg.norm(step) ** 2
    assert principal_steps(j, white, model.theta, model.coordinates).shape == (20, 20)
    few = principal_steps(j[:, :12], white, np.zeros(12), model.coordinates[:12], 1e-4)
    assert few.shape == (12, 12)


def test_columns_are_brought_up_to_date_along_what_is_looked_along(many, monkeypatch):  # type: ignore[no-untyped-def]
    """Of a linear machine, from columns that are off by up to a half: all directions give its columns,
    some give what the steps along them do."""
    model, right, white = many
    monkeypatch.setattr(fitting, "_difference", lambda scene, model, base, step: right @ step)
    off = right * np.linspace(0.5, 1.5, 20)
    whole = jacobian_along(None, model, [], off, off, white)
    np.testing.assert_allclose(whole, right, atol=1e-9 * np.abs(right).max())
    part = jacobian_along(None, model, [], off, off, white, 1e-4)
    steps = principal_steps(off, white, model.theta, model.coordinates, 1e-4)
    np.testing.assert_allclose(part @ steps, right @ steps, atol=1e-9)
    assert np.abs(part - right).max() > 1e-3  # the rest is as it was


def test_levels_of_a_table_keep_their_columns_beside_another_effect(stage, record, scenes):
    scene, _, model = scenes(record(stage))
    table = {"grid": [-0.06, 0.06], "positive": [2.0, 2.0], "negative": [1.5, 1.5]}
    spec = EffectSpec("position_dependent_friction", {"level": 1.75, "table": table})
    found = fit(scene, model.with_effect(spec), rounds=0)
    beside = found.model.with_effect(EffectSpec("constant_load", {"force": 0.1}))
    assert len(found.shared(beside)) == len(found.model.coordinates)
    finer = replace(spec, parameters={**spec.parameters, "table": {**table, "grid": [-0.06, 0.05]}})
    assert {key[0] for key in found.shared(model.with_effect(finer))} == {"correction"}
    assert {key[0] for key in found.shared(model)} == {"correction"}


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


def test_a_step_cut_short_at_a_bound_counts_as_far_as_it_went():
    """Two numbers at a bound, and a direction in which one of them can only go beyond it."""
    rng = np.random.default_rng(1)
    table = rng.standard_normal((400, 3))
    table[:, 1] = table[:, 0] + 0.3 * table[:, 1]
    y = 2.0 * table[:, 2] + rng.standard_normal(400)

    class Linear:
        coordinates = tuple(
            Coordinate("effect", name, 0, ("positive", k), 1.0, 0.0, 10.0)
            for k, name in enumerate("abc")
        )
        substeps = 1

        def __init__(self, theta):
            self.theta = np.asarray(theta, float)

        def at(self, theta):
            return Linear(np.clip(theta, 0.0, 10.0))

    scene = SimpleNamespace(
        samples=400,
        residuals=lambda model: [y - table @ model.theta],
        whiten_stacked=lambda columns: columns,
    )
    for theta in ([1.0, 1.0, 2.0], [0.0, 0.0, 2.0]):
        model = Linear(theta)
        base = scene.residuals(model)
        new = jacobian_along(scene, model, base, table.copy(), table.copy(), base[0])
        np.testing.assert_allclose(new, table, atol=1e-10)

"""Levels of a friction table where a recording does not go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest import judging
from ffl.diagnose.hypothesis.fit import Fit, fit, jacobian
from ffl.diagnose.hypothesis.knots import continued
from ffl.systems.plant import EffectSpec

NAME = "position_dependent_friction"
UP, DOWN = 2.0, 1.5


def _table(low, high, up, down):  # type: ignore[no-untyped-def]
    grid = np.linspace(low, high, len(up)).tolist()
    return EffectSpec(NAME, {"table": {"grid": grid, "positive": up, "negative": down}})


@pytest.fixture(scope="module")
def seen(stage, record, scenes):  # type: ignore[no-untyped-def]
    """A machine whose recordings show it between 0 and 0.05 m, with levels that do not vary."""
    return scenes(record(replace(stage, effects=(_table(-0.1, 0.1, [UP] * 2, [DOWN] * 2),))))


@pytest.fixture(scope="module")
def half_shown(seen):  # type: ignore[no-untyped-def]
    """A table that is right where it shows, in knots 2 to 4, and 0 elsewhere."""
    scene, _, model = seen
    begun = model.with_effect(_table(-0.05, 0.05, [0.0] * 2 + [UP] * 3, [0.0] * 2 + [DOWN] * 3))
    residuals = scene.residuals(begun)
    columns = jacobian(scene, begun, residuals)
    for k, c in enumerate(begun.coordinates):
        if c.place is not None and c.place[1] < 2:
            columns[:, k] = 0.0
    white = scene.whiten(residuals)
    return Fit(begun, white, scene.whiten_stacked(columns), columns, "converged")


def _levels(model):  # type: ignore[no-untyped-def]
    table = model.effects[0].parameters["table"]
    return np.array(table["positive"]), np.array(table["negative"])


def test_levels_where_the_machine_never_was_are_those_beside_them(seen, half_shown):
    scene = seen[0]
    other = continued(half_shown, scene)
    for found, true in zip(_levels(other.model), (UP, DOWN), strict=True):
        assert found == pytest.approx(true, rel=1e-6)
    assert other.model.effects[0].parameters["level"] == pytest.approx(0.5 * (UP + DOWN))
    assert other.white == pytest.approx(scene.whiten(scene.residuals(other.model)))


def test_every_hypothesis_is_judged_with_its_table_continued(seen, half_shown, monkeypatch):
    scene, held, _ = seen
    monkeypatch.setattr(judging, "fit", lambda *given, **options: half_shown)
    judged = judging.judge(scene, held, half_shown.model)
    assert np.min(_levels(judged.model)) > 0.9 * DOWN


def test_levels_that_show_stay_as_they_were_found(seen):
    scene, _, model = seen
    found = fit(scene, model.with_effect(_table(0.0, 0.05, [UP] * 3, [DOWN] * 3)))
    assert continued(found, scene) is found


def test_a_continued_table_must_leave_no_more_than_it_smooths(seen, half_shown):
    """Levels that the recordings contradict, though no column says so."""
    scene = seen[0]
    wrong = half_shown.model.without(0).with_effect(
        _table(-0.05, 0.05, [UP] * 5, [DOWN, DOWN, 5 * DOWN, 5 * DOWN, DOWN])
    )
    found = replace(half_shown, model=wrong, white=1e-3 * half_shown.white)
    assert continued(found, scene) is found


def test_without_a_table_there_is_nothing_to_continue(seen):
    scene, _, model = seen
    found = fit(scene, model.with_effect(EffectSpec("coulomb_friction", {"level": UP})))
    assert continued(found, scene) is found

"""Shares of a step of maps in the closed loop: smaller ones only where none of the larger helps."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.maps import freestep
from ffl.diagnose.maps.freemodel import FreeModel, Part
from ffl.diagnose.maps.terms import TERMS, Term

VELOCITY, POSITION = (
    next(term for term in TERMS if term.name == name) for name in ("velocity", "position")
)


@dataclass(frozen=True)
class Numbers:
    """What a step asks of a model."""

    theta: np.ndarray = field(default_factory=lambda: np.zeros(1))

    def at(self, theta: np.ndarray) -> Numbers:
        return Numbers(theta)


def model(theta: float, coefficient: float, term: Term = VELOCITY) -> FreeModel:
    span = {"x": (-1.0, 1.0), "v": (-1.0, 1.0), "u": (-1.0, 1.0), "step": (1e-3, 1.0)}
    size = len(term.knots(span))
    part = Part(term, Place("force", "motor"), np.full(size, coefficient), span)
    return FreeModel(Numbers(np.array([theta])), (part,))


def taken(best: float, monkeypatch) -> tuple[float, float]:
    """Numbers and map of the way that is gone where a share `best` of the map's step costs least."""

    def run_of(scene, free):  # type: ignore[no-untyped-def]
        return SimpleNamespace(cost=abs(free.parts[0].coefficients[0] / best - 1.0))

    monkeypatch.setattr(freestep, "run_of", run_of)
    found = freestep._first_below(None, freestep._ways(model(0.0, 0.0), model(1.0, 1.0)), 1.0)
    assert found is not None
    return float(found[0].model.theta[0]), float(found[0].parts[0].coefficients[0])


@pytest.mark.parametrize(
    ("best", "share"), [(1.0, 1.0), (0.3, 0.5), (0.2, 0.25), (0.06, 0.1), (0.021, 0.04)]
)
def test_the_largest_share_that_helps_is_gone(best, share, monkeypatch):
    assert taken(best, monkeypatch) == (share, share)


def test_no_way_is_gone_where_none_helps(monkeypatch):
    monkeypatch.setattr(freestep, "run_of", lambda scene, free: SimpleNamespace(cost=1.0))
    assert freestep._first_below(None, freestep._ways(model(0, 0), model(1, 1)), 1.0) is None


def test_what_does_not_damp_has_the_large_shares_alone():
    ways = freestep._ways(model(0.0, 0.0, POSITION), model(1.0, 1.0, POSITION))
    assert {float(way.parts[0].coefficients[0]) for way in ways} == {*freestep.SHARES}


def test_numbers_that_lead_away_are_left_before_a_step_is_made_small(monkeypatch):
    """With its numbers no share of the step helps, the maps alone do."""

    def run_of(scene, free):  # type: ignore[no-untyped-def]
        away = 10.0 * float(free.model.theta[0])
        return SimpleNamespace(cost=0.5 + away)

    monkeypatch.setattr(freestep, "run_of", run_of)
    found = freestep._first_below(None, freestep._ways(model(0.0, 0.0), model(1.0, 1.0)), 0.6)
    assert found is not None
    assert float(found[0].model.theta[0]) == 0.0
    assert float(found[0].parts[0].coefficients[0]) == 1.0


def test_numbers_that_show_nothing_go_back_to_nominal_however_far_a_map_ran():
    """A map ran to 1e86 where the recordings that were looked at say nothing of mass or damping."""
    coordinates = [SimpleNamespace(doubt=0.03), SimpleNamespace(doubt=1.4)]
    told = SimpleNamespace(theta=np.array([0.01, -0.2]), coordinates=coordinates)
    left = np.full(50, 3.7e86)
    silent = SimpleNamespace(slopes=np.zeros((50, 2)))
    np.testing.assert_allclose(freestep._numbers(silent, told, left), [-0.01, 0.2])
    seen = SimpleNamespace(slopes=np.column_stack([np.zeros(50), np.linspace(1.0, 2.0, 50)]))
    step = freestep._numbers(seen, told, 1e6 * seen.slopes[:, 1])
    assert step[0] == pytest.approx(-0.01)
    assert np.all(np.isfinite(step))


def test_a_number_of_a_name_that_shows_nothing_stays():
    """Nothing is believed of an effect's number beside a map (20270128/0001 ended in an error)."""
    coordinates = [SimpleNamespace(doubt=np.inf), SimpleNamespace(doubt=1.4)]
    told = SimpleNamespace(theta=np.array([3.0, -0.2]), coordinates=coordinates)
    slopes = np.column_stack([np.zeros(50), np.linspace(1.0, 2.0, 50)])
    step = freestep._numbers(SimpleNamespace(slopes=slopes), told, 0.1 * slopes[:, 1])
    assert step[0] == 0.0
    assert step[1] == pytest.approx(0.1, rel=0.05)
    huge = SimpleNamespace(slopes=1e200 * slopes)
    np.testing.assert_array_equal(freestep._numbers(huge, told, slopes[:, 1]), [0.0, 0.0])

"""What a round of the contest says of those it did not take."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from ffl.diagnose.contest import rounds
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.rounds import Outcome, Step


@pytest.mark.parametrize(
    ("accepted", "turned_down", "refused"),
    [
        (None, "drag", "drag"),
        (None, None, "friction"),  # the likeliest that has numbers of its physics
        ("spring", None, None),  # who came in was the likelier
    ],
)
def test_the_refused_is_who_was_turned_down_or_who_might_have_come_in(  # type: ignore[no-untyped-def]
    accepted, turned_down, refused, monkeypatch
):
    monkeypatch.setattr(rounds, "credible", lambda rival: rival != "mode")
    step = Step(SimpleNamespace(), (), ("mode", "friction", "load"), accepted, turned_down)
    assert step.refused == refused


def test_whoever_was_tried_is_who_came_in_and_then_the_likeliest_of_the_others():
    low, high, came, left = (SimpleNamespace(score=s, name=n) for s, n in
                             ((1.0, "low"), (5.0, "high"), (0.0, "came"), (-1.0, "left")))  # fmt: skip
    steps = [Step(low, (), (low, came), came), Step(came, (), (high,), None, turned_down=left)]
    found = Outcome(came, steps, None, {}).tried
    assert [one.name for one in found] == ["came", "left", "high", "low", "came"]


def test_rounds_are_told_apart_by_which_they_are(stage, record, scenes):
    """What is fitted has arrays, which say nothing whole of being alike: a round that was looked up among
    others ended a diagnosis. (Development case 7415/0049, a guide that warms up.)"""
    scene, held, model = scenes(record(stage))
    nothing = judge(scene, held, model, 1)
    again = judge(scene, held, model, 1)
    first, second = Step(nothing, (), (), None), Step(again, (), (), None)
    assert [first, second].index(second) == 1
    assert nothing != again

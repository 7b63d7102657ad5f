"""What a round of the contest says of those it did not take."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
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
    step = refusing(monkeypatch, (10.0, 10.0), (5.0, 5.0), (1.0, 1.0))
    step = replace(step, accepted=accepted, turned_down=turned_down)
    assert getattr(step.refused, "name", step.refused) == refused


def refusing(monkeypatch, *gained):  # type: ignore[no-untyped-def]
    """A step that took none; fitted and held-out log-likelihoods of a mode that is no mode, of a friction
    and so on."""
    monkeypatch.setattr(rounds, "credible", lambda rival: rival.name != "mode")
    rivals = tuple(
        SimpleNamespace(name=name, fitted=fitted, held_out=held_out)
        for name, (fitted, held_out) in zip(("mode", "friction", "load"), gained, strict=False)
    )
    return Step(SimpleNamespace(fitted=0.0, held_out=0.0), (), rivals, None)


@pytest.mark.parametrize(
    ("gained", "followed"),
    [
        (((550.0, 645.0), (250.0, -168.0)), "mode"),
        (((550.0, 645.0),), "mode"),  # nobody else is there
        (((550.0, 645.0), (400.0, -168.0)), "friction"),  # fitted it is not far ahead
        (((550.0, 145.0), (250.0, -168.0)), "friction"),  # nor on what judges, of nothing at all
        (((550.0, -np.inf),), None),
        ((), None),
    ],
)
def test_who_is_far_ahead_is_gone_on_with_whatever_its_numbers_are_without_company(  # type: ignore[no-untyped-def]
    gained, followed, monkeypatch
):
    assert getattr(refusing(monkeypatch, *gained).refused, "name", None) == followed


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

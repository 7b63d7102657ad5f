"""A sine that the loudest frequency of noise could be."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest

from ffl.diagnose.contest import chance
from ffl.diagnose.contest.judging import judge
from ffl.systems.plant import EffectSpec

SINE = EffectSpec("periodic_disturbance", {"frequency": 44.9, "amplitude": -0.05, "phase": 0.0}, {})
LOAD = EffectSpec("constant_load", {"force": 0.05}, {})


def standing(samples):  # type: ignore[no-untyped-def]
    trials = tuple(range(n) for n in samples)
    model = SimpleNamespace(effects=(LOAD, SINE), names=(LOAD.name, SINE.name))
    return SimpleNamespace(model=model, scene=SimpleNamespace(trials=trials), fit=None)


@pytest.mark.parametrize(
    ("samples", "errors", "expected"),
    [
        ((15_695,) * 3, 3.9, True),
        ((15_695,) * 3, 5.3, True),  # sqrt(2 log(23,542 / 0.01)) = 5.42
        ((15_695,) * 3, 5.5, False),
        ((200,), 4.2, True),  # and 4.29 of so few frequencies
        ((200,), 4.4, False),
    ],
)
def test_a_sine_needs_more_errors_the_more_frequencies_there_are(
    samples, errors, expected, monkeypatch
):
    monkeypatch.setattr(chance, "own_error_of", lambda judged, index, name: 0.05 / errors)
    assert chance.by_chance(standing(samples)) is expected


def test_a_sine_whose_amplitude_is_not_free_has_no_error(monkeypatch):
    monkeypatch.setattr(chance, "own_error_of", lambda judged, index, name: None)
    assert not chance.by_chance(standing((15_695,)))


def test_it_goes_and_nobody_else(stage, scenes, record):  # type: ignore[no-untyped-def]
    """A load stays, beside a sine that was fitted to nothing but noise."""
    loaded = replace(stage, effects=(LOAD,))
    scene, held, model = scenes(record(loaded))
    found = judge(scene, held, model.with_effect(LOAD).with_effect(SINE), 10)
    left = chance.without_chance(held, found)
    assert found.model.names == (LOAD.name, SINE.name)
    assert left.model.names == (LOAD.name,)
    assert chance.without_chance(held, left) is left


def test_a_sine_that_is_there_stays(stage, scenes, record):  # type: ignore[no-untyped-def]
    shaken = replace(
        stage, effects=(replace(SINE, parameters={**SINE.parameters, "amplitude": 0.5}),)
    )
    scene, held, model = scenes(record(shaken))
    found = judge(scene, held, model.with_effect(shaken.effects[0]), 10)
    assert chance.without_chance(held, found) is found

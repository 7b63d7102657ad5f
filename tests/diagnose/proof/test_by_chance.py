"""A sine that the loudest frequency of noise could be."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from ffl.diagnose.proof import names
from ffl.systems.plant import EffectSpec

SINE = EffectSpec("periodic_disturbance", {"frequency": 44.9, "amplitude": -0.05, "phase": 0.0}, {})
LOAD = EffectSpec("constant_load", {"force": 0.05}, {})


def standing(spec, samples):  # type: ignore[no-untyped-def]
    trials = tuple(range(n) for n in samples)
    return SimpleNamespace(
        model=SimpleNamespace(effects=(spec,)), scene=SimpleNamespace(trials=trials)
    )


@pytest.mark.parametrize(
    ("spec", "samples", "errors", "chance"),
    [
        (SINE, (15_695,) * 3, 3.9, True),
        (SINE, (15_695,) * 3, 5.3, True),  # sqrt(2 log(23,542 / 0.01)) = 5.42
        (SINE, (15_695,) * 3, 5.5, False),
        (SINE, (200,), 4.2, True),  # and 4.29 of so few frequencies
        (SINE, (200,), 4.4, False),
        (LOAD, (15_695,) * 3, 3.9, False),  # no frequency was looked for
    ],
)
def test_a_sine_needs_more_errors_the_more_frequencies_there_are(
    spec, samples, errors, chance, monkeypatch
):
    monkeypatch.setattr(names, "error_of", lambda judged, index, name: 0.05 / errors)
    assert names.by_chance(standing(spec, samples), 0) is chance


def test_a_sine_that_was_stated_is_none(monkeypatch):
    """Its amplitude is not free, and has no error."""
    monkeypatch.setattr(names, "error_of", lambda judged, index, name: None)
    assert not names.by_chance(standing(SINE, (15_695,)), 0)

"""The last fit: by the noise that is left, and on from a ledge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from ffl.diagnose.contest import by_own_noise as last
from ffl.diagnose.contest.by_own_noise import by_own_noise, looked_around
from ffl.diagnose.contest.judging import judge, levelled
from ffl.diagnose.contest.line import released
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.noise.spread import error_of
from ffl.machines import SimulatedMachine
from ffl.systems.plant import EffectSpec

LEVEL = 1.5
FRICTION = EffectSpec("coulomb_friction", {"level": LEVEL})


def slow_push(rng, n, size=0.06, corner=3.0, step=1e-3):  # type: ignore[no-untyped-def]
    """Force noise below a few hertz, A."""
    pole = np.exp(-2 * np.pi * corner * step)
    return scipy.signal.lfilter([size * np.sqrt(1 - pole**2)], [1.0, -pole], rng.standard_normal(n))


@pytest.fixture(scope="module")
def pushed(stage, references, scenes):  # type: ignore[no-untyped-def]
    """(scene, held, judged) of a stage with friction that slow noise pushes, eight times."""
    out = []
    for seed in range(8):
        rng = np.random.default_rng(100 + seed)
        device = SimulatedMachine(replace(stage, effects=(FRICTION,)))
        runs = [device.run(r, slow_push(rng, len(r)), rng) for r in references]
        scene, held, model = scenes([replace(run, f=np.zeros(len(run))) for run in runs])
        out.append((held, judge(scene, held, replace(model, effects=(FRICTION,)), 12)))
    return out


def error_of_level(judged):  # type: ignore[no-untyped-def]
    return judged.model.effects[0].parameters["level"] - LEVEL


def test_errors_are_less_by_the_noise_as_it_is_and_as_told(pushed):
    last_fits = [by_own_noise(held, judged) for held, judged in pushed]
    before = np.array([error_of_level(judged) for _, judged in pushed])
    after = np.array([error_of_level(judged) for judged in last_fits])
    told = np.array([error_of(judged, 0, "level") for judged in last_fits])
    assert np.sqrt(np.mean(after**2)) < 0.85 * np.sqrt(np.mean(before**2))  # 0.13 N for 0.185
    assert 0.5 < np.sqrt(np.mean((after / told) ** 2)) < 2.0


def test_both_kinds_of_recordings_are_the_likelier_for_it_or_nothing_changes(pushed):
    for held, judged in pushed:
        other = by_own_noise(held, judged)
        before, after = levelled([judged, other])
        assert after.score > before.score or other is judged
        assert other.model.names == judged.model.names
        assert by_own_noise(held, other).score == pytest.approx(other.score, abs=last.ENOUGH)


def test_a_fit_goes_on_from_below_a_ledge(pushed):
    """Where all derivatives vanish and the bottom is not."""
    _, judged = pushed[0]
    bottom = fit(judged.scene, judged.model, rounds=20)
    level = bottom.model.effects[0].parameters["level"]
    off = bottom.model.with_parameters(0, {"level": 1.3 * level})
    ledge = fit(judged.scene, off, rounds=0)
    assert ledge.cost > bottom.cost + 10.0 * last.LOWER
    below = looked_around(judged.scene, ledge)
    assert below.cost == pytest.approx(bottom.cost, abs=last.LOWER)
    assert looked_around(judged.scene, below) is below


def test_led_by_an_observer_and_where_nothing_is_named_nothing_changes(pushed):
    held, judged = pushed[0]
    led = replace(judged, scene=replace(judged.scene, observed=True))
    assert by_own_noise(held, led) is led
    nothing = judge(judged.scene, held, judged.model.without(0), 2)
    assert by_own_noise(held, nothing) is nothing


def test_held_out_runs_are_missed_by_no_more(pushed, monkeypatch):
    held, judged = pushed[0]
    off = judged.model.with_parameters(0, {"level": 0.5})
    worse = replace(judged, fit=fit(judged.scene, off, rounds=0), fitted=judged.fitted - 1e6)
    assert by_own_noise(held, worse) is not worse
    monkeypatch.setattr(last, "raw_error", lambda held, model: 1.0 if model is off else 1.2)
    assert by_own_noise(held, worse) is worse


def test_a_number_on_the_line_stays_there(pushed):
    """Who did not earn more is held at 2 %; it is let go, to say how sure it is, after the last fit."""
    held, judged = pushed[0]
    corrections = {**judged.model.corrections, "mass": 0.0199}
    on = replace(judged.model, corrections=corrections, held=frozenset({"mass"}))
    found = by_own_noise(held, judge(judged.scene, held, on, 2))
    assert found.model.corrections["mass"] == 0.0199
    free = released(found)
    assert free.model.corrections["mass"] == 0.0199
    assert "mass" not in free.model.held


def test_not_beside_a_friction_table(pushed):
    held, judged = pushed[0]
    table = {"grid": [-0.1, 0.1], "positive": [1.0, 1.0], "negative": [1.0, 1.0]}
    spec = EffectSpec("position_dependent_friction", {"table": table, "level": 1.0})
    found = replace(judged, fit=replace(judged.fit, model=replace(judged.model, effects=(spec,))))
    assert by_own_noise(held, found) is found


def test_a_place_that_leads_nowhere_is_left(pushed, monkeypatch):
    _, judged = pushed[0]
    found = fit(judged.scene, judged.model, rounds=0)
    monkeypatch.setattr(last, "fit", lambda *_, **__: replace(found, status="diverged"))
    assert looked_around(judged.scene, found) is found
    assert by_own_noise(None, judged) is judged

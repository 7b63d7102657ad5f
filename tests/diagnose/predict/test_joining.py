"""Who joins a play, on which clocks, and in which form."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from test_play_and_company import PLAY, told

from ffl.diagnose.predict import joining, plain_spring
from ffl.diagnose.predict.joining import Company
from ffl.diagnose.predict.play import able
from ffl.systems.plant import EffectSpec


@pytest.mark.parametrize(("settling", "joins"), [(400.0, True), (40.0, False)])
def test_who_may_join_is_asked_again_where_settling_alone_brought_much(
    monkeypatch, settling, joins
):
    """Beside half of its gap a play leaves a sine nothing to bring; settled, it does."""
    half, whole = told(("backlash",), 0.0, 0.0), told(("backlash",), settling, 0.0)
    early = told(("periodic_disturbance", "backlash"), 50.0, 0.0)
    late = told(("periodic_disturbance", "backlash"), 900.0, 0.0)

    def ranked(company, *_):  # type: ignore[no-untyped-def]
        who = {id(half): early, id(whole): late}.get(id(company.found))
        return [joining._Way(who, ("fitted",), 100.0)] if who else []

    monkeypatch.setattr(joining, "_ranked", ranked)
    company = joining.joined(
        Company(half, ("fitted",)),
        None,
        able,
        lambda point, trials: whole if point is half else point,
    )
    assert company.found is (late if joins else whole)


@pytest.mark.parametrize(
    ("gain", "judged", "joins"),
    [
        pytest.param(30.0, 5.0, False, id="neither to first order nor where it judges"),
        pytest.param(30.0, 120.0, True, id="the recording that judges says so too"),
        pytest.param(400.0, 5.0, True, id="to first order it brings as much"),
    ],
)
def test_one_contact_that_falls_better_is_nobody_who_joins(monkeypatch, gain, judged, joins):
    """400 ahead; what judges is as long, and should say so."""
    alone = told(("backlash",), 0.0, 0.0)
    hum = told(("periodic_disturbance", "backlash"), 400.0 + 8.0, judged)

    def ranked(company, *_):  # type: ignore[no-untyped-def]
        return [joining._Way(hum, ("fitted",), gain)] if company.found is alone else []

    monkeypatch.setattr(joining, "_ranked", ranked)
    monkeypatch.setattr(joining, "in_step", lambda found, trials, first: trials)
    company = joining.joined(
        Company(alone, ("fitted",), judging=("judging",)), None, able, lambda point, trials: point
    )
    assert company.found is (hum if joins else alone)


def clocked_by(right):  # type: ignore[no-untyped-def]
    """Told of a settling of 0.8 s and a sine of 2 Hz, and what it foretells of a clock."""
    effects = (
        EffectSpec("periodic_disturbance", {"frequency": 2.0, "amplitude": 1.0, "phase": 0.0}),
        EffectSpec("drift", {"amplitude": 1.0, "time_constant": 0.8}),
    )
    model = SimpleNamespace(effects=effects)

    def scaled(trials):  # type: ignore[no-untyped-def]
        warm, turn = np.exp(-trials[0].start_time / 0.8), 4 * np.pi * trials[0].start_time
        away = 10.0 * abs(warm - np.exp(-right / 0.8)) + abs(
            np.exp(1j * (turn - 4 * np.pi * right)) - 1
        )
        return -away, 1.0

    return SimpleNamespace(model=model, scaled=scaled)


@dataclass(frozen=True)
class Begun:
    start_time: float


@pytest.mark.parametrize("right", [0.0, 0.37, 0.83, 3.9])
def test_clocks_are_moved_to_where_it_has_settled_and_in_step(right):
    first, second = joining.in_step(clocked_by(right), [Begun(0.0), Begun(0.0)], 1)
    assert first.start_time == 0.0  # as it is: before `from_trial`
    assert abs(np.exp(-second.start_time / 0.8) - np.exp(-right / 0.8)) < 0.3
    turns = 2.0 * (second.start_time - right)
    assert abs(turns - round(turns)) < 0.05
    alone = clocked_by(right)
    alone.model.effects = alone.model.effects[1:]
    (only,) = joining.in_step(alone, [Begun(0.2)], 0)
    assert only.start_time >= 0.0  # nothing had begun to settle before it did


@pytest.mark.parametrize(("plain", "taken"), [(50.0, True), (-50.0, True), (-150.0, False)])
def test_a_plain_spring_is_taken_that_foretells_no_clearly_worse(monkeypatch, plain, taken):
    """As stiff as the tightened one where that is not at its end."""
    own = told(("preloaded_spring", "backlash"), 0.0, 0.0)
    tight = {"preload": 4.5, "width": 0.05, "centre": -0.02}
    own.model.effects = (EffectSpec("preloaded_spring", tight, {"side": "motor"}), PLAY)
    tried = told(("linear_stiffness", "backlash"), plain, 0.0)
    put: list[EffectSpec] = []
    monkeypatch.setattr(
        plain_spring, "in_place", lambda found, name, spec: put.append(spec) or tried
    )
    monkeypatch.setattr(plain_spring, "refitted", lambda found, trials: found)
    monkeypatch.setattr(plain_spring, "charged", lambda found, trials: found.worth(trials))
    company = plain_spring.untightened(Company(own, ("fitted",)), lambda found, trials: found)
    spring = {"stiffness": 90.0, "centre": -0.02}
    assert put == [EffectSpec("linear_stiffness", spring, {"side": "motor"})]
    assert company.found is (tried if taken else own)
    (rival,) = company.rivals.items()
    assert rival == (("linear_stiffness", own) if taken else ("preloaded_spring", tried))


def test_who_has_no_tightened_spring_stays_as_he_is():
    alone = Company(told(("viscous_friction", "backlash"), 0.0, 0.0), ("fitted",))
    assert plain_spring.untightened(alone, lambda found, trials: found) is alone

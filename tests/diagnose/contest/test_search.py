"""The contest's ways: who was turned down, who comes near, and what is no finding."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose.contest import hearing, line, search
from ffl.diagnose.contest import settle as settling
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.rounds import Outcome, Step
from ffl.diagnose.contest.work import MOST, MOST_STEPS, Work
from ffl.diagnose.hypothesis.places import mass_is_corrected
from ffl.diagnose.noise import unrest
from ffl.diagnose.recorded.trials import Trial
from ffl.effects import EFFECTS
from ffl.effects.motion import Extent
from ffl.systems.plant import EffectSpec

THRESHOLD = 20.0
FRICTION = EffectSpec("coulomb_friction", {"level": 2.0})
STOP = EffectSpec("cogging", {"amplitude": 6.0, "period": 0.011, "phase": 0.4})
HUM = EffectSpec("periodic_disturbance", {"amplitude": 6.0, "frequency": 17.0, "phase": 0.4})
SPRING = EffectSpec("hardening_spring", {"cubic_coefficient": 4e4, "centre": 0.02})


@pytest.fixture(scope="module")
def brief(record):
    """Recordings of three moves each."""
    return lambda machine: [recording[:2150] for recording in record(machine)]


@pytest.mark.slow(15)
def test_who_is_turned_down_does_not_end_the_search(stage, brief, scenes, monkeypatch):
    machine = replace(stage, effects=(FRICTION, SPRING))
    scene, held, model = scenes(brief(machine))
    asked = []

    def kept(held, judged, before, now, then):
        asked.append(judged.model.names)
        return None if len(asked) == 1 else (judged, now)

    monkeypatch.setattr(search, "as_far_as_told", kept)
    monkeypatch.setattr(search, "_with_who_was_turned_down", lambda outcome, *_: outcome)
    outcome = search.contest(scene, held, model, THRESHOLD)
    # Asked in the form that it settled in: its own, or a near one of dry friction.
    assert len(asked[0]) == 1
    assert outcome.steps[0].accepted is None  # the first that came in, turned down
    (first,) = outcome.steps[0].turned_down.model.names
    assert outcome.steps[1].accepted.model.names[-1] != first
    assert set(outcome.standing.model.names) == {"coulomb_friction", "hardening_spring"}


@pytest.mark.parametrize(("true", "looked_for"), [((FRICTION,), False), ((FRICTION, HUM), True)])
def test_sets_are_looked_for_where_no_single_effect_leaves_little_more_than_noise(
    stage, brief, scenes, monkeypatch, true, looked_for
):
    scene, held, model = scenes(brief(replace(stage, effects=true)))
    asked = []
    monkeypatch.setattr(search, "starts", lambda *_: asked.append(1) or [])
    search.contest(scene, held, model, THRESHOLD)
    assert bool(asked) is looked_for


def test_the_company_stands_once_while_those_kept_back_are_tried_in_it(
    stage, brief, scenes, monkeypatch
):
    """Nothing is fitted anew in between; rivals of before are not tried again."""
    scene, held, model = scenes(brief(replace(stage, effects=(FRICTION,))))
    calls, only = [], []
    own, tried = search.settle, settling.challengers

    def settle(quiet, held, judged, steps, reserve, *rest):
        found = own(quiet, held, judged, steps, reserve, *rest)
        calls.append((quiet, judged.model, reserve, found[0].model))
        return found

    def challengers(*arguments):
        only.append(arguments[-1])
        return tried(*arguments)

    monkeypatch.setattr(search, "settle", settle)
    monkeypatch.setattr(settling, "challengers", challengers)
    search.contest(scene, held, model, THRESHOLD)
    (quiet, _, kept, stood), (again, judged, none, _) = calls
    assert kept == settling.PLIABLE
    assert none == frozenset()
    assert again is quiet
    assert judged is stood
    assert only == [None, settling.PLIABLE]


def friction_and_spring(model):
    """Who stands beside `FRICTION`, or a Stribeck curve that is as flat, and `SPRING`."""
    found = {spec.name: spec.parameters for spec in model.effects}
    assert found.pop("hardening_spring")["cubic_coefficient"] == pytest.approx(4e4, rel=0.02)
    name = next(n for n in found if n in ("coulomb_friction", "stribeck_friction"))
    levels = [value for key, value in found.pop(name).items() if key.endswith("level")]
    assert levels == pytest.approx([2.0] * len(levels), rel=0.02)
    return set(found)


@pytest.mark.slow(15)
def test_company_that_loses_one_as_the_tables_are_let_in_gives_everyone_another_say(
    stage, brief, scenes, monkeypatch
):
    scene, held, model = scenes(brief(replace(stage, effects=(FRICTION, SPRING))))
    settle, of = search.settle, search.View.of
    lost, let_in = [], []

    def losing(quiet, held, judged, steps, reserve, *rest):
        if reserve or lost:
            return settle(quiet, held, judged, steps, reserve, *rest)
        lost.append(judged.model.names)
        bare = judged.model.without(judged.model.names.index("hardening_spring"))
        return judge(quiet, held, bare, rounds=10), {}

    def seen(screen, taken, least, pliable):
        let_in.append(pliable)
        return of(screen, taken, least, pliable)

    monkeypatch.setattr(search, "settle", losing)
    monkeypatch.setattr(search.View, "of", staticmethod(seen))
    outcome = search.contest(scene, held, model, THRESHOLD)
    assert len(lost) == 1
    # A spring and dry friction; a third that brings little is taken off after the contest, if at all.
    assert "hardening_spring" in lost[0]
    assert set(lost[0]) & settling.DRY
    friction_and_spring(outcome.standing.model)
    assert let_in[0] is False
    assert None in let_in


def test_claimants_are_held_on_the_line_under_one_noise(stage, brief, scenes, monkeypatch):
    scene, held, model = scenes(brief(replace(stage, effects=(FRICTION,))))
    nothing = judge(scene, held, model, rounds=10)
    friction = judge(scene, held, model.with_effect(FRICTION), rounds=10)
    assert friction.scene.noise != nothing.scene.noise
    seen = []
    own = line.on_the_line
    monkeypatch.setattr(
        line, "on_the_line", lambda held, judged: seen.append(judged.scene) or own(held, judged)
    )
    (first,) = line.claimants(scene, held, nothing, [friction], THRESHOLD)
    assert first.model.names == ("coulomb_friction",)
    assert len(seen) == 2
    assert all(one is scene for one in seen)


@pytest.mark.parametrize(
    ("gained", "alone", "left", "believed", "noise", "tried", "followed", "stands"),
    [
        ((500.0, 0.0), 110.0, 30.0, True, 1.0, (), True, True),
        ((500.0, 0.0), 110.0, 30.0, False, 1.0, (), True, False),  # of no such physics in the end
        ((500.0, 0.0), 110.0, 80.0, True, 1.0, (), True, False),  # not half of what was left
        ((100.0, 0.0), 110.0, 30.0, True, 1.0, (), False, False),  # fitted it gained little
        ((500.0, 0.0), 110.0, 30.0, True, 60.0, (), False, False),  # what is left may be noise
        ((500.0, 0.0), 55.0, 30.0, True, 60.0, (), True, True),  # and of that noise it takes half
        ((500.0, 300.0), 110.0, 30.0, True, 60.0, (), True, True),  # none: far ahead held out
        ((500.0, 0.0), 110.0, 30.0, True, 1.0, (MOST,), False, False),  # enough was tried
        ((500.0, 0.0), 110.0, 30.0, True, 1.0, (9, MOST_STEPS), False, False),  # so few, and long
    ],
)
def test_it_goes_on_with_who_was_turned_down_where_that_halves_what_is_left(
    gained, alone, left, believed, noise, tried, followed, stands, monkeypatch
):
    def standing(name, fitted=0.0, held_out=0.0):  # type: ignore[no-untyped-def]
        scene = SimpleNamespace(work=Work(*tried))
        said = {"fitted": fitted, "held_out": held_out, "scene": scene, "held": None}
        return SimpleNamespace(name=name, model=name, **said)

    nothing, first, friction = standing("nothing"), standing("load"), standing("friction", *gained)
    steps = [
        Step(nothing, (), (), first),
        Step(nothing, (), (), None, turned_down=friction),
        Step(nothing, (), (), None),
    ]
    outcome, other = (Outcome(standing(n), steps, None, {}) for n in ("stood", "other"))
    asked = []

    def climb(scene, held, begun, joined, *_, patient):  # type: ignore[no-untyped-def]
        asked.append((begun, [step.accepted for step in joined], patient))
        return other

    monkeypatch.setattr(search, "_climb", climb)
    errors = {"stood": 100.0, "friction": alone, "other": left}
    monkeypatch.setattr(search, "raw_error", lambda _, model: errors[model])
    monkeypatch.setattr(search, "noise_error", lambda *_: noise)
    monkeypatch.setattr(search, "credible", lambda _: believed)
    found = search._with_who_was_turned_down(outcome, THRESHOLD, 3, lambda line: None)
    assert asked == ([(friction, [first, friction], True)] if followed else [])
    assert found is (other if stands else outcome)


def judged(score, white, *names):
    model = SimpleNamespace(names=names)
    return SimpleNamespace(score=score, fit=SimpleNamespace(white=np.asarray(white)), model=model)


def outcome(refused, **rivals):
    """What stands is an overflow and a spring, 0; `refused`: what a third would have brought."""
    own = judged(0.0, np.zeros(100), "overflow", "hardening_spring")
    before = SimpleNamespace(fitted=0.0, held_out=0.0)
    third = SimpleNamespace(fitted=refused, held_out=0.0)
    steps = [Step(before, (), (), own), Step(before, (), (third,), None)]
    others = [("hardening_spring", own), *rivals.items()]
    return Outcome(own, steps, None, {"hardening_spring": others})


NEAR, FAR = judged(-5.0, np.ones(100), "overflow", "outflow"), judged(-40.0, np.ones(100), "spill")


def test_a_near_rival_is_another_way_where_something_is_left():
    assert search.forks(outcome(60.0, outflow=NEAR)) == [("hardening_spring", NEAR)]
    assert search.forks(outcome(60.0, outflow=NEAR, spill=FAR)) == [("hardening_spring", NEAR)]


def test_no_other_way_where_nothing_is_left_or_the_rival_says_the_same():
    assert search.forks(outcome(10.0, outflow=NEAR)) == []
    same = judged(-5.0, np.zeros(100), "overflow", "outflow")
    assert search.forks(outcome(60.0, outflow=same)) == []


FALLING = {"coulomb_level": 3.0, "static_level": 5.0, "stribeck_velocity": 0.05}


@pytest.mark.parametrize(
    ("name", "values", "credible"),
    [
        ("flexible_mode", {"frequency": 60.0, "damping": 0.02, "mass_fraction": 0.1}, True),
        ("flexible_mode", {"frequency": 60.0, "damping": 1.0, "mass_fraction": 0.7}, False),
        ("stribeck_friction", FALLING, True),
        ("stribeck_friction", FALLING | {"coulomb_level": 0.0}, False),
        ("stribeck_friction", FALLING | {"stribeck_velocity": 0.3}, False),
        ("drift", {"amplitude": 1.0, "time_constant": 2.0}, True),
        ("drift", {"amplitude": 1.0, "time_constant": 0.01}, False),
        ("drift", {"amplitude": 1.0, "time_constant": 20.0}, True),
        ("drift sine", {"amplitude": 1.0, "time_constant": 6.0}, True),
        ("drift sine", {"amplitude": 1.0, "time_constant": 20.0}, False),
        ("constant_load", {"force": 1.0}, True),
        ("cogging", {"amplitude": 1.0, "period": 0.19}, True),
        ("cogging", {"amplitude": 1.0, "period": 0.21}, False),
    ],
)
def test_numbers_of_the_physics_that_an_effect_is_named_for(name, values, credible):
    name, *kind = name.split()
    spec = EffectSpec(name, values, {"kind": kind[0]} if kind else {})
    assert EFFECTS[name].credible(spec, Extent(8.0, 0.3, 0.3, 0.5)) is credible


def test_what_a_process_leaves_is_no_noise_to_be_heard_anew():
    """The cascaded tanks lost overflow, bend and outflow to noise that was heard too low beside a clip."""
    process = SimpleNamespace(model=SimpleNamespace(base=SimpleNamespace(is_process=True)))
    assert not hearing.quieter(None, process)


@pytest.mark.parametrize(("level", "credible"), [(0.0116, False), (0.0127, True), (0.013, True)])
def test_a_scale_that_ends_shows_nothing_beyond(level, credible):
    """A curved scale was told as one that ends at 11.6 mm, with samples up to 12.8 mm; noise counts for
    nothing."""
    spec = EffectSpec("sensor_nonlinearity", {"kind": "clipping", "level": level})
    y = np.full(2000, 0.0128) + 1e-4 * np.random.default_rng(0).standard_normal(2000)
    trial = Trial("a", 0.0, 1e-3, y, y, None, y, y, y, y, True, None)
    assert trial.largest == pytest.approx(0.0128, rel=0.02)
    assert EFFECTS[spec.name].credible(spec, Extent(8.0, 0.3, trial.largest)) is credible


def test_the_mass_of_a_machine_that_has_only_one_is_not_its_own_rival(stage, brief, scenes):
    _, _, model = scenes(brief(stage))
    assert mass_is_corrected(model)
    assert not mass_is_corrected(replace(model, held=frozenset({"mass"})))


RIPPLE = EffectSpec("encoder_ripple", {"amplitude": 2e-6, "period": 4e-3, "phase": 0.0})


@pytest.mark.parametrize(("size", "kept"), [(1.0, True), (1e4, True), (0.0, False)])
def test_noise_louder_than_all_that_is_left_counts_for_as_much_less(
    stage, brief, scenes, monkeypatch, size, kept
):
    """A saturated loop that goes unstable parts from itself by any amount; what looks like the rival itself
    (size 0) refuses it."""
    scene, held, model = scenes(brief(replace(stage, effects=(FRICTION, RIPPLE))))
    base = judge(scene, held, replace(model, effects=(FRICTION,)), 4)
    rival = judge(scene, held, replace(model, effects=(FRICTION, RIPPLE)), 4)
    monkeypatch.setattr(unrest, "HALF", 0.0)
    rng = np.random.default_rng(0)
    loop = stage.loop.process_sensitivity
    alike = [loop.filter(2e-3 * size * rng.standard_normal(len(t))) for t in scene.trials]
    if not size:
        left = (one.simulate for one in (base.model, rival.model))
        alike = [a.y - b.y for a, b in zip(*(map(run, scene.trials) for run in left), strict=True)]
    draws = [SimpleNamespace(y=alike)]
    monkeypatch.setattr(unrest, "imitated", lambda *_: draws)
    assert unrest.louder_than_noise(base, [rival]) == ([rival] if kept else [])


@pytest.mark.slow(15)
def test_who_dropped_out_makes_room(stage, brief, scenes, monkeypatch):
    """A set of two, one of which the company of the other makes superfluous, of two that may join. The way
    there hangs on a processor's rounding: it may lead over a Stribeck curve that ends flat, which is the
    same friction, or over one for whose misfit a sine comes in."""
    scene, held, model = scenes(brief(replace(stage, effects=(FRICTION, SPRING))))
    real, begun = search._round, []

    def first_a_set(quiet, held, base, views, taken, room, threshold, say):  # type: ignore[no-untyped-def]
        if begun:
            return real(quiet, held, base, views, taken, room, threshold, say)
        begun.append(base)
        idle = EffectSpec("input_delay", {"delay": 1e-9})
        both = judge(quiet, held, replace(base.model, effects=(FRICTION, idle)), 1)
        return Step(base, (), (), both)

    monkeypatch.setattr(search, "_round", first_a_set)
    outcome = search.contest(scene, held, model, THRESHOLD, most=2)
    beside = friction_and_spring(outcome.standing.model)
    assert beside <= {"periodic_disturbance"}


def test_what_another_way_found_when_enough_was_tried_is_not_lost(
    stage, brief, scenes, monkeypatch
):
    scene, held, model = scenes(brief(replace(stage, effects=(FRICTION,))))
    spent = replace(scene, work=Work(MOST))
    found = judge(spent, held, model.with_effect(FRICTION), 4)
    monkeypatch.setattr(search, "two_for_two", lambda *_: found)
    outcome = search.contest(spent, held, model, THRESHOLD)
    assert not any(step.accepted for step in outcome.steps)
    assert outcome.standing is found

"""A recording of a sister machine among those of another is told by its name and its own numbers."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnosis
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.ground import Comparison, ground_of
from ffl.diagnose.other_machine import of_another_machine
from ffl.machines import SimulatedMachine
from ffl.systems import EffectSpec


def rubs(level):  # type: ignore[no-untyped-def]
    return EffectSpec("coulomb_friction", {"level": level})


@pytest.fixture(scope="module")
def sister(stage):  # type: ignore[no-untyped-def]
    """The stage with 37 % more mass and 8 N of friction."""
    heavier = replace(stage.system, gain=stage.system.gain / 1.37)
    return replace(stage, system=heavier, effects=(rubs(8.0),))


@pytest.fixture(scope="module")
def made(references):  # type: ignore[no-untyped-def]
    """Recording k of a machine: two of the same moves, one of others, in the same place."""
    paths = [references[0], references[0], 0.8 * references[1]]

    def of(machine, k, path=None):  # type: ignore[no-untyped-def]
        path = paths[k] if path is None else path
        run = SimulatedMachine(machine).run(path, np.zeros_like(path), np.random.default_rng(k))
        return replace(run, source=f"run_{k}.csv")

    return of


@pytest.fixture(scope="module")
def runs(stage, sister, made):  # type: ignore[no-untyped-def]
    """Recordings of the stage with 3 N of friction, and of its sister."""
    machines = (replace(stage, effects=(rubs(3.0),)), sister)
    return [[made(machine, k) for k in range(3)] for machine in machines]


def asked(stage, fitted, judging, stands=None):  # type: ignore[no-untyped-def]
    ground = ground_of(Comparison(stage, fitted, judging), [], lambda line: None)
    told = ground.told if stands is None else ground.told.with_effect(stands)
    return of_another_machine(ground, judge(ground.scene, ground.held, told))


@pytest.mark.parametrize("odd", [0, 1, 2])
@pytest.mark.parametrize("stands", [None, rubs(3.0)])
def test_the_one_of_a_sister_machine_is_told_with_both_numbers(runs, stage, odd, stands):
    mine, other = runs
    three = [other[k] if k == odd else mine[k] for k in range(3)]
    fault = asked(stage, three[:2], three[2:], stands)
    assert (fault.kind, fault.recording) == ("machine", f"run_{odd}.csv")
    said = f"run_{odd}.csv by itself asks for mass +37.0 % and coulomb_friction level 8 N, where the others"
    assert said in fault.mend
    assert re.search(r"ask for \+0\.0 % and (3|2\.99) N, and each is then explained", fault.mend)
    assert ("judge by a recording of the one" if odd == 2 else "leave it out") in fault.mend


def test_of_two_recordings_it_is_told_that_they_differ(runs, stage):
    fault = asked(stage, runs[0][:1], runs[1][2:])
    assert (
        "these two are not of one machine: run_2.csv by itself asks for mass +37.0 %" in fault.mend
    )
    assert re.search(r"where run_0.csv asks for \+0\.0 % and (3|2\.99) N", fault.mend)


def test_one_machine_is_one_whatever_stands(runs, stage):
    """Also where 3 N were left out altogether, of three recordings and of two."""
    for fitted in (runs[0][:2], runs[0][:1]):
        assert asked(stage, fitted, runs[0][2:]) is None


@pytest.mark.parametrize(
    "missing",
    [
        EffectSpec("drift", {"amplitude": 6.0, "time_constant": 1.0}),
        EffectSpec(
            "stribeck_friction",
            {"coulomb_level": 3.0, "static_level": 6.0, "stribeck_velocity": 0.02},
        ),
        EffectSpec("linear_stiffness", {"stiffness": 300.0, "centre": 0.0}),
    ],
)
def test_physics_that_no_constant_numbers_explain_is_none(made, runs, stage, missing):
    """In the recording that judges alone, as in all."""
    machine = replace(stage, effects=(rubs(3.0), missing))
    own = [made(machine, k) for k in range(3)]
    assert asked(stage, runs[0][:2], own[2:], rubs(3.0)) is None
    assert asked(stage, own[:2], own[2:], rubs(3.0)) is None


def test_nothing_is_said_of_a_recording_that_went_elsewhere(runs, stage):
    """What differs there may depend on the place."""
    mine, other = runs
    away = replace(other[2], y=other[2].y + 0.2, r=other[2].r + 0.2)
    assert asked(stage, mine[:2], [away], rubs(3.0)) is None


def test_nor_of_one_that_moved_twice_as_fast(runs, stage, sister, made, references):
    """What differs there may depend on the speed, or on the force."""
    faster = made(sister, 2, references[0][::2])
    assert asked(stage, runs[0][:2], [faster], rubs(3.0)) is None


def test_nor_of_numbers_that_are_hardly_others(runs, stage, made):
    """3 % more mass and 0.2 N, each by hundreds of standard errors, are within what one machine does."""
    heavier = replace(stage.system, gain=stage.system.gain / 1.03)
    slightly = made(replace(stage, system=heavier, effects=(rubs(3.2),)), 2)
    assert asked(stage, runs[0][:2], [slightly], rubs(3.0)) is None


def test_the_answer_is_inconclusive_and_names_the_recording(runs, stage, monkeypatch):
    def contested(ground, *_):  # type: ignore[no-untyped-def]
        stands = ground.told.with_effect(rubs(3.0))
        return Outcome(judge(ground.scene, ground.held, stands), [], None, {})

    monkeypatch.setattr(diagnosis, "_contested", contested)
    mine, other = runs
    answer = diagnosis.diagnose(stage, mine[:2], other[2:], rng=np.random.default_rng(0))
    assert answer.verdict == "inconclusive"
    assert (answer.place.component, answer.findings) == ("plant", ())
    assert answer.place.where.startswith("run_2.csv: ")
    assert "run_2.csv by itself asks for mass +37.0 %" in answer.advice[0]

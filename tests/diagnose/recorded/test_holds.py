"""A servo axis whose controller integrates while friction holds it: each move is by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.recorded.holds import HELD, holds, moves
from ffl.diagnose.recorded.trials import prepared
from ffl.machines import SimulatedMachine, Simulator
from ffl.systems import Controller, Move, Physics, Plant, Zpk
from ffl.systems import moves as path_of
from ffl.systems.plant import EffectSpec, Imperfections

STEP, MASS, DRY = 0.001, 5.0, 4.0


@pytest.fixture(scope="module")
def axis() -> Plant:
    """5 kg under a PID controller, its encoder 0.1 um a count."""
    system = Zpk([-1.0], [1.0, 1.0], STEP**2 / (2 * MASS), STEP)
    w = 2 * np.pi * 10.0
    zeros = [np.exp(-0.3 * w * STEP), np.exp(-0.5 * w * STEP)]
    shape = Zpk(zeros, [1.0, np.exp(-5.0 * w * STEP)], 1.0, STEP)
    size = abs(shape.response([10.0])[0] / (MASS * w**2))
    controller = Controller.of_error(replace(shape, gain=1.0 / size))
    return Plant(
        "axis", system, controller, "N", "m", "made here", Physics(MASS, 1.0),
        Imperfections(1e-7, 3e-7, 2e-2, None),
    )  # fmt: skip


@pytest.fixture(scope="module")
def recorded(axis):  # type: ignore[no-untyped-def]
    """Moves with a pause of 1.5 s, with friction and without, (fit, validation) each."""

    def run(*effects: EffectSpec):  # type: ignore[no-untyped-def]
        machine, out = SimulatedMachine(replace(axis, effects=effects)), []
        for seed, sign in ((1, 1.0), (2, -1.0)):
            steps = [
                Move(at, sign * way, 0.5, 8.0, 800.0)
                for at, way in ((0.2, 0.1), (0.7, -0.06), (1.1, 0.08), (3.0, -0.09), (3.5, 0.05))
            ]
            r = path_of(steps, 5.5, STEP)
            out.append(machine.run(r, np.zeros_like(r), np.random.default_rng(seed)))
        return out

    return run


def test_a_wound_up_hold_is_found_and_a_quiet_one_is_not(axis, recorded):
    found = holds(recorded(EffectSpec("coulomb_friction", {"level": DRY}))[0])
    assert len(found) == 2
    assert 1.2 < STEP * found[0][0] < 2.0 < 2.9 < STEP * found[0][1] < 3.05
    assert [holds(r) for r in recorded()] == [[], []]
    (whole,) = moves(replace(axis, controller=None), recorded()[0])
    assert len(whole) == len(recorded()[0])


def test_each_piece_begins_where_the_machine_stood_with_the_controller_as_it_was(axis, recorded):
    friction = EffectSpec("coulomb_friction", {"level": DRY})
    whole = recorded(friction)[0]
    pieces = moves(axis, whole)
    assert len(pieces) == 2
    trials = prepared(Simulator(axis), pieces, 3e-7)
    assert [t.goes_on for t in trials] == [False, True]
    assert all(t.at_rest for t in trials)
    machine = Simulator(replace(axis, machine=Imperfections()))
    for trial in trials:
        run = machine.run((friction,), trial.reference, trial.feedforward, start=trial.start)
        assert np.std(trial.y - run.y) < 2e-6  # the whole run parts by more than that at rest
        assert np.std(trial.u - run.u) < 0.1 * DRY


@pytest.mark.slow(30)
def test_friction_is_named_and_nothing_else(axis, recorded):
    fit, judging = recorded(EffectSpec("coulomb_friction", {"level": DRY}))
    stated = replace(axis, machine=Imperfections())
    found = diagnose(stated, [fit], [judging])
    answer = found.answer()
    (effect,) = answer["effects"]
    assert answer["verdict"] == "explained"
    assert effect["name"] == "coulomb_friction"
    assert effect["parameters"]["level"]["value"] == pytest.approx(DRY, rel=0.02)
    assert HELD in found.notes

"""A play that was named by prediction, off by a factor: free runs that follow the machine mend it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.predict import freely
from ffl.diagnose.predict.freely import with_free_runs
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.systems import EffectSpec, Imperfections, Move, moves
from ffl.systems.plant_file import plant_from_dict

STEP, GAP, NOISE = 0.001, 6e-5, Noise(1e-7, 0.3)
DRY = EffectSpec("coulomb_friction", {"level": 45.0}, {"side": "load"})
COUPLING = {"kind": "coupling", "damping": 0.02}


@pytest.fixture(scope="module")
def screw():
    """60 kg at the motor, which is measured, 90 kg on the table, 118 Hz between them."""
    return plant_from_dict(
        {
            "name": "ball screw",
            "sample_time": STEP,
            "units": {"input": "N", "output": "m"},
            "plant": {
                "form": "czpk",
                "zeros": [[-5.0, 471.4], [-5.0, -471.4]],
                "poles": [-2.0, -0.0, [-8.0, 745.3], [-8.0, -745.3]],
                "gain": 1.0 / 60.0,
            },
            "controller": {"form": "zpk", "zeros": [0.98], "poles": [0.6], "gain": 4e6},
            "physics": {"mass": 150.0, "motor_constant": 1.0, "load_mass": 90.0},
        }
    )


def scenes(screw):  # type: ignore[no-untyped-def]
    play = EffectSpec("backlash", {"gap": GAP}, COUPLING)
    machine = replace(screw, effects=(DRY, play), machine=Imperfections(0.0, 1e-7, 0.3))
    out = []
    for seed, signs in enumerate(((1, -1, 1), (-1, 1, -1))):
        path = [Move(0.1 + 0.5 * k, 0.02 * s, 0.1, 2.0, 100.0) for k, s in enumerate(signs)]
        run = SimulatedMachine(machine).run(
            moves(path, 1.8, STEP), None, np.random.default_rng(seed)
        )
        out.append(prepare(Base.of(screw).simulator, run, 1e-7))
    scene = Scene(screw.loop, out[:1], NOISE)  # type: ignore[arg-type]
    return replace(scene, trials=(out[0],)), replace(scene, trials=(out[1],))


def test_free_runs_mend_a_gap(screw, monkeypatch):  # type: ignore[no-untyped-def]
    scene, held = scenes(screw)
    wide = EffectSpec("backlash", {"gap": 3.6 * GAP}, COUPLING)
    off = judge(scene, held, Model(Base.of(screw), effects=(DRY, wide)), 0)
    told = replace(off, predicted=True)
    outcome = Outcome(told, [], held, {})
    monkeypatch.setattr(
        freely, "go_on", lambda scene, held, best, threshold, say: Outcome(best, [], held, {})
    )
    found = with_free_runs(scene, held, outcome, NOISE, 25.0, lambda line: None).standing
    assert not found.predicted
    assert found.model.effects[1].parameters["gap"] == pytest.approx(GAP, rel=0.02)
    # What prediction makes likelier than any free run stands.
    likelier = Outcome(replace(told, fitted=found.fitted + 1e4), [], held, {})
    assert with_free_runs(scene, held, likelier, NOISE, 25.0, lambda line: None) is likelier
    # Nor is anything tried beside what free runs named.
    named = Outcome(off, [], held, {})
    assert with_free_runs(scene, held, named, NOISE, 25.0, lambda line: None) is named

"""Masses that share a motion otherwise than the plant file has it are no mode that is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.shares import shares_off
from ffl.diagnose.hypothesis.linear import corrected, discrete
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.machines.simulator import Simulator
from ffl.systems.plant import EffectSpec

MODE = EffectSpec("flexible_mode", {"frequency": 80.0, "damping": 0.02, "mass_fraction": 0.05})


def modal_residues(plant, share):
    """By pole."""
    system = discrete(corrected(Simulator(plant).mechanics, {"mode_1_share": share}))
    poles, vectors = np.linalg.eig(system.a)
    order = np.argsort(np.abs(poles.imag) + 1e-3 * poles.imag)
    out = (system.c.ravel() @ vectors) * np.linalg.solve(vectors, system.b.ravel())
    return poles[order], out[order]


def test_a_share_is_that_of_its_mode_alone(two_masses):
    poles, before = modal_residues(two_masses, 0.0)
    moved, after = modal_residues(two_masses, 0.1)
    assert np.allclose(poles, moved, atol=1e-9)
    times = np.where(np.abs(poles.imag) > 0.1, 1.1, 1.0)
    assert np.allclose(after[2:], (times * before)[2:], rtol=1e-6)
    assert after[:2].sum() == pytest.approx(before[:2].sum(), rel=1e-6)


def test_it_is_free_only_where_it_is_asked_for(two_masses):
    model = Model(Base.of(two_masses))
    assert "mode_1_share" not in {c.name for c in model.coordinates}
    asked = replace(model, corrections={"mode_1_share": 0.0})
    assert "mode_1_share" in {c.name for c in asked.coordinates}


def recordings(plant, references, push=0.3):
    """Moves, and a push of that many A beside them."""
    rng = np.random.default_rng(3)
    device = SimulatedMachine(plant)
    paths = (*references, 0.7 * references[0])
    shaken = [push * rng.standard_normal(len(path)) for path in paths]
    return [device.run(path, push, rng) for path, push in zip(paths, shaken, strict=True)]


@pytest.mark.parametrize(("share", "push"), [(0.035, 0.3), (0.035, 1.5), (-0.03, 1.5)])
def test_zeros_that_are_off_are_no_mode_and_no_mass(two_masses, references, share, push):
    """(Without the shares: a mode at 33 Hz, 2 % less mass, and something that has no name.)"""
    mechanics = Simulator(two_masses).mechanics
    system = discrete(corrected(mechanics, {"mode_1_share": share}))
    *fitted, judging = recordings(replace(two_masses, system=system), references, push)
    answer = diagnose(two_masses, fitted, [judging]).answer()
    assert answer["verdict"] == "nothing_missing"
    told = {c["name"]: c["relative"] for c in answer["model_corrections"]}
    assert told["mode_1_share"] == pytest.approx(share, abs=0.006)


def test_a_mode_that_is_there_stays(two_masses, references):
    runs = recordings(replace(two_masses, effects=(MODE,)), references)
    base = Base.of(two_masses)
    noise = Noise(1e-6, 0.01)
    trials = [prepare(base.simulator, r, 1e-6) for r in runs]
    scene, held = (Scene(two_masses.loop, tuple(t), noise) for t in (trials[:2], trials[2:]))
    standing = judge(scene, held, replace(Model(base), effects=(MODE,)), 6)
    assert shares_off(scene, held, standing, lambda line: None) is None

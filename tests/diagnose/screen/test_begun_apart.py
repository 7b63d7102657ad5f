"""What is screened where recordings say nothing of when one began after another."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.screen.clocks import apart, begun_apart
from ffl.diagnose.screen.screen import Screen
from ffl.machines import SimulatedMachine
from ffl.systems.plant import EffectSpec


def test_a_settling_may_show_any_later_part_of_itself_in_a_later_recording():
    e = np.exp(-np.arange(4.0))[:, None]
    first, on, other = begun_apart([1.0 - e, 1.0 - e, 1.0 - e], [False, True, False], 1.0)
    assert np.allclose(first @ [2.0, 0.7], 2.0 * (1.0 - e[:, 0]))  # the first is as its clock says
    assert np.allclose(on, first)  # a further piece of the same recording
    later = 2.0 * (1.0 - 0.3 * e[:, 0])  # begun when 0.3 of it was left
    assert np.allclose(other @ [2.0, 2.0 * 0.7], later)


def test_columns_of_their_own():
    assert np.array_equal(
        apart(np.array([[1.0], [2.0], [3.0]]), [1, 2]), [[1.0, 0.0], [0.0, 2.0], [0.0, 3.0]]
    )


def test_a_drift_is_seen_whole_though_a_recording_began_in_the_middle_of_it(
    stage, references, scenes
):
    """One curve for both leaves 8.5 % of the squares, and this 0.2 %."""
    tau, amplitude = 1.5, 3.0
    passed = 1.0 - np.exp(-3.0 / tau)  # 3 s later
    cold = (EffectSpec("drift", {"amplitude": amplitude, "time_constant": tau}),)
    warmer = (
        EffectSpec("drift", {"amplitude": amplitude * (1.0 - passed), "time_constant": tau}),
        EffectSpec("constant_load", {"force": amplitude * passed}),
    )
    runs = [
        SimulatedMachine(replace(stage, effects=own)).run(
            references[0], np.zeros_like(references[0]), np.random.default_rng(k)
        )
        for k, own in enumerate((cold, warmer))
    ]
    first, other, model = scenes(runs)
    both = replace(first, trials=(*first.trials, *other.trials), free_clocks=True)
    screen = Screen(both, fit(both, model, rounds=0))
    (found,) = screen.candidates(["drift"])
    whole = float(np.sum(screen.residual**2))
    assert found.spec.parameters["amplitude"] == pytest.approx(amplitude, rel=0.2)  # on a grid
    shared = Screen(replace(both, free_clocks=False), screen.fit).candidates(["drift"])
    assert whole - found.gain < 0.1 * (whole - max(c.gain for c in shared))

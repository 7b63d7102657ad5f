"""Harmonics of a cogging that are there, and that are not."""

from dataclasses import replace

import pytest

from ffl.diagnose.contest.judging import judge
from ffl.diagnose.hypothesis.harmonics import without_faint
from ffl.systems.plant import EffectSpec

PURE = {"amplitude": 3.0, "period": 0.0213, "phase": 0.4}


@pytest.mark.parametrize("second", [0.0, 0.8])
def test_a_harmonic_of_nothing_goes_and_one_that_is_there_stays(stage, record, scenes, second):
    both = {**PURE, "amplitude_2": second, "phase_2": 1.1}
    machine = EffectSpec("cogging", both if second else PURE)
    scene, held, model = scenes(record(replace(stage, effects=(machine,))))
    begun = EffectSpec("cogging", {**both, "amplitude_2": second or 1e-3})
    judged = judge(scene, held, model.with_effect(begun), 10)
    found = without_faint(held, judged).model.effects[0].parameters
    assert ("amplitude_2" in found) is bool(second)
    assert found["amplitude"] == pytest.approx(3.0, rel=0.01)

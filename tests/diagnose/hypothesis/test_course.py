"""A slow force whose course the fitted recording does not tell: what judges later does."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose.contest.judging import judge
from ffl.diagnose.hypothesis import course
from ffl.diagnose.hypothesis.course import courses, other_courses
from ffl.effects import EFFECTS, Motion
from ffl.systems.plant import EffectSpec

TRUE = EffectSpec("drift", {"amplitude": 3.0, "time_constant": 4.0})
TAKEN = EffectSpec("drift", {"amplitude": 1.8, "time_constant": 15.0}, {"kind": "sine"})
LATER = 20.0  # s


@pytest.fixture(scope="module")
def scene_and_held(stage, record, scenes):
    scene, held, model = scenes(record(stage))
    rng, machine = np.random.default_rng(0), model.with_effect(TRUE)

    def recorded(trial):
        noise = stage.machine.sensor_noise * rng.standard_normal(len(trial))
        return replace(trial, y=machine.simulate(trial).y + noise)

    late = tuple(recorded(replace(trial, start_time=LATER)) for trial in held.trials)
    return (
        replace(scene, trials=tuple(map(recorded, scene.trials))),
        replace(held, trials=late),
        model,
    )


def test_the_kind_that_holds_later_on_the_same_clock(scene_and_held):
    scene, held, model = scene_and_held
    sine = judge(scene, held, model.with_effect(TAKEN), 8)
    others = {o.model.effects[-1].options["kind"]: o for o in other_courses(scene, held, sine)}
    assert set(others) == {"exponential", "ramp"}
    settling = others["exponential"]
    assert settling.held_out > max(sine.held_out, others["ramp"].held_out)
    values = settling.model.effects[-1].parameters
    assert values["amplitude"] == pytest.approx(3.0, rel=0.05)
    assert values["time_constant"] == pytest.approx(4.0, rel=0.05)


def test_a_drift_that_does_little_is_not_looked_at_again(scene_and_held):
    scene, held, model = scene_and_held
    base, sine = judge(scene, held, model), judge(scene, held, model.with_effect(TAKEN), 8)
    assert courses(scene, held, base, [sine])
    assert not courses(scene, held, sine, [sine])
    load = model.with_effect(EffectSpec("constant_load", {"force": 1.0}))
    assert not courses(scene, held, base, [judge(scene, held, load)])


def test_the_force_of_a_drift_is_that_of_its_kind():
    t = np.linspace(0.0, 5.0, 6)
    zero = np.zeros(6)
    motion = Motion(t, zero, zero, zero, zero, zero, 1.0)
    sine = EFFECTS["drift"].signal(TAKEN, motion)
    np.testing.assert_allclose(sine, 1.8 * np.sin(2 * np.pi * t / 15.0))


@pytest.mark.parametrize(("beside", "again"), [((), True), ((TRUE,), False)])
def test_beside_effects_its_other_kinds_must_be_able_to_earn_a_place(monkeypatch, beside, again):
    """They do much the same in the fitted recordings: 25 is no place beside others in 40,000 samples."""
    monkeypatch.setattr(course, "other_courses", lambda quiet, held, best: [best])
    fit = SimpleNamespace(white=np.zeros(40_000))
    base = SimpleNamespace(fitted=0.0, fit=fit, model=SimpleNamespace(effects=beside))
    slow = SimpleNamespace(fitted=25.0, model=SimpleNamespace(names=("drift",)))
    assert courses(None, None, base, [slow]) == ([slow] if again else [])

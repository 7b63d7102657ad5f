"""Recordings whose clocks overlap: what belongs to a time of its own in each of them."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.recorded.starts import with_clocks
from ffl.machines import SimulatedMachine
from ffl.systems.plant import EffectSpec


@pytest.mark.slow(20)
@pytest.mark.usefixtures("no_play_sought")
def test_a_drift_that_only_the_first_recording_shows_from_its_beginning_is_named(stage, references):
    """The machine warms up in the first recording and is warm in the others; every clock begins at 0."""

    def run(effect, reference, seed):
        machine = SimulatedMachine(replace(stage, effects=(effect,)))
        return machine.run(reference, np.zeros_like(reference), np.random.default_rng(seed))

    cold = EffectSpec("drift", {"amplitude": 3.0, "time_constant": 1.5})
    warm = EffectSpec("constant_load", {"force": 3.0})
    first = run(cold, references[0], 0)
    later = [run(warm, r, 1 + k) for k, r in enumerate(references)]
    found = diagnose(stage, [first, later[0]], later[1:]).answer()
    (effect,) = found["effects"]
    assert found["verdict"] == "explained"
    assert effect["name"] == "drift"
    assert effect["parameters"]["amplitude"]["value"] == pytest.approx(3.0, rel=0.02)
    assert effect["parameters"]["time_constant"]["value"] == pytest.approx(1.5, rel=0.05)


def test_a_load_that_is_always_there_is_no_drift(stage, references):
    machine = SimulatedMachine(
        replace(stage, effects=(EffectSpec("constant_load", {"force": 3.0}),))
    )
    records = [
        machine.run(r, np.zeros_like(r), np.random.default_rng(k))
        for k, r in enumerate((*references, references[0]))
    ]
    found = diagnose(stage, records[:2], records[2:]).answer()
    assert [e["name"] for e in found["effects"]] == ["constant_load"]


def test_a_drift_and_a_fan_have_one_clock_in_each_recording(stage, references, scenes):
    """Warmer by what has passed, and the fan in a phase of its own: to half a turn of it both fit."""
    drift = EffectSpec("drift", {"amplitude": 3.0, "time_constant": 4.0})
    fan = {"frequency": 11.0, "amplitude": 1.0, "phase": 0.4}
    later = {"amplitude": 3.0 * np.exp(-0.25), "time_constant": 4.0}  # what 1 s has left of it
    effects = [
        (drift, EffectSpec("periodic_disturbance", fan)),
        (
            EffectSpec("drift", later),
            EffectSpec("periodic_disturbance", fan | {"phase": 2.0}),
            EffectSpec("constant_load", {"force": 3.0 * (1.0 - np.exp(-0.25))}),
        ),
    ]
    runs = [
        SimulatedMachine(replace(stage, effects=own)).run(
            references[0], np.zeros_like(references[0]), np.random.default_rng(k)
        )
        for k, own in enumerate(effects)
    ]
    first, other, model = scenes(runs)
    both = replace(first, trials=(*first.trials, *other.trials), free_clocks=True)
    model = replace(model, effects=effects[0])
    set_ = with_clocks(both, model, 1)
    assert set_.trials[0].start_time == both.trials[0].start_time
    assert set_.trials[1].start_time == pytest.approx(1.0, abs=0.6 / fan["frequency"])
    turned = 2 * np.pi * fan["frequency"] * set_.trials[1].start_time + fan["phase"]
    assert np.angle(np.exp(1j * (turned - 2.0))) == pytest.approx(0.0, abs=0.05)
    assert set_.cost(model) < 1.5 * both.samples < 1e-2 * both.cost(model)
    # The same where the plant file states both: its phases belong to no recording here.
    stated = replace(model, effects=(), given=effects[0])
    again = with_clocks(both, stated, 1)
    assert again.cost(stated) < 1.5 * both.samples < 1e-2 * both.cost(stated)

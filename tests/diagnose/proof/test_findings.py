"""Numbers as they are told: of a part on a spring the resonance that the machine has, with its error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.noise.spread import error_of, errors_through
from ffl.diagnose.proof.findings import finding
from ffl.diagnose.recorded.trials import prepare
from ffl.effects.linear_mechanics import mechanics_with_effects
from ffl.effects.resonance import resonance_of
from ffl.machines import SimulatedMachine
from ffl.systems.plant import EffectSpec

PART = {"frequency": 75.0, "damping": 0.02, "mass_fraction": 0.1}
MODE = EffectSpec("flexible_mode", PART, {"side": "motor"})
PUSH = 0.3  # A


@pytest.fixture(scope="module")
def found(two_masses, references):
    """Judged: a part on a stage of two masses."""
    rng = np.random.default_rng(3)
    machine, path = SimulatedMachine(replace(two_masses, effects=(MODE,))), references[0]
    recording = machine.run(path, PUSH * rng.standard_normal(len(path)), rng)
    base = Base.of(two_masses)
    trial = prepare(base.simulator, recording, two_masses.machine.sensor_noise)
    noise = Noise(two_masses.machine.sensor_noise, two_masses.machine.force_noise)
    return judge(Scene(two_masses.loop, (trial,), noise), None, Model(base).with_effect(MODE), 10)


def test_a_part_is_told_by_the_resonance_of_the_machine(found, two_masses):
    whole = mechanics_with_effects(replace(two_masses, effects=(MODE,)))
    right = resonance_of(whole.a, whole.point(MODE.name))
    told = finding(found, 0, Outcome(found, [], None, {}), two_masses, 0.0)
    assert told.options["resonance"] == "machine"
    for name, true in zip(("frequency", "damping"), right, strict=True):
        number = told.parameters[name]
        assert abs(number.value - true) < 4.0 * number.std_error
        assert 5.0 * number.std_error < abs(true - PART[name])  # the part by itself is far from it
    assert f"{told.parameters['frequency'].value:.4g} Hz" in told.says
    assert told.parameters["mass_fraction"].std_error == error_of(found, 0, "mass_fraction")


def test_errors_of_what_follows_from_the_numbers(found):
    """Of the numbers themselves, of sums and of multiples of them."""
    model, covariance = found.model, found.fit.covariance
    assert errors_through(found, lambda m: m.theta) == pytest.approx(found.spread, rel=1e-6)
    more = found.spread / found.fit.spread
    two = (covariance * np.outer(more, more))[-2:, -2:]
    both = errors_through(found, lambda m: np.array([3.0 * m.theta[-1], m.theta[-1] + m.theta[-2]]))
    assert both == pytest.approx([3.0 * found.spread[-1], np.sqrt(two.sum())], rel=1e-6)
    one_sided = errors_through(found, lambda m: None if m.theta[-1] > model.theta[-1] else m.theta)
    assert one_sided == pytest.approx(found.spread, rel=1e-6)


def drifting(stage, references, drift):  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(5)
    machine = SimulatedMachine(replace(stage, effects=(drift,)))
    recording = machine.run(references[0], PUSH * rng.standard_normal(len(references[0])), rng)
    base = Base.of(stage)
    trial = prepare(base.simulator, recording, stage.machine.sensor_noise)
    noise = Noise(stage.machine.sensor_noise, stage.machine.force_noise)
    found = judge(Scene(stage.loop, (trial,), noise), None, Model(base).with_effect(drift), 10)
    return finding(found, 0, Outcome(found, [], None, {}), stage, 0.0)


@pytest.mark.parametrize(
    ("kind", "lasts"), [("ramp", 3.0), ("exponential", 3000.0), ("exponential", 0.5)]
)
def test_of_a_drift_that_does_not_end_the_slope_is_told(stage, references, kind, lasts):
    """Amplitude and time constant apart are nobody's to know; of one that settles they are told."""
    told = drifting(
        stage,
        references,
        EffectSpec("drift", {"amplitude": -2.0 * lasts, "time_constant": lasts}, {"kind": kind}),
    )
    amplitude, constant = told.parameters["amplitude"], told.parameters["time_constant"]
    if lasts < 1.0:
        assert constant.std_error is not None
        assert "drifts by" in told.says
        return
    assert constant.std_error is None
    assert "only amplitude/time_constant" in constant.note
    slope, error = amplitude.value / constant.value, amplitude.std_error / constant.value
    assert 0.0 < error < 0.2
    assert slope == pytest.approx(-2.0, abs=4.0 * error)
    assert f"± {error:.2g} " in told.says
    assert "/s all through" in told.says

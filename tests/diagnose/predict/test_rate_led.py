"""A drive whose rate is limited is named where the controller is unknown and the plant integrates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.predict.as_sent import is_drive
from ffl.effects import EFFECTS
from ffl.machines import SimulatedMachine
from ffl.systems import EffectSpec
from ffl.systems.plant_file import plant_from_dict


@pytest.mark.parametrize("name", ["slew_limit", "saturation", "input_delay", "coulomb_friction"])
def test_who_is_of_the_drive(name):
    bends = name == "saturation"
    assert is_drive(EFFECTS[name], observed=False) == bends
    assert is_drive(EFFECTS[name], observed=True) == (bends or name == "slew_limit")


@pytest.fixture(scope="module")
def ship():  # type: ignore[no-untyped-def]
    """Heading under a rudder and a lead that crosses at 0.03 Hz, whose command is full of noise."""
    step, crossing = 0.1, 0.03
    zero, pole = (float(np.exp(-2.0 * np.pi * f * crossing * step)) for f in (1 / 3, 3.0))
    file = {
        "name": "ship",
        "sample_time": step,
        "units": {"input": "deg", "output": "deg"},
        "plant": {"form": "czpk", "zeros": [], "poles": [0.0, -1 / 12.0], "gain": 0.005},
        "controller": {"form": "zpk", "zeros": [zero], "poles": [pole], "gain": 1.0},
        "machine": {"sensor_noise": 0.02, "encoder_resolution": 0.01, "force_noise": 0.15},
    }
    lead = plant_from_dict(file).loop
    gain = abs(lead.plant.response([crossing])[0] * lead.controller.output.response([crossing])[0])
    return plant_from_dict({**file, "controller": {**file["controller"], "gain": float(1 / gain)}})


@pytest.mark.slow(10)
def test_a_rate_that_noise_alone_would_pass_is_named(ship):
    rate, step, w = 2.6, ship.sample_time, 2.0 * np.pi
    device = SimulatedMachine(replace(ship, effects=(EffectSpec("slew_limit", {"rate": rate}),)))
    rng, t = np.random.default_rng(0), np.arange(2500) * step
    rise = 1.0 - np.exp(-((t / 10.0) ** 3))  # from rest
    waves = [(25.0, 0.005, 9.0, 0.012), (20.0, 0.007, 6.0, 0.017)]
    fitted, judging = (
        device.run(rise * (a * np.sin(w * f * t) + b * np.sin(w * g * t)), 0.0 * t, rng)
        for a, f, b, g in waves
    )
    changes = np.abs(np.diff(fitted.u)) / step
    assert np.mean(changes > rate) > 0.5
    found = diagnose(replace(ship, controller=None), [fitted], [judging])
    assert [f.name for f in found.findings] == ["slew_limit"]
    assert found.findings[0].parameters["rate"].value == pytest.approx(rate, rel=0.1)

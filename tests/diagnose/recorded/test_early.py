"""Columns that are not of one time base are said where no controller's equation tells."""

from __future__ import annotations

import numpy as np
import pytest

from ffl.diagnose.recorded.early import early
from ffl.diagnose.recorded.mistaken import mistakes
from ffl.recordings import Recording
from ffl.systems.plant_file import plant_from_dict

STEP = 0.005
SPRUNG = {
    "name": "stage on a spring",
    "sample_time": STEP,
    "units": {"input": "N", "output": "m"},
    "plant": {"form": "czpk", "zeros": [], "poles": [[-2.0, 15.0], [-2.0, -15.0]], "gain": 0.5},
}


@pytest.fixture(scope="module")
def stage():
    return plant_from_dict(SPRUNG)


def recorded(system, u, dry=0.0):  # type: ignore[no-untyped-def]
    """y of the machine driven by u, with noise; `dry`: friction, N."""
    rng, y = np.random.default_rng(2), system.filter(u)
    for _ in range(30 if dry else 0):  # the motion gives the friction, the friction the motion
        y = 0.5 * y + 0.5 * system.filter(u - dry * np.tanh(np.gradient(y) / 1e-5))
    return y + 1e-6 * rng.standard_normal(len(u))


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(1)
    return np.convolve(np.repeat(rng.uniform(-1.0, 1.0, 80), 40), np.ones(20) / 20, "same")


@pytest.mark.parametrize("samples", [1, 4])
def test_a_command_that_is_stamped_late_is_said(stage, drive, samples):  # type: ignore[no-untyped-def]
    y = recorded(stage.system, drive)
    late = Recording.from_signals(STEP, u=np.roll(drive, samples)[50:], y=y[50:], source="run.csv")
    (fault,) = mistakes(stage, [late])
    assert fault.kind == "shift"
    assert f"{samples} sample" in fault.mend


@pytest.mark.parametrize("delay", [0, 3, 4])
def test_only_a_delay_that_is_stated_can_be_taken_out(drive, delay):  # type: ignore[no-untyped-def]
    made = plant_from_dict({**SPRUNG, "plant": {**SPRUNG["plant"], "delay": delay}})  # type: ignore[dict-item]
    u = np.roll(drive, 4)
    late = Recording.from_signals(STEP, u=u, y=recorded(made.system, drive), source="run.csv")
    assert ("out of the plant file" in early(made, late).mend) == (delay == 4)  # type: ignore[union-attr]


def test_a_friction_does_not_hide_it(stage, drive):  # type: ignore[no-untyped-def]
    y = recorded(stage.system, drive, dry=0.1)
    late = Recording.from_signals(STEP, u=np.roll(drive, 4), y=y, source="run.csv")
    assert early(stage, late).kind == "shift"  # type: ignore[union-attr]


@pytest.mark.parametrize("pole", [[-2.4, 17.0], [-4.0, 15.0]])
def test_a_machine_that_is_faster_than_its_model_leads_it_and_is_no_fault(stage, drive, pole):  # type: ignore[no-untyped-def]
    poles = [pole, [pole[0], -pole[1]]]
    other = plant_from_dict({**SPRUNG, "plant": {**SPRUNG["plant"], "poles": poles}})  # type: ignore[dict-item]
    run = Recording.from_signals(STEP, u=drive, y=recorded(other.system, drive), source="run.csv")
    assert early(stage, run) is None


@pytest.mark.parametrize(("dry", "samples"), [(0.0, 0), (0.1, 0), (0.0, -4)])
def test_neither_friction_nor_a_delay_is_a_fault(stage, drive, dry, samples):  # type: ignore[no-untyped-def]
    y = recorded(stage.system, drive, dry)
    run = Recording.from_signals(STEP, u=np.roll(drive, samples), y=y, source="run.csv")
    assert early(stage, run) is None


@pytest.mark.parametrize("samples", [20, 70, 200])
def test_a_short_recording_tells_no_lead(stage, drive, samples):  # type: ignore[no-untyped-def]
    run = Recording.from_signals(
        STEP, u=drive[:samples], y=recorded(stage.system, drive)[:samples], source="run.csv"
    )
    assert early(stage, run) is None

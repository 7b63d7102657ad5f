"""Steps of y that no command could make, where no reference was recorded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.recorded.mistaken import mistakes
from ffl.diagnose.recorded.sound import soundness
from ffl.diagnose.recorded.torn import torn
from ffl.systems import EffectSpec

AT, LONG = 700, 400
MOVING = 320  # a sample on the first move


@pytest.fixture(scope="module")
def seen(stage, record):  # type: ignore[no-untyped-def]
    """A recording of command and position of a machine with these effects."""

    def of(*effects):  # type: ignore[no-untyped-def]
        run = record(replace(stage, effects=effects))[0]
        return replace(run, r=0 * run.r, f=run.u, missing=frozenset({"r", "f"}))

    return of


def test_samples_cut_out_of_a_move_are_said(stage, seen):
    whole = seen(EffectSpec("coulomb_friction", {"level": 2.0}))
    rows = np.r_[:AT, AT + LONG : len(whole)]
    columns = {name: getattr(whole, name)[rows] for name in ("r", "f", "u", "y")}
    cut = replace(whole, t=whole.t[: len(rows)], **columns)
    plant = replace(stage, controller=None)
    assert abs(cut.y[AT] - cut.y[AT - 1]) > 0.005
    (fault,) = soundness(plant, [cut]).faults
    assert fault.kind == "samples_missing"
    assert f"{whole.y[AT + LONG] - whole.y[AT - 1]:.4g}" in fault.where
    assert f"{cut.t[AT]:.6g} s" in fault.where
    assert torn(plant, replace(cut, missing=frozenset(), r=cut.y)) is None  # its reference tells


def test_a_frozen_sensor_is_said(stage, seen):
    whole = seen()
    y = whole.y.copy()
    y[MOVING : MOVING + 100] = y[MOVING - 1]
    (fault,) = soundness(replace(stage, controller=None), [replace(whole, y=y)]).faults
    assert fault.kind == "frozen_sensor"
    assert f"from {whole.t[MOVING - 1]:.4g} to {whole.t[MOVING + 99]:.4g} s" in fault.where


@pytest.mark.parametrize(
    "effects",
    [
        [],
        [EffectSpec("stribeck_friction", {"coulomb_level": 2.0, "static_level": 6.0,
                                          "stribeck_velocity": 0.01})],
        [EffectSpec("hardening_spring", {"cubic_coefficient": 1e10, "centre": 0.02})],
        [EffectSpec("backlash", {"gap": 4e-4}, {"kind": "play"})],
    ],
    ids=["nothing", "stick-slip", "a stop", "a play"],
)  # fmt: skip
def test_a_machine_is_not_torn(stage, seen, effects):
    plant = replace(stage, controller=None)
    run = seen(*effects)
    assert torn(plant, run) is None
    assert not mistakes(plant, [run], ())


def test_what_is_no_position_of_a_mass_is_not_asked(stage, seen):
    run = seen()
    y = run.y + 0.5 * (run.t > run.t[AT])
    bare = replace(stage, controller=None)
    assert torn(bare, replace(run, y=y)) is not None
    assert torn(replace(bare, physics=type(stage.physics)()), replace(run, y=y)) is None
    assert torn(replace(bare, output_unit="m/s"), replace(run, y=y)) is None


def test_a_frozen_sensor_that_trembles_is_said_beside_a_reference(stage, record):
    """A loop's encoder that hung for 50 ms, but for its last digit: the jump after it is no blow."""
    whole = record(stage)[0]
    last = np.random.default_rng(4).choice([-1e-6, 0.0, 1e-6], 100)
    y = 1e-6 * np.round(whole.y / 1e-6)
    y[MOVING : MOVING + 100] = y[MOVING - 1] + last
    (fault,) = soundness(stage, [replace(whole, y=y)]).faults
    assert fault.kind == "frozen_sensor"
    assert f"to {whole.t[MOVING + 99]:.4g} s" in fault.where
    assert torn(stage, whole) is None


def test_equal_jumps_within_a_window_may_be_a_counter_and_lost_samples_are_not(stage, record):
    """A range of no power of two, or of steps that noise hides, is said and not carried on."""
    whole = record(stage)[0]
    (fault,) = soundness(stage, [replace(whole, y=np.mod(whole.y + 0.013, 0.03))]).faults
    assert fault.kind == "wrapped"
    assert "y goes back by 0.03 m each time that it jumps" in fault.where
    assert "carry it on by 0.03 m" in fault.mend
    lost = np.where(whole.t > whole.t[MOVING], whole.y - 0.03, whole.y)
    (fault,) = soundness(stage, [replace(whole, y=lost)]).faults
    assert fault.kind == "samples_missing"

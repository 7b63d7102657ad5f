"""Machines whose controller nobody stated: what their observer may and may not be told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.predict.observer import (
    DECAYS,
    decay_for,
    decay_of,
    led,
    moving,
    needs_observer,
    with_observer,
)
from ffl.diagnose.proof.prove import run_plant
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.recordings import Recording
from ffl.systems import Controller, Move, Physics, Plant, Zpk, moves
from ffl.systems.plant import EffectSpec, Imperfections
from ffl.systems.plant_file import plant_from_dict

STEP, INERTIA = 0.004, 1500.0
DRY, VISCOUS, LOAD = 500.0, 1600.0, -2000.0


@pytest.fixture(scope="module")
def axis() -> Plant:
    """A robot's axis, torque in and angle out, 1500 kg m^2."""
    system = Zpk([-1.0], [1.0, 1.0], STEP**2 / (2 * INERTIA), STEP)
    return Plant("axis", system, None, "N m", "rad", "made here", Physics(INERTIA, 1.0))


@pytest.fixture(scope="module")
def recorded(axis):  # type: ignore[no-untyped-def]
    """One run of the axis: 1 s of rest, moves back and forth, 1 s of rest."""
    steps = [Move(1.0, 0.3, 0.4, 0.8, 8.0), Move(3.4, -0.5, 0.45, 0.8, 8.0),
             Move(6.4, 0.4, 0.4, 0.8, 8.0)]  # fmt: skip
    reference = moves(steps, 9.5, STEP)
    w = 2 * np.pi * 2.0
    zero, pole = np.exp(-0.4 * w * STEP), np.exp(-4.0 * w * STEP)
    lead = Zpk([zero], [pole], 1.0, STEP)
    size = abs(lead.response([2.0])[0] / (INERTIA * w**2))
    effects = (
        EffectSpec("coulomb_friction", {"level": DRY}),
        EffectSpec("viscous_friction", {"coefficient": VISCOUS}),
        EffectSpec("constant_load", {"force": LOAD}),
    )
    machine = replace(
        axis, controller=Controller.of_error(replace(lead, gain=1.0 / size)), effects=effects,
        machine=Imperfections(1e-7, 1e-7, 20.0, None),
    )  # fmt: skip
    run = SimulatedMachine(machine).run(
        reference, np.full_like(reference, -LOAD), np.random.default_rng(3)
    )
    return replace(run, r=np.zeros_like(run.y), f=run.u)


def test_standstill_at_either_end_is_left_out(axis, recorded):
    assert needs_observer(axis)
    (cut,) = moving([recorded])
    assert 0.9 < cut.t[0] < 1.4
    assert cut.t[-1] < 8.9
    assert np.array_equal(cut.y, recorded.y[np.isin(recorded.t, cut.t)])


def test_a_recording_that_all_but_stands_still_is_left_whole(recorded):
    begun = recorded[: int(np.argmax(recorded.t >= recorded.t[0] + 1.35))]
    assert len(moving([begun])[0]) == len(begun)


def test_standstill_that_takes_more_than_half_is_left_out_and_slow_motion_is_not(recorded):
    waits = recorded[: len(recorded) // 5]
    (cut,) = moving([waits])
    assert 0.2 * len(waits) < len(cut) < 0.5 * len(waits)
    creeps = replace(waits, y=waits.y + 0.03 * np.ptp(waits.y) * waits.t)
    assert len(moving([creeps])[0]) == len(creeps)


def test_the_observer_follows_what_was_measured(axis, recorded):
    plant = with_observer(axis, 2 * np.pi)
    assert np.abs(plant.loop.poles).max() < 1.0
    (seen,) = led([recorded])
    np.testing.assert_array_equal(seen.r, recorded.y)


@pytest.fixture(scope="module")
def bridge() -> Plant:
    """A measuring machine, N in and mm out, with a light mode at 38 Hz, measured at the motor."""
    zero, pole = -1.55195 + 192.489j, -2.38761 + 238.7491j
    system = {
        "form": "czpk",
        "zeros": [[zero.real, zero.imag], [zero.real, -zero.imag]],
        "poles": [[pole.real, pole.imag], [pole.real, -pole.imag], 0.0, 0.0],
        "gain": 19.2308,
    }
    units = {"input": "N", "output": "mm"}
    return plant_from_dict(
        {
            "name": "bridge",
            "sample_time": 0.001,
            "source": "made here",
            "units": units,
            "plant": system,
        }
    )


@pytest.mark.parametrize("decay", 2 * np.pi * np.array([1.0, 2.0, 5.0]))
def test_an_observer_leaves_a_ringing_mode_alone(bridge, decay):
    """Made to damp it, its loop was lost where the machine's mode lay 1.6 % beside the stated one."""
    plant = with_observer(bridge, decay)
    assert decay_of(plant) > 2.0  # the mode's own
    base = Base.of(plant)
    for frequency in (-0.1, -0.016, 0.016, 0.1):
        model = replace(Model(base), corrections={"mode_1_frequency": frequency, "mass": 0.05})
        assert np.abs(replace(plant, system=model.plant().system).loop.poles).max() < 1.0


def test_a_machine_with_a_mode_that_misses_nothing_is_told_so(bridge):
    """By recordings with u and y alone, the mass 1.3 % and the mode 1.6 % off."""
    model = replace(Model(Base.of(bridge)), corrections={"mass": 0.013, "mode_1_frequency": 0.016})
    w = 2 * np.pi * 9.0
    zero, pole = np.exp(-0.4 * w * 1e-3), np.exp(-4.0 * w * 1e-3)
    lead = Zpk([zero], [pole], 1.0, 1e-3)
    size = abs(lead.response([9.0])[0]) * 12.5 / w**2
    machine = replace(
        bridge, system=model.plant().system, machine=Imperfections(1e-4, 4e-5, 3e-2, None),
        controller=Controller.of_error(replace(lead, gain=1.0 / size)),
    )  # fmt: skip
    runs = []
    for seed, sign in ((0, 1.0), (1, -1.0)):
        steps = [
            Move(0.3 + 1.2 * k, sign * d, 100.0, 400.0, 8000.0) for k, d in enumerate((40, -25, 30))
        ]
        reference = moves(steps, 4.5, 1e-3)
        run = SimulatedMachine(machine).run(
            reference, np.zeros_like(reference), np.random.default_rng(seed)
        )
        nobody = run.missing | {"r", "f"}
        runs.append(replace(run, r=np.zeros_like(run.y), f=run.u, missing=nobody))
    found = diagnose(bridge, runs[:1], runs[1:]).answer()
    assert found["verdict"] == "nothing_missing"
    told = {c["name"]: c["relative"] for c in found["model_corrections"]}
    assert told["mass"] == pytest.approx(0.013, abs=0.002)
    assert told["mode_1_frequency"] == pytest.approx(0.016, abs=0.002)


@pytest.mark.slow(30)
def test_friction_is_named_though_stiction_held_the_machine_before(axis, recorded):
    """At rest the motor may hold anything up to stiction: here 900 N m off the load."""
    u = recorded.u.copy()
    rest = recorded.t - recorded.t[0] < 0.9
    u[rest] += 900.0
    answer = diagnose(axis, [replace(recorded, u=u, f=u)]).answer()
    found = {e["name"]: e["parameters"] for e in answer["effects"]}
    assert found["coulomb_friction"]["level"]["value"] == pytest.approx(DRY, rel=0.1)
    assert found["constant_load"]["force"]["value"] == pytest.approx(LOAD, rel=0.05)
    assert found["viscous_friction"]["coefficient"]["value"] == pytest.approx(VISCOUS, rel=0.15)
    assert "drift" not in found


def test_what_the_drive_bent_is_not_asked_of_the_observer(axis):  # type: ignore[no-untyped-def]
    """A limit bends the command as it was recorded, and what the observer adds goes past it: without noise
    the true model leaves nothing, found by the contest or stated by the plant file."""
    limit = EffectSpec("saturation", {"limit": 900.0})
    u = 1500.0 * np.sin(np.linspace(0.0, 25.0, 2000))
    device = SimulatedMachine(replace(axis, effects=(limit,), machine=Imperfections()))
    run = device.run(np.zeros_like(u), u, np.random.default_rng(0))
    (seen,) = led([replace(run, u=u)])
    leading = with_observer(axis, 6.0)
    found = Model(Base.of(leading, observed=True), effects=(limit,))
    stated = Model(Base.of(replace(leading, effects=(limit,)), observed=True))
    trial = prepare(found.base.simulator, seen, 1e-9)
    for model in (found, stated):
        settled = model.follow(trial).y[200:]
        np.testing.assert_allclose(settled, seen.y[200:], atol=1e-6 * np.ptp(seen.y))
    off = replace(leading, system=replace(leading.system, gain=1.2 * leading.system.gain))
    plant = replace(off, effects=(limit,))
    past, through = (run_plant(plant, trial, observed).y for observed in (True, False))
    assert np.std(past - seen.y) < 0.9 * np.std(through - seen.y)


def test_an_observer_is_held_to_no_limit(axis):  # type: ignore[no-untyped-def]
    """u as recorded is beyond the drive already, and what the observer adds goes through none."""
    limited = replace(axis, machine=Imperfections(1e-7, 1e-7, 20.0, 100.0))
    assert with_observer(limited, 6.0).machine == Imperfections(1e-7, 1e-7, 20.0, None)


def test_an_observer_of_what_is_sampled_slowly_lasts_as_much_longer():
    """A vehicle under water at 10 Hz is one at 100 Hz by a slower clock; a robot at 250 Hz is not."""
    rng = np.random.default_rng(2)
    y = np.cumsum(0.01 * np.sin(0.02 * np.arange(3000))) + 1e-4 * rng.standard_normal(3000)

    def per_sample(step):  # type: ignore[no-untyped-def]
        decay = decay_for([Recording.from_signals(step, u=y, y=y)])
        return decay * step

    assert per_sample(0.1) == pytest.approx(per_sample(0.02), rel=1e-12)
    assert per_sample(3600.0) == pytest.approx(per_sample(0.02), rel=1e-12)
    assert per_sample(0.004) / 0.004 == pytest.approx(DECAYS[0])

"""Recordings that begin in motion or with a contact under load."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.resting import rest_under
from ffl.diagnose.recorded.starts import with_starts
from ffl.diagnose.recorded.trials import prepare
from ffl.systems.plant import EffectSpec
from ffl.systems.plant_file import plant_from_dict

CONTACTS = {
    "slides": EffectSpec(
        "presliding_friction",
        {"level": 8.0, "stiffness": 4e4, "micro_damping": 0.0},
        {"kind": "maxwell_slip"},
    ),
    "on the way": EffectSpec(
        "hysteresis", {"force": 8.0, "displacement": 0.01, "exponent": 1.0, "beta": 0.5}
    ),
}


@pytest.mark.parametrize("name", CONTACTS)
def test_what_a_contact_remembers_belongs_to_the_start(stage, record, name):
    machine = replace(stage, effects=(CONTACTS[name],))
    cut = record(machine)[0][380:1400]  # within the first move
    base = Base.of(stage, 0.1)
    trial = prepare(base.simulator, cut, 1e-7)
    assert not trial.at_rest
    assert trial.travel > 0
    model = Model(base, effects=(CONTACTS[name],))

    def left(travel):
        scene = Scene(stage.loop, (replace(trial, travel=travel),), Noise(1e-7, 2e-3))
        (settled,) = with_starts(scene, model).trials
        white = scene.whiten([settled.y - model.simulate(settled).y])[100:]
        return float(np.mean(white**2))

    assert left(trial.travel) < 1.3


def test_a_machine_that_hardly_moves_at_first_has_come_from_nowhere(stage, record):
    machine = replace(stage, effects=(CONTACTS["slides"],))
    recording = record(machine)[0]
    simulator = Base.of(stage, 0.1).simulator
    assert prepare(simulator, recording, 1e-7).travel == 0.0
    assert prepare(simulator, recording[255:], 1e-7).travel == 0.0
    assert prepare(simulator, recording[1030:], 1e-7).travel < -0.01


def test_a_reference_at_rest_is_no_machine_at_rest(stage, record):
    """Within a dead zone nothing holds the machine: it drifts where its reference stands still."""
    dead = EffectSpec("dead_zone", {"half_width": 0.4})
    machine = replace(stage, effects=(dead,), machine=replace(stage.machine, force_noise=0.05))
    recording = record(machine)[0]
    moving = recording[60:]  # while it drifts, before the first move at 0.25 s
    base = Base.of(stage, 0.1)
    trial = replace(prepare(base.simulator, moving, 1e-7), at_rest=True)
    speed = np.gradient(recording.y, stage.sample_time)[58:62].mean()
    if trial.adrift is None:
        trial = replace(trial, adrift=(trial.start, trial.doubt))
    still = replace(trial, start=base.simulator.at_rest(float(moving.y[0])), doubt=0 * trial.doubt)
    scene = Scene(stage.loop, (still,), Noise(1e-7, 5e-2))
    model = Model(base, effects=(dead,))
    settled = with_starts(scene, model)
    left = [np.mean(s.whiten(s.residuals(model))[:200] ** 2) for s in (scene, settled)]
    assert left[1] < min(1.5, left[0] + 1e-9)
    if not settled.trials[0].at_rest:
        assert abs(model.follow(settled.trials[0]).v[0] - speed) < 0.3 * abs(speed)


def test_who_was_taken_to_move_is_at_rest_again_for_the_next_model(stage, record):
    """A wrong model may explain its own error by a start in motion; another does not inherit it."""
    recording = record(stage)[0]
    base = Base.of(stage, 0.1)
    trial = prepare(base.simulator, recording, 1e-7)
    assert trial.at_rest
    assert trial.adrift is not None
    start, doubt = trial.adrift
    away = start + 1e-3 * np.sqrt(np.diag(doubt).max()) * np.ones_like(start)
    taken = replace(
        trial, start=away, doubt=doubt, at_rest=False, adrift=(trial.start, trial.doubt)
    )
    scene = Scene(stage.loop, (taken,), Noise(1e-7, 2e-3))
    (settled,) = with_starts(scene, Model(base)).trials
    assert settled.at_rest
    np.testing.assert_array_equal(settled.start, trial.start)


def test_a_valve_rests_where_it_is_seen_whatever_the_model_makes_of_its_command():
    """Its dead zone swallows the first command; the model without it makes 0.4 bar of that."""
    plant = plant_from_dict(
        {
            "name": "valve",
            "sample_time": 0.002,
            "units": {"input": "V", "output": "bar"},
            "plant": {"form": "czpk", "zeros": [], "poles": [-2.5], "gain": 10.0},
        }
    )
    base = Base.of(plant, 10.0)
    for seen, command in ((0.0, 0.1), (0.4, 0.1), (-2.0, 0.0)):
        start = rest_under(base.simulator, command, command, seen)
        run = base.simulator.run((), feedforward=np.full(4, command), start=start)
        assert run.y[0] == pytest.approx(seen, abs=1e-9)

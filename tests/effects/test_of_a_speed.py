"""Effects of a sensor that measures a position, on a plant whose output is a speed."""

from __future__ import annotations

import numpy as np
import pytest

from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.ladders import overlooked
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.diagnose.screen.screen import Screen
from ffl.effects import EFFECTS
from ffl.errors import InputError
from ffl.machines import Simulator
from ffl.recordings import Recording
from ffl.systems import Plant, Zpk
from ffl.systems.plant import EffectSpec, Physics

STEP = 2e-3
POLE = np.exp(-STEP / 0.3)
SPINDLE = Plant(
    "spindle", Zpk(np.zeros(0), np.array([POLE]), 20.0 * (1.0 - POLE), STEP), None, "V", "rad/s",
    "made for the tests", Physics(0.015, 0.001),
)  # fmt: skip
OF_A_POSITION = [
    EffectSpec("backlash", {"gap": 0.01}, {"kind": "play"}),
    EffectSpec("sensor_lead", {"lead": 1e-4}),
]


@pytest.mark.parametrize("spec", OF_A_POSITION, ids=lambda spec: spec.name)
def test_what_needs_a_position_says_so(spec):
    with pytest.raises(InputError, match=f"effect {spec.name}: .*position; here it is a speed: "):
        Simulator(SPINDLE, open_loop=True).run([spec], None, np.ones(100))


@pytest.fixture(scope="module")
def seen():  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(2)
    command = np.repeat(rng.choice([-2.0, 2.0], 20), 100)
    simulated = Simulator(SPINDLE, open_loop=True).run((), None, command)
    time, y = STEP * np.arange(len(command)), simulated.y + 1e-3 * rng.standard_normal(len(command))
    run = Recording(time, 0.0 * y, command, command, y, None, sample_time=STEP)
    base = Base.of(SPINDLE, float(np.ptp(run.y)))
    noise = Noise(1e-3, 1e-3)
    scene = Scene(base.loop, (prepare(base.simulator, run, noise.sensor),), noise)
    return scene, Model(base)


@pytest.mark.parametrize("name", ["encoder_ripple", "backlash", "sensor_lead"])
def test_no_scale_is_looked_for_where_a_speed_is_measured(seen, name):
    scene, model = seen
    assert Screen(scene, fit(scene, model, rounds=0)).places(EFFECTS[name]) == []


def test_plays_that_are_tried_there_are_of_a_load(seen):
    scene, model = seen
    judged = judge(scene, None, model, 4)
    tried = overlooked(scene, judged, judged.fit, [], [], set())
    assert all(c.spec.options.get("kind") != "play" for c in tried)

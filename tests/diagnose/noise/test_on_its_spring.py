"""A mass on a spring that slow moves do not show: noise rings it at its own frequency."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.search import contest
from ffl.diagnose.diagnosis import THRESHOLD
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.heard import on_its_spring
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.systems.plant import EffectSpec

STEP, SENSOR, FORCE = 1e-3, 5e-9, 0.2
LIGHTER = EffectSpec("mass_change", {"change": -0.4})
LIMIT = EffectSpec("saturation", {"limit": 8.0})


@pytest.fixture(scope="module")
def spring(on_a_spring):  # type: ignore[no-untyped-def]
    return on_a_spring(2.0, 40.0, 0.06, STEP, sensor_noise=SENSOR, force_noise=FORCE)


@pytest.fixture(scope="module")
def recorded(spring):
    """Three recordings of slow moves of the stage with effects."""

    def of(*effects):
        t, rng = STEP * np.arange(3000), np.random.default_rng(7)
        device = SimulatedMachine(replace(spring, effects=effects))
        moves = [
            10.0 * np.sin(2 * np.pi * slow * t) * np.sin(2 * np.pi * fast * t)
            for slow, fast in ((0.7, 1.9), (0.9, 2.7), (1.3, 2.1))
        ]
        return [device.run(np.zeros_like(f), f, rng) for f in moves]

    return of


@pytest.fixture(scope="module")
def judged(spring, recorded):
    """(what is judged, held-out scene) of the stage with effects, told by `found`."""

    def of(effects, found=()):
        base = Base.of(spring)
        first, second, last = (prepare(base.simulator, r, SENSOR) for r in recorded(*effects))
        noise = Noise(SENSOR, FORCE)
        held = Scene(spring.loop, (last,), noise)
        scene = Scene(spring.loop, (first, second), noise)
        return judge(scene, held, Model(base, effects=tuple(found))), held

    return of


def test_noise_tells_a_mass_that_moves_do_not(judged):
    nothing, held = judged([LIGHTER])
    lines: list[str] = []
    found = on_its_spring(nothing.scene, held, nothing, lines.append)
    assert found is not None
    assert found.model.corrections["mass"] == pytest.approx(-0.4, abs=0.04)
    assert {"mass", "damping"} <= found.model.held
    assert found.fitted > nothing.fitted + 100.0
    assert "as the noise rings" in lines[0]


def test_a_mass_as_it_is_stated_stays(judged):
    nothing, held = judged([])
    assert on_its_spring(nothing.scene, held, nothing, lambda line: None) is None


def test_noise_through_what_rubs_tells_nothing_linear(judged):
    friction = EffectSpec("coulomb_friction", {"level": 1.0})
    told, held = judged([friction], [friction])
    assert on_its_spring(told.scene, held, told, lambda line: None) is None


def test_a_servo_hides_where_noise_would_ring(stage, scenes, record):
    scene, held, model = scenes(record(stage))
    told = judge(scene, held, model)
    assert on_its_spring(scene, held, told, lambda line: None) is None


def test_the_contest_goes_on_from_there(judged):
    """(Beside a limit half of a mass was 12 of log-likelihood by free runs, and nothing.)"""
    nothing, held = judged([LIMIT, LIGHTER])
    outcome = contest(nothing.scene, held, nothing.model, THRESHOLD)
    assert outcome.standing.model.names == ("saturation",)
    assert outcome.standing.model.corrections["mass"] == pytest.approx(-0.4, abs=0.1)

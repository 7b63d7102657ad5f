"""Maps that the kernel runs: against an independent integration, and on a stage that nothing holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.maps.freeform import free_form
from ffl.diagnose.maps.freemodel import FreeModel, Part
from ffl.diagnose.maps.grids import ranges_of
from ffl.diagnose.maps.mapped import FLOOR
from ffl.diagnose.maps.terms import TERMS
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec

STEP, MASS, FREQUENCY, DAMPING = 1e-3, 2.0, 25.0, 0.02
W = 2 * np.pi * FREQUENCY
SENSOR = 1e-9  # m: noise


@pytest.fixture(scope="module")
def spring(on_a_spring):  # type: ignore[no-untyped-def]
    """2 kg on a spring of 25 Hz, hardly damped."""
    return on_a_spring(MASS, FREQUENCY, DAMPING, STEP, "N")


def integrated(u, acceleration):  # type: ignore[no-untyped-def]
    """y (N,) of x'' = acceleration(x, v, u) with u held over each sample, to 1e-9."""
    state, out = np.zeros(2), np.empty(len(u))
    for k, held in enumerate(u):
        out[k] = state[0]
        state = solve_ivp(
            lambda t, s, held=held: (s[1], acceleration(s[0], s[1], held)),
            (0.0, STEP), state, method="DOP853", rtol=1e-9, atol=1e-14,
        ).y[:, -1]  # fmt: skip
    return out


def linear(x, v, force):  # type: ignore[no-untyped-def]
    """x'' of the spring under a force (N)."""
    return force / MASS - 2 * DAMPING * W * v - W**2 * x


def recording(u, y, name):  # type: ignore[no-untyped-def]
    return Recording(
        STEP * np.arange(len(u)), np.zeros(len(u)), u, u, y, sample_time=STEP, source=name
    )


def swept(n, seed=0):  # type: ignore[no-untyped-def]
    """Forces of 5 N from 1 to 40 Hz, after 50 ms of rest."""
    t = STEP * np.arange(n)
    phase = 2 * np.pi * (1.0 + seed + (39.0 - seed) * t / (2 * t[-1])) * t
    return np.where(t < 0.05, 0.0, 5.0 * np.sin(phase))


def trial_of(plant, recorded):  # type: ignore[no-untyped-def]
    base = Base.of(plant, float(np.ptp(recorded.y)), 1.0)
    return Model(base), prepare(base.simulator, recorded, SENSOR)


FORCES = {  # x'' by name, with g along the map's own variable
    "position": lambda x, v, u, g: linear(x, v, u + g(x)),
    "velocity": lambda x, v, u, g: linear(x, v, u + g(v)),
    "velocity by position": lambda x, v, u, g: linear(x, v, u + v * g(x)),
    "upward velocity by position": lambda x, v, u, g: linear(x, v, u + max(v, 0.0) * g(x)),
    "downward velocity by position": lambda x, v, u, g: linear(x, v, u + min(v, 0.0) * g(x)),
    "pull by position": lambda x, v, u, g: linear(x, v, u + u**2 * g(x)),
    "command": lambda x, v, u, g: linear(x, v, u + g(u)),
    "command by position": lambda x, v, u, g: linear(x, v, u * (1.0 + g(x))),
}


@pytest.mark.parametrize("name", FORCES)
def test_the_kernel_runs_a_map_as_an_integrator_does(spring, name):  # type: ignore[no-untyped-def]
    term = next(t for t in TERMS if t.name == name)
    u = swept(600)
    bare = integrated(u, linear)
    model, trial = trial_of(spring, recording(u, bare, "swept"))
    spans = ranges_of([model.simulate(trial).motion()])
    knots = term.knots(spans)
    braked = "velocity by position" in name
    size = {"command by position": 0.5, "pull by position": 0.1}
    if braked:
        size[name] = 20 * 2 * DAMPING * W * MASS
    g = -size.get(name, 2.0) * np.tanh(2 * knots / np.abs(knots).max())
    if braked:
        g = -np.abs(g)  # a brake of many times the stage's own damping
    free = FreeModel(model, (Part(term, Place(term.port), g, spans),))
    found = free.simulate(trial)
    assert found is not None
    force = FORCES[name]
    wanted = integrated(u, lambda x, v, held: force(x, v, held, lambda z: np.interp(z, knots, g)))
    moved = np.std(wanted - bare)
    assert moved > 0.05 * np.std(bare)
    assert np.std(found[0].y - wanted) < 2e-3 * moved


def test_a_map_by_direction_sticks_as_dry_friction_does(spring):  # type: ignore[no-untyped-def]
    term = next(t for t in TERMS if t.name == "direction by position")
    t = STEP * np.arange(1500)
    u = 5.0 * np.sin(2 * np.pi * (1.0 + 6.0 * t) * t)
    model, trial = trial_of(spring, recording(u, integrated(u, linear), "swept"))
    bare = model.simulate(trial)
    spans = ranges_of([bare.motion()])
    g = np.full(len(term.knots(spans)), -3.0)
    found = FreeModel(model, (Part(term, Place("force"), g, spans),)).simulate(trial)
    dry = model.with_effect(EffectSpec("coulomb_friction", {"level": 3.0})).simulate(trial)
    assert found is not None
    stuck = np.abs(dry.v) < 1e-9
    assert np.mean(stuck) > 0.1
    top = np.abs(bare.v).max()
    assert (
        np.quantile(np.abs(found[0].v[stuck]), 0.99) < 2e-3 * top
    )  # a direction is none below 1e-3
    assert np.std(found[0].y - dry.y) < 0.02 * np.std(bare.y - dry.y)


def test_maps_beside_another_machine_are_not_believed(spring):  # type: ignore[no-untyped-def]
    model = Model(Base.of(spring, 1.0, 1.0))
    spans = {"x": (-1.0, 1.0), "v": (-1.0, 1.0), "u": (-5.0, 5.0), "step": (STEP, 1.0)}
    terms = {
        name: next(t for t in TERMS if t.name == name) for name in ("position", "limit by speed")
    }

    def beside(name: str, mass: float) -> FreeModel:
        part = Part(terms[name], Place(terms[name].port), np.zeros(1), spans)
        return FreeModel(replace(model, corrections={"mass": mass}), (part,))

    assert beside("position", -0.6).believable
    assert not beside("position", -0.8).believable
    assert beside("limit by speed", -0.3).believable
    assert not beside("limit by speed", -0.6).believable


def test_friction_in_proportion_to_the_command_is_run_at_once(spring):  # type: ignore[no-untyped-def]
    """Repeated along its own motion it left a worm gear six times as far off as it is."""
    term = next(t for t in TERMS if t.name == "direction by size of command")
    t = STEP * np.arange(1500)
    u = 5.0 * np.sin(2 * np.pi * (1.0 + 3.0 * t) * t)
    bare = integrated(u, linear)
    model, trial = trial_of(spring, recording(u, bare, "swept"))
    spans = ranges_of([model.simulate(trial).motion()])
    free = FreeModel(model, (Part(term, Place("force"), np.array([-0.3]), spans),))
    found = free.simulate(trial)
    assert found is not None
    assert not free._repeated
    slow = 1e-3 * max(abs(v) for v in spans["v"])  # below there is no direction

    def force(held, v):  # type: ignore[no-untyped-def]
        return held - 0.3 * abs(held) * np.clip(v / slow, -1.0, 1.0)

    wanted = integrated(u, lambda x, v, held: linear(x, v, force(held, v)))
    assert np.std(found[0].y - wanted) < 3e-2 * np.std(wanted - bare)


def test_a_mass_that_depends_on_position_is_run_at_once(spring):  # type: ignore[no-untyped-def]
    """M(x) x'' + M'(x) v^2/2, M = 2 kg (1 + x/x_max / 4)."""
    term = next(t for t in TERMS if t.name == "inertia by position")
    u = swept(600)
    model, trial = trial_of(spring, recording(u, integrated(u, linear), "swept"))
    spans = ranges_of([model.simulate(trial).motion()])
    knots = term.knots(spans)
    rise = -0.25 * MASS / np.abs(knots).max()
    found = FreeModel(model, (Part(term, Place("force"), rise * knots, spans),)).simulate(trial)
    assert found is not None

    def acceleration(x, v, held):  # type: ignore[no-untyped-def]
        free = MASS * linear(x, v, held) + 0.5 * rise * v**2
        return free / (MASS - rise * x)

    wanted = integrated(u, acceleration)
    moved = np.std(wanted - trial.y)
    assert np.std(found[0].y - wanted) < 2e-2 * moved  # the acceleration is its mean over a sample


def test_drag_that_outdoes_the_damping_is_followed_where_nothing_holds_the_stage(spring):  # type: ignore[no-untyped-def]
    drag = 5e3  # N s^3/m^3: at 0.1 m/s ten times what the stage's own damping gives
    rng = np.random.default_rng(3)
    runs = []
    for k in range(2):
        u = swept(1500, k)
        y = integrated(u, lambda x, v, held: linear(x, v, held - drag * v**3))
        runs.append(recording(u, y + SENSOR * rng.standard_normal(len(y)), f"swept {k}"))
    base = Base.of(spring, float(np.ptp(runs[0].y)), 1.5)
    trials = [prepare(base.simulator, r, SENSOR) for r in runs]
    noise = Noise(SENSOR, 1e-4)
    scene, held = (Scene(spring.loop, (trial,), noise) for trial in trials)
    model = Model(base)
    first = scene.residuals(model)
    assert first is not None
    assert np.std(first[0]) > 0.2 * np.std(runs[0].y)
    found = free_form(scene, held, model)[-1]
    left = held.residuals(found.free)
    assert left is not None
    assert found.variables == ("velocity",)
    assert np.std(left[0]) < 0.02 * np.std(runs[1].y)


def test_an_inertia_that_grows_with_speed_is_run_at_once(spring):  # type: ignore[no-untyped-def]
    """(M + J v^2) x'', three times M at the top; repeated along its own motion it never came to rest."""
    term = next(t for t in TERMS if t.name == "inertia by speed")
    u = swept(600)
    model, trial = trial_of(spring, recording(u, integrated(u, linear), "swept"))
    spans = ranges_of([model.simulate(trial).motion()])
    knots = term.knots(spans)
    more = 2.0 * MASS / np.abs(knots).max() ** 2
    free = FreeModel(model, (Part(term, Place("force"), -more * knots**2, spans),))
    found = free.simulate(trial)
    assert found is not None
    assert not free._repeated

    def acceleration(x, v, held):  # type: ignore[no-untyped-def]
        return MASS * linear(x, v, held) / (MASS + more * v**2)

    wanted = integrated(u, acceleration)
    moved = np.std(wanted - trial.y)
    assert moved > 0.05 * np.std(trial.y)
    assert np.std(found[0].y - wanted) < 2e-2 * moved


def test_dry_friction_that_goes_with_the_acceleration_is_run_at_once(spring):  # type: ignore[no-untyped-def]
    """A gear whose losses go with the torque that it passes on: 1 N and 0.8 kg a against the motion."""
    term = next(t for t in TERMS if t.name == "direction by acceleration")
    u = swept(600)
    bare = integrated(u, linear)
    model, trial = trial_of(spring, recording(u, bare, "swept"))
    spans = ranges_of([model.simulate(trial).motion()])
    free = FreeModel(model, (Part(term, Place("force"), -1.0 - 0.8 * term.knots(spans), spans),))
    found = free.simulate(trial)
    assert found is not None
    assert not free._repeated
    floor = FLOOR * max(abs(v) for v in spans["v"])

    def run(more):  # type: ignore[no-untyped-def]
        def acceleration(x, v, held):  # type: ignore[no-untyped-def]
            way = np.clip(v / floor, -1.0, 1.0)
            return (MASS * linear(x, v, held) - 1.0 * way) / (MASS + more * way)

        return integrated(u, acceleration)

    wanted = run(0.8)
    moved = np.std(wanted - bare)
    assert moved > 0.05 * np.std(bare)
    assert np.std(found[0].y - wanted) < 0.1 * moved  # reversals are solved within a step or two
    assert np.std(run(0.0) - wanted) > 0.3 * moved


def test_a_sensor_that_hears_the_command_is_told_at_the_sensor(spring):  # type: ignore[no-untyped-def]
    rng, runs = np.random.default_rng(5), []
    for k in range(2):
        u = swept(1500, k)
        y = integrated(u, linear)
        y = y + 0.02 * np.std(y) * np.abs(np.append(0.0, u[:-1])) / 5.0
        runs.append(recording(u, y + SENSOR * rng.standard_normal(len(y)), f"swept {k}"))
    base = Base.of(spring, float(np.ptp(runs[0].y)), 1.5)
    trials = [prepare(base.simulator, r, SENSOR) for r in runs]
    scene, held = (Scene(spring.loop, (trial,), Noise(SENSOR, 1e-4)) for trial in trials)
    found = free_form(scene, held, Model(base))[-1]
    assert [part.term.name for part in found.parts] == ["command at the sensor"]
    left = held.residuals(found.free)
    bare = held.residuals(Model(base))
    assert left is not None
    assert bare is not None
    assert np.std(left[0]) < 0.2 * np.std(bare[0])

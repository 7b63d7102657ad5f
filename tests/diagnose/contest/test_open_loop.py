"""A stage on a spring without a servo: how its recordings begin, and what its noise looks like."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest import line
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.line import across_the_line
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.amounts import sizes
from ffl.diagnose.hypothesis.fit import Fit, fit
from ffl.diagnose.hypothesis.linear import corrected
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.maps.unnamed import compare
from ffl.diagnose.noise.imitate import drawn
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.noise.plain import too_loud
from ffl.diagnose.proof.prove import run_plant
from ffl.diagnose.recorded.clip import clipping
from ffl.diagnose.recorded.events import events
from ffl.diagnose.recorded.signs import looks_folded
from ffl.diagnose.recorded.trials import prepare
from ffl.recordings import Recording
from ffl.systems import load_plant
from ffl.systems.plant import EffectSpec, Imperfections, Plant
from ffl.systems.zpk import Zpk

STEP, MASS, FREQUENCY, DAMPING = 1e-3, 2.0, 30.0, 0.03
W = 2 * np.pi * FREQUENCY
HELD = 4.0  # command that the recordings begin with


@pytest.fixture(scope="module")
def spring(on_a_spring):  # type: ignore[no-untyped-def]
    """2 kg on a spring of 30 Hz, 1 N per input unit."""
    return on_a_spring(MASS, FREQUENCY, DAMPING, STEP)


def at_hold(seed=0):  # type: ignore[no-untyped-def]
    """400 samples that hold `HELD`, y with a little noise."""
    u = np.full(400, HELD)
    y = HELD / (MASS * W**2) + 1e-9 * np.random.default_rng(seed).standard_normal(len(u))
    return Recording(STEP * np.arange(400), np.zeros(400), u, u, y, sample_time=STEP)


@pytest.mark.parametrize(
    "effect",
    [
        EffectSpec("input_delay", {"delay": 2.4e-3}),
        EffectSpec("actuator_lag", {"time_constant": 3e-3}),
    ],
    ids=lambda e: e.name,
)
def test_a_late_command_was_there_before_the_recording(spring, effect):
    """A ring of zeros would kick the stage at the first sample and let it swing for long."""
    model = Model(Base.of(spring), effects=(effect,))
    trial = prepare(model.base.simulator, at_hold(), 1e-9)
    still = HELD / (MASS * W**2)
    for y in (model.simulate(trial).y, run_plant(model.plant(), trial).y):
        assert np.abs(y - still).max() < 1e-4 * still


def test_a_command_that_rounds_below_zero_folds_nothing(spring):
    """Strokes out and back to zero: y touches zero because it was sent there."""
    t = STEP * np.arange(4000)
    path = 2.0 * (1.0 - np.cos(2 * np.pi * 1.5 * t))
    for least, folded in ((0.0, False), (-4e-17, False), (-1.0, True)):
        u = np.where(path == path.min(), least, path)
        r = Recording(t, 0 * t, u, u, path / (MASS * W**2), sample_time=STEP)
        assert looks_folded(spring, [r]) is folded


def test_slow_noise_makes_no_bursts(spring):
    """Force noise with its corner at 4 Hz holds few independent samples in a window of 64: their mean
    power goes up and down by itself."""
    base = Base.of(replace(spring, machine=Imperfections(1e-9, 1e-9, 0.05, None)))
    rng = np.random.default_rng(3)
    u = 2.0 * np.sin(2 * np.pi * 0.7 * STEP * np.arange(9000))
    force = drawn(0.03, 0.045, 4.0, STEP, len(u), rng)
    y = base.simulator.run((), feedforward=u, force=force).y + 1e-9 * rng.standard_normal(len(u))
    r = Recording(STEP * np.arange(len(u)), 0 * u, u, u, y, sample_time=STEP)
    trial = prepare(base.simulator, r, 1e-9)
    noise = Noise(1e-9, 0.03, force_coloured=0.045, force_corner=4.0)
    scene = Scene(spring.loop, (trial,), noise)
    model = Model(base)
    assert events(scene, scene.residuals(model)).found  # what a fixed limit says
    found = fit(scene, model, rounds=0)
    bursts = compare(scene, None, model, found, rng).events
    assert bursts is not None
    assert not bursts.found


def slow_strokes(model, noise=1e-8, seed=1):  # type: ignore[no-untyped-def]
    """What slow strokes show of a machine, and the trial under the plain spring."""
    t = STEP * np.arange(5000)
    u = 2.0 * np.sin(2 * np.pi * 0.7 * t) ** 3
    clean = model.base.simulator.run(model.effects, feedforward=u).y
    y = clean + noise * np.random.default_rng(seed).standard_normal(len(t))
    r = Recording(t, 0 * u, u, u, y, sample_time=STEP)
    return prepare(Base.of(model.base.plant).simulator, r, noise)


@pytest.mark.parametrize(
    ("name", "value", "effect"),
    [
        ("mass", 0.1, EffectSpec("mass_change", {"change": 0.1})),
        ("stiffness", 0.1, EffectSpec("linear_stiffness", {"stiffness": 0.1 * MASS * W**2})),
        ("damping", 5.0, EffectSpec("viscous_friction", {"coefficient": 5.0 * MASS})),
    ],
)
def test_a_correction_of_a_spring_stage_is_the_effect_it_grows_into(spring, name, value, effect):
    """Mass is inertia, not the gain: what holds the stage still at a command stays what it is."""
    base = Base.of(spring)
    values = {**dict.fromkeys(("mass", "damping", "stiffness"), 0.0), name: value}
    ours = base.simulator.with_mechanics(corrected(base.simulator.mechanics, values))
    u = np.sin(2 * np.pi * 20.0 * STEP * np.arange(1000) ** 1.02)
    wanted = base.simulator.run((effect,), feedforward=u).y
    np.testing.assert_allclose(ours.run((), feedforward=u).y, wanted, atol=1e-6 * np.ptp(wanted))


@pytest.mark.parametrize("name", ["spring_stage", "printer"])
def test_a_mass_in_every_mode_is_the_correction_it_grows_out_of(spring, name):
    """Where the modes' shapes stay and all moves less, no point of the machine holds the mass."""
    plant = spring if name == "spring_stage" else load_plant("plants/flatbed_printer.toml")
    base = Base.of(plant)
    ours = base.simulator.with_mechanics(corrected(base.simulator.mechanics, {"mass": -0.08}))
    effect = EffectSpec("mass_change", {"change": -0.08}, {"side": "all"})
    u = np.sin(2 * np.pi * 20.0 * plant.sample_time * np.arange(1000) ** 1.02)
    wanted = base.simulator.run((effect,), feedforward=u).y
    np.testing.assert_allclose(ours.run((), feedforward=u).y, wanted, atol=1e-6 * np.ptp(wanted))


def test_a_mass_that_slow_motion_hardly_shows_is_found_in_few_steps(spring):
    """As gain and stiffness that must move together along a bent valley it took more rounds than a
    hypothesis has; what was added next had the rest of the way for its own."""
    effect = EffectSpec("mass_change", {"change": 0.12})
    trial = slow_strokes(Model(Base.of(spring), effects=(effect,)))
    scene = Scene(spring.loop, (trial,), Noise(1e-8, 1e-6))
    found = fit(scene, Model(Base.of(spring)), rounds=6)
    assert found.status == "converged"
    assert found.model.corrections["mass"] == pytest.approx(0.12, abs=0.01)
    size = sizes(scene, found.model)
    assert size["mass"] == pytest.approx(0.12, abs=0.01)
    assert abs(size["stiffness"]) < 1e-3


@pytest.mark.parametrize("stated", [True, False])
def test_a_mode_that_is_missing_is_no_reason_to_give_up_a_noise_that_is_stated(spring, stated):
    """Its power asks for force noise that the stage's own resonance would make far more of."""
    mode = EffectSpec("flexible_mode", {"frequency": 70.0, "damping": 0.01, "mass_fraction": 0.1})
    base, rng = Base.of(spring), np.random.default_rng(2)
    t = STEP * np.arange(5000)
    u = np.sin(2 * np.pi * 70.0 * t) + rng.standard_normal(len(t))
    y = base.simulator.run((mode,), feedforward=u).y
    trial = prepare(base.simulator, Recording(t, 0 * u, u, u, y, sample_time=STEP), 1e-9)
    noise = Noise(1e-9, 0.01)
    scene = Scene(spring.loop, (trial,), noise, loudest=noise.scaled(3.0) if stated else None)
    assert too_loud(scene, Model(base)) is not stated


@pytest.mark.parametrize(("change", "named"), [(0.0, ()), (0.12, ("mass_change",))])
def test_a_mass_beyond_the_line_must_earn_its_name(spring, monkeypatch, change, named):
    """A standard error says how steep the valley is if the noise is what it was taken for."""
    monkeypatch.setattr(Fit, "spread_of", lambda found, name: 1e-3)
    loud = 1e-5 if not change else 1e-8  # of 1e-5 m: nothing can be seen of a mass
    effects = (EffectSpec("mass_change", {"change": change}),) if change else ()
    trial = slow_strokes(Model(Base.of(spring), effects=effects), noise=loud)
    scene = Scene(spring.loop, (trial,), Noise(loud, 1e-6))
    far = judge(scene, None, Model(Base.of(spring), {"mass": change or -0.13}), rounds=0)
    assert across_the_line(scene, None, far).model.names == named


NOISY_SENSOR = Imperfections(1e-9, 2e-9, 0.05, None)


def _swinging(top: float, rest: int = 0) -> Recording:
    """A slow swing of 1 mm under a drive that goes on, cut at `top`; or a stay of `rest` samples where it
    turns."""
    rng = np.random.default_rng(0)
    turn = np.arange(2000) % 250 == 62  # nearest to the top of the sine
    phase = 2 * np.pi * np.repeat(np.arange(2000), np.where(turn, 1 + rest, 1))[:2000] / 250.0
    y = np.clip(1e-3 * np.sin(phase), -top, top) + 2e-9 * rng.standard_normal(2000)
    t = 1e-3 * np.arange(2000)
    u = np.cos(2 * np.pi * t / 0.25)
    return Recording(t=t, r=0 * t, f=u, u=u, y=y, d=None, sample_time=1e-3, source="made here")


def test_a_play_that_turns_once_at_the_top_is_no_limit():
    """To the last digit it stands still there, as an encoder shows it, but it came slowly and once."""
    step = 1e-3
    x = np.cumsum(np.sin(2 * np.pi * np.arange(4000) / 400.0)) * np.linspace(0.5, 1.0, 4000)
    y = np.empty(4000)
    edge = 0.0
    for k, place in enumerate(x):
        edge = min(max(edge, place - 4.0), place + 4.0)
        y[k] = np.round(edge / 1e-4) * 1e-4
    plant = Plant("stage", Zpk([], [0.8, 0.9], 1e-6, step), None, machine=NOISY_SENSOR)
    t = step * np.arange(4000)
    assert clipping(plant, [replace(_swinging(1.0, 0), t=t, r=0 * t, f=x, u=x, y=y)]) is None
    limit = np.minimum(y, 0.9 * y.max())
    found = clipping(plant, [replace(_swinging(1.0, 0), t=t, r=0 * t, f=x, u=x, y=limit)])
    assert found is not None
    assert found.parameters["level"] == pytest.approx(0.9 * y.max())


@pytest.mark.parametrize(
    ("top", "rest", "seen"), [(8e-4, 0, True), (2e-3, 0, False), (2e-3, 30, False)]
)
def test_a_clipped_sensor_shows_its_own_noise_alone(top, rest, seen):
    """What stops suddenly at one value is cut; what turns, or sticks where it turns, is not."""
    plant = Plant("stage", Zpk([], [0.8, 0.9], 1e-6, 1e-3), None, machine=NOISY_SENSOR)
    found = clipping(plant, [_swinging(top, rest)])
    assert (found is not None) is seen
    if found is not None:
        assert found.parameters["level"] == pytest.approx(top, abs=2e-9)


@pytest.mark.parametrize(("error", "named"), [(-0.1, ()), (30.0, ("viscous_friction",))])
def test_damping_said_twice_is_said_once(spring, error, named):
    """More at one point and less as a whole: what counts is what it comes to."""
    base = Base.of(spring)
    own = 2.0 * DAMPING * W
    machine = Model(base, {"damping": error * own})
    trial = slow_strokes(machine, noise=1e-8)
    scene = Scene(spring.loop, (trial,), Noise(1e-8, 1e-6))
    extra = EffectSpec("viscous_friction", {"coefficient": MASS * 3.0 * own})
    twice = replace(machine, corrections={"damping": (error - 3.0) * own}, effects=(extra,))
    found = across_the_line(scene, None, judge(scene, None, twice, rounds=0)).model
    assert found.names == named


@pytest.mark.parametrize(
    ("effect", "start"),
    [
        (EffectSpec("constant_load", {"force": 3.0}), 0.0),
        (EffectSpec("drift", {"amplitude": 3.0, "time_constant": 2.0}), 40.0),
    ],
    ids=["load", "drift"],
)
def test_a_stage_on_a_spring_begins_where_its_forces_balance(spring, effect, start):
    """It stands at (command + force) / stiffness, and stays there."""
    n = 400
    t, zero = start + STEP * np.arange(n), np.zeros(n)
    rest = (HELD + 3.0) / (MASS * W**2)
    y = rest + 1e-9 * np.random.default_rng(0).standard_normal(n)
    held = zero + HELD
    recording = Recording(t=t, r=zero, f=held, u=held, y=y, d=None, sample_time=STEP, source="")
    model = Model(Base.of(spring))
    trial = prepare(model.base.simulator, recording, 1e-9)
    assert trial.at_rest
    stood = model.with_effect(effect).simulate(trial).y
    np.testing.assert_allclose(stood, rest, rtol=1e-6)
    bare = model.simulate(trial).y  # without the force: elsewhere, and as still
    np.testing.assert_allclose(bare, HELD / (MASS * W**2), rtol=1e-9)


def test_a_spring_with_its_centre_is_no_worse_for_a_doubt_that_it_is_not_granted(
    spring, monkeypatch
):
    """Recordings that judge grant a correction what the fitted ones leave open of it, and an effect
    nothing: the same machine in other words seemed 45 behind, and a load stayed beside its spring."""
    values = {"stiffness": 0.12 * MASS * W**2, "centre": 2e-5}
    machine = Model(Base.of(spring), effects=(EffectSpec("linear_stiffness", values),))
    first, other = (slow_strokes(machine, seed=k) for k in (1, 2))
    scene = Scene(spring.loop, (first,), Noise(1e-8, 1e-6))
    held = replace(scene, trials=(other,))
    load = EffectSpec("constant_load", {"force": values["stiffness"] * values["centre"]})
    base = Base.of(spring, float(np.ptp(first.y)))
    judged = judge(scene, held, Model(base, {"stiffness": 0.12}, (load,)), rounds=6)
    real = line.judge

    def less(*args, **options):  # type: ignore[no-untyped-def]
        found = real(*args, **options)
        lost = 50.0 if "linear_stiffness" in found.model.names else 0.0
        return replace(found, held_out=found.held_out - lost)

    monkeypatch.setattr(line, "judge", less)
    found = across_the_line(scene, held, judged).model
    assert found.names == ("linear_stiffness",)
    assert found.effects[0].parameters["centre"] == pytest.approx(2e-5, rel=0.05)

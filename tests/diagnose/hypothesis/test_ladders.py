"""Starts where first orders have nothing to propose."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.ladders import evened, overlooked, relieved, with_best_start
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.screen.candidate import Candidate
from ffl.diagnose.screen.screen import Screen, _deepest
from ffl.machines import SimulatedMachine
from ffl.systems import Plant, Zpk
from ffl.systems.plant import EffectSpec, Imperfections, Physics


def test_a_limit_that_the_simulation_never_reaches_is_tried(stage, record, scenes):
    machine = replace(stage, effects=(EffectSpec("saturation", {"limit": 1.3}),))
    scene, _, model = scenes(record(machine))
    like = fit(scene, model, rounds=0)
    base = SimpleNamespace(fit=like)
    (found,) = overlooked(scene, base, like, [], [], taken={"backlash"})
    assert 1.1 < found.spec.parameters["limit"] < 1.5
    assert overlooked(scene, base, like, [], [], taken={"saturation", "backlash"}) == []


@pytest.mark.parametrize(("times", "seen"), [(2.5, True), (1.8, True), (1.005, False)])
def test_a_limit_is_tried_wherever_noise_leaves_room_for_one(stage, record, scenes, times, seen):
    """Under noise that takes what is left for `times` its own size nothing is far, and first order is
    as blind to it. Where noise is half of it a limit has to take more off than anyone listed."""
    machine = replace(stage, effects=(EffectSpec("saturation", {"limit": 1.3}),))
    scene, _, model = scenes(record(machine))
    cost = fit(scene, model, rounds=0).cost / scene.samples
    loud = replace(scene, noise=scene.noise.scaled(np.sqrt(cost / times)))
    like = fit(loud, model, rounds=0)
    assert not like.far
    found = overlooked(loud, SimpleNamespace(fit=like), like, [], [], taken={"backlash"})
    assert [c.spec.name for c in found] == (["saturation"] if seen else [])
    if times < 2.0 and seen:
        (limit,) = found
        more = [replace(limit, gain=limit.gain + 1.0)]
        assert overlooked(loud, SimpleNamespace(fit=like), like, [], more, {"backlash"}) == []


def test_a_part_that_knocks_is_tried_under_noise_as_loud_as_what_it_leaves(stage, record, scenes):
    """First order knows the play of what is measured, which is none."""
    behind = EffectSpec("backlash", {"gap": 1e-4}, {"kind": "load", "measured": "motor"})
    scene, _, model = scenes(record(replace(stage, effects=(behind,))))
    cost = fit(scene, model, rounds=0).cost / scene.samples
    loud = replace(scene, noise=scene.noise.scaled(np.sqrt(cost)))
    like = fit(loud, model)
    base = SimpleNamespace(fit=like)
    (found,) = overlooked(loud, base, like, [], [])
    assert found.spec.name == "backlash"
    assert found.spec.options["kind"] == "load"
    assert 3e-5 < found.spec.parameters["gap"] < 3e-4
    assert overlooked(loud, base, like, [], [found]) == []
    assert overlooked(loud, base, like, [], [], taken={"backlash"}) == []


def test_nothing_is_overlooked_where_the_simulation_is_near(stage, record, scenes):
    scene, held, model = scenes(record(stage))
    base = judge(scene, held, model)
    assert overlooked(scene, base, base.fit, [], []) == []


LIGHT = {"frequency": 33.0, "damping": 0.01, "mass_fraction": 0.04}


def test_a_light_mode_begins_in_its_own_valley(stage, record, scenes):
    """First order in its mass sees a slow mode of half the machine before it, where the damping stands
    in for what rings."""
    machine = replace(stage, effects=(EffectSpec("flexible_mode", LIGHT),))
    scene, _, model = scenes(record(machine))
    like = fit(scene, model)
    (seen,) = Screen(scene, like).candidates(["flexible_mode"])
    begun = with_best_start(scene, seen).effects[-1].parameters
    assert begun["frequency"] == pytest.approx(LIGHT["frequency"], rel=0.1)
    astray = replace(seen, spec=replace(seen.spec, parameters=LIGHT | {"frequency": 300.0}))
    there = replace(astray, valleys=(EffectSpec("flexible_mode", LIGHT, seen.spec.options),))
    begun = with_best_start(scene, there).effects[-1].parameters
    assert begun["frequency"] == LIGHT["frequency"]


def test_masses_are_evened_where_their_ratio_stands_at_a_bound(two_masses):
    model = Model(Base.of(two_masses))

    def of(ratio):
        at = [{"side": side, "mass_ratio": ratio} for side in ("load", "motor")]
        effects = (
            EffectSpec("coulomb_friction", {"level": 1.0}, at[0]),
            EffectSpec("viscous_friction", {"coefficient": 1.0}, at[1]),
        )
        return replace(model, effects=effects)

    assert evened(of(3.0)) is None
    assert evened(model) is None
    for ratio in (0.05, 19.9):
        other = evened(of(ratio))
        assert [spec.options["mass_ratio"] for spec in other.effects] == [1.0, 1.0]
        assert [spec.options["side"] for spec in other.effects] == ["load", "motor"]


def test_every_peak_of_the_gain_is_a_valley_of_the_cost():
    gains = {10.0: 1.0, 20.0: 50.0, 30.0: 2.0, 40.0: 90.0, 50.0: 3.0, 60.0: 40.0}
    tops = {
        f: Candidate(EffectSpec("flexible_mode", {"frequency": f}), gain, 1, Place("force"), None)
        for f, gain in gains.items()
    }
    best = _deepest(tops)
    assert best.spec.parameters["frequency"] == 40.0
    assert [spec.parameters["frequency"] for spec in best.valleys] == [20.0, 60.0]


def oscillator(stiffness: float, source: str = "") -> Plant:
    """2 kg, 10 N s/m on a spring (N/m), 750 Hz, newton in, metres out."""
    step, w = 1.0 / 750.0, np.sqrt(stiffness / 2.0)
    pole = np.exp(step * (-2.5 + 1j * np.sqrt(w**2 - 2.5**2)))
    gain = abs(1.0 - pole) ** 2 / (2.0 * stiffness)
    system = Zpk(np.array([-1.0]), np.array([pole, pole.conjugate()]), gain, step)
    return Plant("oscillator", system, None, "N", "m", source, Physics(2.0, None))


LOOP = EffectSpec(
    "hysteresis",
    {"force": 167.0, "displacement": 3.3e-3, "exponent": 1.0, "beta": 2.7},
    {"kind": "hardening"},
)


@pytest.mark.parametrize("name", ["hysteresis", "hardening_spring"])
def test_an_identified_spring_gives_way_to_what_holds_beside_it(name):
    """Noel and Schoukens' oscillator: half of the stiffness is that of the hysteresis."""
    learned = oscillator(1e5, "ffl identify linear, output_error")
    spec = (
        LOOP if name == LOOP.name else EffectSpec(name, {"cubic_coefficient": 1e9, "centre": 0.0})
    )
    model = relieved(Model(Base.of(learned), {}, (spec,)))
    if name == LOOP.name:
        assert model.corrections["stiffness"] == pytest.approx(-167.0 / 3.3e-3 / 1e5, rel=1e-3)
    else:
        assert model is None  # it holds with nothing where it is small
    assert relieved(Model(Base.of(oscillator(1e5)), {}, (spec,))) is None  # stated: an engineer's
    soft = oscillator(4e4, "ffl identify linear, output_error")
    assert relieved(Model(Base.of(soft), {}, (spec,))) is None  # softer than the hysteresis


@pytest.mark.slow(15)
def test_a_hysteresis_as_stiff_as_the_spring_is_named_beside_an_identified_model():
    """It was called a cogging, with 0.97: the best start of the hysteresis was next to none of it."""
    built = replace(oscillator(5e4), effects=(LOOP,), machine=Imperfections(0.0, 8e-6, 0.0, None))
    device, recordings = SimulatedMachine(built), []
    for seed, (low, high) in enumerate(((5.0, 150.0), (20.0, 50.0))):
        rng, n = np.random.default_rng(seed), 2500
        lines = np.fft.rfftfreq(n, 1.0 / 750.0)
        phases = np.exp(2j * np.pi * rng.random(len(lines)))
        force = np.fft.irfft(np.where((lines > low) & (lines < high), phases, 0.0), n)
        force *= 50.0 / np.std(force)
        recordings.append(device.run(np.zeros(n), force, rng))
    fitted, judging = recordings
    learned = oscillator(0.92e5, "ffl identify linear, output_error")
    (found,) = diagnose(learned, [fitted], [judging]).findings
    assert found.name == "hysteresis"
    assert found.parameters["displacement"].value == pytest.approx(3.3e-3, rel=0.1)

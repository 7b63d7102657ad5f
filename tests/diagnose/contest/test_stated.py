"""An effect for a number of the model that nobody can have got so wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.contest import search
from ffl.diagnose.contest.earning import earns
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.settle import KEEP
from ffl.diagnose.contest.stated import begun_as_stated, far_off, in_their_place, let_free
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.systems.plant import EffectSpec

STEP = 1e-3
LAG = EffectSpec("actuator_lag", {"time_constant": 3e-3})
LIMIT = EffectSpec("saturation", {"limit": 8.0})
DAMPER = EffectSpec("viscous_friction", {"coefficient": 150.0})


@pytest.fixture(scope="module")
def spring(on_a_spring):  # type: ignore[no-untyped-def]
    """2 kg on a spring of 30 Hz with damping 0.05, shaken by noise."""
    return on_a_spring(2.0, 30.0, 0.05, STEP, sensor_noise=5e-9, force_noise=0.05)


@pytest.fixture(scope="module")
def moves():
    """Commands below the resonance, one for each recording."""
    t = STEP * np.arange(4000)
    rows = [(0.7, 6.9, 10.0), (0.9, 7.7, 7.0), (1.3, 7.1, 9.0)]
    return [
        top * np.sin(2 * np.pi * slow * t) * np.sin(2 * np.pi * fast * t)
        for slow, fast, top in rows
    ]


@pytest.fixture(scope="module")
def recorded(spring, moves):
    """Recordings of the stage with effects."""

    def of(*effects):
        device, rng = SimulatedMachine(replace(spring, effects=effects)), np.random.default_rng(4)
        return [device.run(np.zeros_like(f), f, rng) for f in moves]

    return of


@pytest.fixture(scope="module")
def judged(spring, recorded):
    """(nothing, judged; held-out scene) of a stage with effects."""

    def of(*effects):
        base = Base.of(spring)
        first, second, last = (prepare(base.simulator, r, 5e-9) for r in recorded(*effects))
        noise = Noise(5e-9, 0.05)
        held = Scene(spring.loop, (last,), noise)
        return judge(Scene(spring.loop, (first, second), noise), held, Model(base)), held

    return of


def test_what_comes_late_is_damping_far_from_what_the_model_states(judged):
    nothing, _ = judged(LAG)
    assert far_off(nothing) == {"damping"}
    assert far_off(judged()[0]) == frozenset()


def test_a_lag_in_the_place_of_a_damping_is_likelier(judged):
    nothing, held = judged(LAG)
    quiet = nothing.scene
    beside = judge(quiet, held, nothing.model.with_effect(LAG), 0)
    (free,) = begun_as_stated(quiet, held, nothing, [beside])
    assert not free.model.unmoved
    (kept,) = in_their_place(quiet, held, nothing, [beside], KEEP)
    assert kept.model.unmoved == {"damping"}
    assert "damping" not in kept.model.corrections
    worse = nothing.model.with_effect(EffectSpec("constant_load", {"force": 0.0}))
    assert in_their_place(quiet, held, nothing, [judge(quiet, held, worse, 0)], KEEP) == []


def test_it_is_free_again_beside_who_took_its_place(judged):
    nothing, held = judged(LAG)
    beside = judge(nothing.scene, held, nothing.model.with_effect(LAG), 0)
    (kept,) = in_their_place(nothing.scene, held, nothing, [beside], KEEP)
    free = let_free(held, kept)
    assert not free.model.unmoved
    own = 2 * 0.05 * 2 * np.pi * 30.0
    assert abs(free.model.corrections["damping"]) < 0.5 * own
    assert let_free(held, free) is free


def test_a_number_stays_as_stated_where_its_own_effect_stands_for_it(judged):
    """Free beside a damper it would trade against it, and neither be told."""
    nothing, held = judged(DAMPER)
    model = replace(nothing.model.with_effect(DAMPER), unmoved=frozenset({"damping"}))
    standing = judge(nothing.scene, held, model, 4)
    assert let_free(held, standing) is standing


def test_nobody_is_begun_otherwise_where_nothing_is_far_off(judged):
    nothing, held = judged()
    rival = judge(nothing.scene, held, nothing.model.with_effect(LAG), 0)
    assert begun_as_stated(nothing.scene, held, nothing, [rival]) == []
    assert in_their_place(nothing.scene, held, nothing, [rival], KEEP) == []


def test_beside_a_limit_a_lag_joins_in_the_place_of_the_damping(spring):
    """In noise as loud as here it brings too little for one effect more, and enough for the damping."""
    loud = replace(spring, machine=replace(spring.machine, force_noise=0.45))
    device, rng = SimulatedMachine(replace(loud, effects=(LIMIT, LAG))), np.random.default_rng(8)
    t, noise, base = STEP * np.arange(4000), Noise(5e-9, 0.45), Base.of(loud)
    first, second, last = (
        prepare(base.simulator, device.run(np.zeros_like(f), f, rng), 5e-9)
        for f in (
            top * np.sin(2 * np.pi * slow * t) * np.sin(2 * np.pi * fast * t)
            for slow, fast, top in [(0.7, 4.1, 10.0), (0.9, 4.6, 7.0), (1.3, 4.3, 9.0)]
        )
    )
    quiet, held = Scene(loud.loop, (first, second), noise), Scene(loud.loop, (last,), noise)
    limited = judge(quiet, held, Model(base).with_effect(LIMIT), 10)
    assert far_off(limited) == {"damping"}
    lag = fit(quiet, limited.model.with_effect(LAG), rounds=3)
    stands, rivals, joined = search._one_more(quiet, held, limited, [lag], 25.0, lambda line: None)
    assert [rival.name for rival in rivals] == [
        "saturation + actuator_lag"
    ] * 2  # one begun as stated
    assert not any(earns(rival, stands, 25.0) for rival in rivals)
    assert joined is not None
    assert joined.model.names == ("saturation", "actuator_lag")
    assert joined.model.unmoved == {"damping"}


@pytest.mark.slow(25)
@pytest.mark.parametrize("effects", [(LIMIT, LAG), (LIMIT, DAMPER)], ids=["lag", "damper"])
def test_a_limit_has_the_company_that_it_has(spring, recorded, effects):
    """(Beside the limit a lag of 3 ms was a damping of six times the model's.) A damper stays one."""
    *fitted, judging = (recording[:1200] for recording in recorded(*effects))
    answer = diagnose(spring, fitted, [judging]).answer()
    told = {e["name"] for e in answer["effects"]}
    assert told == {spec.name for spec in effects}

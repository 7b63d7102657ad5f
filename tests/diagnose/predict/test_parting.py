"""What free runs of a machine that sticks and slips leave open, an observer tells."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose import diagnose, diagnosis
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.predict import parting
from ffl.diagnose.predict.observer import FIRM, decay_of, led, with_firm_observer
from ffl.diagnose.predict.parting import clearer, hunts, opened, parts
from ffl.diagnose.proof.prove import nrmse, run_plant
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.systems import EffectSpec
from ffl.systems.plant_file import plant_from_dict, plant_to_dict

STEP = 0.001
STICKS = EffectSpec(
    "stribeck_friction", {"coulomb_level": 6.0, "static_level": 9.0, "stribeck_velocity": 0.0025}
)


@pytest.fixture(scope="module")
def spring(on_a_spring):
    """3.3 kg at 20 Hz, force noise of a hundredth of the friction."""
    return on_a_spring(3.3, 20.0, 0.02, STEP, "N", sensor_noise=1e-8, force_noise=0.1)


def waves(seed, samples):
    """A slow wave that gets the machine stuck where it turns, with another on top."""
    t, rng = np.arange(samples) * STEP, np.random.default_rng(seed)
    a, b = rng.uniform(0.0, 2 * np.pi, 2)
    return 40.0 * np.sin(2 * np.pi * 1.3 * t + a) * np.minimum(1.0, t) + 8.0 * np.sin(
        2 * np.pi * 7.0 * t + b
    ) * np.minimum(1.0, t)


@pytest.fixture(scope="module")
def record(spring):
    def of(*effects, samples=4000):
        machine = SimulatedMachine(replace(spring, effects=effects))
        zero = np.zeros(samples)
        return [
            machine.run(zero, waves(k, samples), np.random.default_rng(10 + k)) for k in range(2)
        ]

    return of


@pytest.fixture(scope="module")
def stuck(record):
    return record(STICKS)


def judged(plant, recordings, effects):
    base = Base.of(plant, max(float(np.ptp(r.y)) for r in recordings))
    seen, ahead = (
        Scene(plant.loop, (prepare(base.simulator, r, 1e-8),), Noise(1e-8, 0.1)) for r in recordings
    )
    return judge(seen, ahead, replace(Model(base), effects=effects), 6)


def test_a_firm_observer_keeps_a_margin(spring):
    plant = with_firm_observer(spring)
    sensitivity = plant.loop.system.response(np.linspace(1.0, 499.0, 500))[:, 0, 3]
    assert np.abs(plant.loop.poles).max() < 1.0
    assert 1.5 < np.abs(sensitivity).max() <= FIRM
    assert decay_of(plant) > 10.0 * decay_of(spring)


def test_of_a_linear_machine_both_ways_say_the_same(spring, record):
    """log p(y) of the fitted recording, free and led."""
    recordings = record()
    free = judged(spring, recordings, ()).fitted
    by_observer = judged(with_firm_observer(spring), led(recordings), ()).fitted
    assert by_observer == pytest.approx(free, abs=30.0)


def test_of_one_that_sticks_the_observer_is_the_sharper(spring, stuck):
    firm = with_firm_observer(spring)
    gains = []
    for plant, recordings in ((spring, stuck), (firm, led(stuck))):
        without, named = (judged(plant, recordings, e) for e in ((), (STICKS,)))
        gains.append(named.fitted - without.fitted)
    assert gains[1] > gains[0] + 500.0


@pytest.mark.slow(50)
@pytest.mark.usefixtures("no_play_sought")
def test_what_sticks_is_named_once_led(spring, record, monkeypatch):
    """Of what free runs name, which is dropped, one is looked for: company took half the time."""
    contest = diagnosis.contest

    def brief(scene, *rest, **options):
        return contest(scene, *rest, most=None if scene.observed else 1, **options)

    monkeypatch.setattr(diagnosis, "contest", brief)
    stuck = record(STICKS, samples=2200)
    found = diagnose(spring, stuck[:1], stuck[1:])
    assert [f.name for f in found.findings] == ["stribeck_friction"]
    (friction,) = found.findings
    for name, value in STICKS.parameters.items():
        assert friction.parameters[name].value == pytest.approx(value, rel=0.15), name
    assert any("an observer" in note for note in found.notes)
    assert found.augmented.controller is None
    trials = [prepare(Base.of(spring).simulator, stuck[1], 1e-8)]
    runs = [run_plant(plant_from_dict(plant_to_dict(found.augmented)), t).y for t in trials]
    free = nrmse([t.y for t in trials], runs)  # from rest; the proof's start is fitted
    assert max(free, found.proof.nrmse_after) < 0.3 * found.proof.nrmse_before
    assert free == pytest.approx(found.proof.nrmse_after, rel=0.5)


def test_what_free_runs_explain_is_not_looked_at_again(spring, record):
    recordings = record(EffectSpec("quadratic_drag", {"coefficient": 4e4}), samples=2500)
    found = diagnose(spring, recordings[:1], recordings[1:])
    assert found.verdict == "explained"
    assert not parts(found)
    assert (
        clearer(found, replace(found, verdict="nothing_missing"), np.random.default_rng(0)) is found
    )


@pytest.mark.parametrize(
    ("verdict", "led_map", "after", "with_map", "asked"),
    [
        ("unnamed", False, 0.3, None, True),  # bursts: no map, no file
        ("unnamed", False, 0.1, None, False),  # lost commands, which are taken out
        ("unnamed", True, 0.3, 0.05, True),
        ("unnamed", False, 0.3, 0.05, False),
        ("unnamed", False, 0.3, 0.2, True),
        ("nothing_missing", False, 0.3, None, False),
    ],
)
def test_what_has_no_name_by_free_runs_that_part_is_looked_at_again(
    spring, stuck, verdict, led_map, after, with_map, asked
):
    """Cogging holds a stage on a spring here or there: bursts are left, or a map as measured."""
    one = judged(spring, stuck, ())
    proof = SimpleNamespace(
        nrmse_before=0.3, nrmse_after=after, nrmse_with_map=with_map, noise_floor=0.01
    )
    found = SimpleNamespace(
        judged=replace(one, held=one.scene),
        verdict=verdict,
        nameless=SimpleNamespace(led=led_map),
        proof=proof,
        plant=spring,
    )
    assert parts(found) is asked


@pytest.mark.parametrize(
    ("fitted", "held", "verdict", "wins"),
    [
        (40.0, 2000.0, "explained", True),
        (40.0, 2000.0, "partly_explained", False),
        (40.0, 30.0, "explained", False),
        (-5.0, 2000.0, "explained", False),
        (90.0, 90.0, "partly_explained", True),
    ],
)
def test_what_explains_all_need_not_fit_better(monkeypatch, fitted, held, verdict, wins):
    """Wrong names fit one wave as well as right ones, and no other."""
    assert _wins(monkeypatch, fitted, held, verdict, 0.01) is wins


@pytest.mark.parametrize(
    ("fitted", "held", "verdict", "wins"),
    [
        (5000.0, 5000.0, "explained", True),
        (5000.0, 5000.0, "partly_explained", False),
        (5000.0, 500.0, "explained", False),
        (500.0, 5000.0, "explained", False),
    ],
)
def test_beside_what_explains_all_by_far_free_runs_say_nothing(
    monkeypatch, fitted, held, verdict, wins
):
    """Of a machine that cogging holds here or there its own free run leaves more than the model's."""
    assert _wins(monkeypatch, fitted, held, verdict, 0.4) is wins


def _wins(monkeypatch, fitted, held, verdict, after):
    """Whether the observer's diagnosis, so far ahead, is the answer; the model alone leaves 0.3."""
    free, led_by = (
        SimpleNamespace(proof=None, plant=SimpleNamespace(controller=None)),
        SimpleNamespace(verdict=verdict, judged=SimpleNamespace(predicted=False)),
    )
    worth = {id(free): (0.0, 0.0), id(led_by): (fitted, held)}
    proof = SimpleNamespace(nrmse_before=0.3, nrmse_after=after)
    monkeypatch.setattr(parting, "_likelihoods", lambda one: worth[id(one)])
    monkeypatch.setattr(parting, "_free_proof", lambda *_: proof)
    monkeypatch.setattr(parting, "replace", lambda again, **changed: "led")
    led_by.notes = ()
    return clearer(free, led_by, np.random.default_rng(0)) == "led"


@pytest.mark.parametrize(
    ("verdict", "stated", "known", "asked"),
    [
        ("inconclusive", True, True, True),
        ("partly_explained", True, True, False),
        ("inconclusive", False, True, False),
        ("inconclusive", True, False, False),
    ],
)
def test_a_loop_that_did_not_hold_is_asked_along_its_command(
    spring, stuck, verdict, stated, known, asked
):
    one = judged(spring, stuck, ())
    scene = one.scene
    if not known:
        trials = tuple(replace(t, u=np.full_like(t.u, np.nan)) for t in scene.trials)
        scene = replace(scene, trials=trials)
    plant = replace(spring, controller=object()) if stated else spring
    found = SimpleNamespace(judged=replace(one, held=scene), verdict=verdict, plant=plant)
    assert hunts(found) is asked


def test_a_loop_without_its_controller_is_driven_by_its_command(stuck):
    loop = [replace(r, r=r.y, f=0.1 * r.u) for r in stuck]
    for before, after in zip(loop, opened(loop), strict=True):
        np.testing.assert_array_equal(after.f, before.u)
        assert not after.r.any()
        assert "r" in after.missing


@pytest.mark.parametrize(("controller", "way"), [(None, "an observer"), ("its own", "the command")])
def test_the_way_it_was_told_is_said(monkeypatch, controller, way):
    free = SimpleNamespace(proof=None, plant=SimpleNamespace(controller=controller))
    again = SimpleNamespace(
        verdict="explained", judged=SimpleNamespace(predicted=False), notes=("before",)
    )
    monkeypatch.setattr(
        parting, "_likelihoods", lambda one: (0.0, 0.0) if one is free else (1e4, 1e4)
    )
    monkeypatch.setattr(
        parting, "_free_proof", lambda *_: SimpleNamespace(nrmse_before=1.0, nrmse_after=0.1)
    )
    monkeypatch.setattr(parting, "replace", lambda _, **changed: changed["notes"])
    first, said = clearer(free, again, np.random.default_rng(0))
    assert first == "before"
    assert way in said

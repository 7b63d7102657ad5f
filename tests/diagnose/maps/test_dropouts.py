"""Commands that did not arrive are found by themselves, and neither noise, a delay nor knocks are taken
for them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from ffl.diagnose import diagnose
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.maps.dropouts import (
    RATES,
    Search,
    _heard_through,
    _searched,
    dropouts,
    expected,
)
from ffl.diagnose.maps.unnamed import _lost, _over_a_delay
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec

FAINT = 2e-3  # m, a move in which hardly a sample would be certain by itself


def recorded(plant, reference, lost, seed, effects=(), knock=0.0):  # type: ignore[no-untyped-def]
    """The stage whose drive keeps the command before at the samples `lost`: found by repetition, since
    what is lost moves the machine and so the commands."""
    rng = np.random.default_rng(seed)
    n = len(reference)
    simulator, noise = Simulator(plant), plant.machine
    shaken = noise.force_noise * rng.standard_normal(n) + knock
    seen = noise.sensor_noise * rng.standard_normal(n)
    kept = np.maximum.accumulate(np.where(lost, 0, np.arange(n)))
    missing = np.zeros(n)
    for _ in range(30):
        run = simulator.run(effects, reference, force=shaken + missing, noise=seen)
        missing = run.u[kept] - run.u
    return Recording(
        run.t, np.asarray(reference), np.zeros(n), run.u, run.y, sample_time=plant.sample_time,
        source=f"run_{seed}.csv",
    )  # fmt: skip


def lost_at(n, share, seed):  # type: ignore[no-untyped-def]
    lost = np.random.default_rng(seed).random(n) < share
    lost[0] = False
    return lost


@pytest.fixture(scope="module")
def losing(stage, references):  # type: ignore[no-untyped-def]
    return [
        recorded(stage, r, lost_at(len(r), 0.05, 7 + k), k) for k, r in enumerate(references[:2])
    ]


def test_lost_commands_are_found_and_what_they_did_is_explained(stage, losing, scenes):  # type: ignore[no-untyped-def]
    scene, held, model = scenes(losing)
    found = dropouts(scene, held, model)
    assert found is not None
    true = lost_at(scene.samples, 0.05, 7)
    force = np.abs(
        found.fitted.scene.trials[0].load
    )  # of a sample that may have been lost, its share
    near = np.convolve(true, np.ones(3), "same") > 0  # a force's own sample is hardly seen
    assert np.sum(force[near]) > 0.5 * np.sum(force)  # 0.14 of all samples
    beside = found.fitted.scene.residuals(found.fit.model)
    assert beside is not None
    assert np.mean(found.fitted.scene.whiten(beside) ** 2) < 1.2
    assert min(found.gains(scene, held, model)) > 100.0


@pytest.mark.parametrize("what", ["noise", "delay", "knocks"])
def test_nothing_else_is_taken_for_lost_commands(stage, references, what, scenes):  # type: ignore[no-untyped-def]
    effects = (EffectSpec("input_delay", {"delay": 1e-3}),) if what == "delay" else ()
    runs = []
    for k, r in enumerate(references[:2]):
        knock = np.zeros(len(r))
        if what == "knocks":
            for at in (300, 900, 1500):
                knock[at : at + 40] = 0.3
        runs.append(recorded(stage, r, np.zeros(len(r), bool), k, effects, knock))
    scene, held, model = scenes(runs)
    found = dropouts(scene, held, model)
    standing = replace(model, effects=effects)
    assert found is None or min(found.gains(scene, held, standing)) < 0


@pytest.mark.parametrize(
    ("gains", "confirmed", "over"),
    [
        ((1.1, -0.1), False, True),  # times what it brings in the fitted recordings
        ((0.1, 9.0), True, True),  # what these hardly show the others do
        ((0.1, 9.0), False, False),
        ((0.1, 0.5), True, False),
    ],
)
def test_a_delay_that_stands_is_charged_for_what_it_brings(
    stage, references, scenes, gains, confirmed, over
):  # type: ignore[no-untyped-def]
    late = (EffectSpec("input_delay", {"delay": 5e-4}),)
    runs = []
    for k, r in enumerate(references[:2]):
        runs.append(recorded(stage, r, np.zeros(len(r), bool), 1 + k, late))
    scene, held, model = scenes(runs)
    lost = SimpleNamespace(
        fitted=SimpleNamespace(scene=scene), confirmed=confirmed, held_white=np.zeros(held.samples)
    )
    standing = replace(model, effects=late)
    brought = 0.5 * (fit(scene, model).cost - scene.cost(standing))
    assert brought > 100.0
    first, others = (brought * share for share in gains)
    assert _over_a_delay(lost, (first, others), (scene, held), standing) is over
    assert _over_a_delay(lost, (first, others), (scene, held), model)  # nothing to be charged for


def test_noise_that_commands_foretell_is_none_lost(stage, references, scenes):  # type: ignore[no-untyped-def]
    """In a loop the command answers a slow force, and foretells what that does next: under white noise it
    looks as if commands were lost, as heard it does not."""
    step = stage.sample_time
    white, slow, corner = stage.machine.force_noise, 8e-3, 15.0
    keeps = np.exp(-2.0 * np.pi * corner * step)
    runs = []
    for k, r in enumerate(references[:2]):
        new = np.random.default_rng(50 + k).standard_normal(len(r))
        shaken = lfilter([slow * np.sqrt(1.0 - keeps**2)], [1.0, -keeps], new)
        runs.append(recorded(stage, r, np.zeros(len(r), bool), k, knock=shaken))
    scene, held, model = scenes(runs)
    heard = replace(
        scene, noise=replace(scene.noise, force=white, force_coloured=slow, force_corner=corner)
    )
    least = _searched(scene, model, RATES)
    assert least is not None
    assert least.gain > 40.0
    assert not _heard_through(heard, model)
    assert dropouts(heard, held, model) is None


@pytest.mark.parametrize(
    ("gain", "other", "agrees"),
    [(100.0, 70.0, False), (200.0, 140.0, True), (200.0, 160.0, False), (40.0, -10.0, False)],
)
def test_recordings_that_judge_agree_where_a_loop_rings(scenes, losing, gain, other, agrees):  # type: ignore[no-untyped-def]
    scene, _, _ = scenes(losing)
    search = Search(scene, 0.05, 100.0, gain, other, 150.0, 2000.0)
    assert search.agrees is agrees


def test_a_bus_that_loses_commands_is_unnamed(stage, losing):  # type: ignore[no-untyped-def]
    answer = diagnose(stage, losing[:1], losing[1:]).answer()
    assert answer["verdict"] == "unnamed"
    assert answer["effects"] == []
    assert answer["location"]["component"] == "timing"
    assert set(answer["location"]["depends_on"]) == {"command", "time"}
    assert "did not arrive" in answer["location"]["where"]


def test_the_share_that_is_lost_and_nothing_of_the_other_sign(losing, scenes):  # type: ignore[no-untyped-def]
    scene, _, model = scenes(losing)
    search = _searched(scene, model, RATES)
    assert search is not None
    assert search.rate in (
        0.02,
        0.05,
    )  # of 150, those that a stage at rest shows nothing of are not told
    assert 0.02 * scene.samples < search.lost < 0.05 * scene.samples
    assert search.other < 0.1 * search.gain
    assert search.gain == pytest.approx(search.promise, rel=0.5)


@pytest.mark.parametrize("rate", [0.03, 0.2])
def test_what_is_expected_of_lost_samples(rate):  # type: ignore[no-untyped-def]
    """Against draws: the mixture's likelihood over that of no loss."""
    rng = np.random.default_rng(3)
    for worth in (0.05, 1.0, 9.0):
        gone = rng.random(400_000) < rate
        z = rng.standard_normal(len(gone))
        ratio = np.where(gone, worth, -worth) + np.sqrt(2.0 * worth) * z
        brought = np.mean(np.logaddexp(np.log1p(-rate), np.log(rate) + ratio))
        assert expected(np.array([worth]), rate)[0] == pytest.approx(brought, rel=0.05, abs=3e-5)
    assert np.all(expected(np.zeros(10), rate) < 1e-6)


def test_samples_faint_by_themselves_count_together(stage, scenes):  # type: ignore[no-untyped-def]
    """None of them would be certain alone (4 nats at most): the share is found all the same, and forces of
    the other sign bring nothing."""
    t = np.arange(6000) * stage.sample_time
    slow = FAINT * np.sin(2 * np.pi * 3.0 * np.maximum(t - 0.3, 0.0)) ** 2
    runs = [
        recorded(stage, size * slow, lost_at(len(slow), 0.08, 11 + k), k)
        for k, size in enumerate((1.0, 0.8))
    ]
    scene, held, model = scenes(runs)
    found = dropouts(scene, held, model)
    assert found is not None
    assert 0.02 <= found.fitted.rate <= 0.3  # neighbours that look alike share what is lost
    assert found.fitted.other < 0.0 < found.fitted.gain
    assert min(found.gains(scene, held, model)) > 20.0


@pytest.mark.parametrize(
    ("confirmed", "gains", "said"),
    [
        (True, (-22.0, 800.0), True),  # hardly seen where it was fitted, plain where it was not
        (True, (-90.0, 800.0), False),
        (True, (800.0, 10.0), False),
        (False, (800.0, 10.0), True),
        (False, (15.0, 800.0), False),
    ],
)
def test_recordings_that_hardly_show_it_may_lose_a_little(confirmed, gains, said):  # type: ignore[no-untyped-def]
    assert _lost(SimpleNamespace(confirmed=confirmed), *gains) is said


@pytest.mark.parametrize(
    ("rate", "gain", "possible"),
    [(0.2, 30.0, True), (0.2, 120.0, True), (0.2, 209.5, False), (0.3, 120.0, False)],
)
def test_what_brings_more_than_lost_samples_can_is_something_else(rate, gain, possible):
    """A lag in an open stage: 813 fitted, and 210 on the recordings that judge, where the largest rate
    brings 67; a creep at the largest rate itself."""
    assert Search(None, rate, 1074.0, gain, -164.0, 67.0, 67.0).possible is possible  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("gain", "other", "promise", "hinted"),
    [
        (13.0, 0.0, 47.0, True),
        (13.0, 6.0, 47.0, False),
        (4.0, 0.0, 47.0, False),
        (25.9, 0.0, 6.1, False),
    ],
)
def test_what_can_hardly_show_where_it_is_judged_is_hinted_there(gain, other, promise, hinted):
    """Commands lost by a printer: 69 fitted, and 13 of 47 where it is judged, none by the other sign. Null
    37 of seed 2078: 60 fitted, and 26 of 6."""
    search = Search(None, 0.1, 736.0, gain, other, promise, 422.0)  # type: ignore[arg-type]
    assert search.hints is hinted
    assert not search.found


@pytest.mark.parametrize(("rate", "said"), [(0.05, True), (0.1, True), (0.15, False)])
def test_where_no_other_recording_confirms_it_few_samples_are_lost(
    monkeypatch, losing, scenes, rate, said
):
    """Coloured noise is drawn by many samples a little."""
    scene, held, model = scenes(losing)

    def searched(ground, model, rates):  # type: ignore[no-untyped-def]
        brought = 300.0 if len(rates) > 1 else 12.0
        return Search(ground, rate, 40.0, brought, -20.0, brought, 900.0)

    monkeypatch.setattr("ffl.diagnose.maps.dropouts._searched", searched)
    assert (dropouts(scene, held, model) is not None) is said

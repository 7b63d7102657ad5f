"""Who earns a place, by what the recordings that judge show and would have to show."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.signal

from ffl.diagnose.contest import earning, judging
from ffl.diagnose.contest.earning import borne_out, earns
from ffl.diagnose.contest.judging import (
    Judged,
    effective,
    judge,
    levelled,
    noise_error,
    whitened_alike,
)
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.maps import unnamed
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.systems.plant import EffectSpec, Imperfections

SAMPLES, FITTED, PROMISED = 4000, 1478.0, 77.0


class Standing(Judged):
    """A verdict without the fit behind it."""

    freedom = 1
    model = Model(None)  # type: ignore[arg-type]

    @property
    def score(self) -> float:
        return self.fitted + self.held_out


class Further(Standing):
    """The same beside a play."""

    independent = float(SAMPLES)
    model = Model(None, effects=(EffectSpec("backlash", {"gap": 1e-4}),))  # type: ignore[arg-type]


def _judged(white: np.ndarray, fitted: float, kind: type[Standing] = Standing) -> Standing:
    found = SimpleNamespace(white=np.zeros(1000))
    held = -0.5 * effective(white) * float(np.log(np.mean(white**2)))
    scene = SimpleNamespace(observed=False)
    return kind(found, scene, fitted, held, white)  # type: ignore[arg-type]


def test_held_out_gains_count_in_equally_many_samples():
    """A slow residual of four times the size is not hardly worse than a white one."""
    rng = np.random.default_rng(0)
    white = rng.standard_normal(600)
    slow = 4.0 * np.sin(np.linspace(0.0, 6.0, 600))
    base, rival = (_judged(w, fitted) for w, fitted in ((slow, 0.0), (white, 50.0)))
    assert earns(rival, base, 25.0)
    assert not earns(base, rival, 0.0)


def test_the_likeliest_is_told_in_equally_many_samples():
    """What is far off leaves a slow residual, few samples by its own count, and so little to lose."""
    rng = np.random.default_rng(0)
    near = _judged(1.3 * rng.standard_normal(600), 50.0)
    far = _judged(3.0 * np.sin(np.linspace(0.0, 6.0, 600)), 50.0)
    assert far.score > near.score
    assert judging.likeliest([far, near]).held_white is near.held_white


def _changed(promised: float, shown: float) -> tuple[np.ndarray, np.ndarray]:
    """Held-out residuals that differ by so many nats, of which the second gains the share `shown`."""
    rng = np.random.default_rng(0)
    before = rng.standard_normal(SAMPLES)
    size = np.linalg.norm(before)
    other = rng.standard_normal(SAMPLES)
    other -= (other @ before) / size**2 * before
    cosine = np.sqrt(0.5 * promised) / size  # mirrored: 0.5 |difference|^2 = promised
    mirror = cosine * before / size + np.sqrt(1 - cosine**2) * other / np.linalg.norm(other)
    after = before - 2.0 * (before @ mirror) * mirror
    return before, after * np.exp(-shown * promised / SAMPLES)


@pytest.mark.parametrize(
    ("samples", "shown", "earned"),
    [
        (4000, 0.0, False),
        (4000, 0.05, False),
        (4000, 0.15, True),
        (1400, 0.0, True),
        (1400, -0.1, True),
        (1400, -0.3, False),
    ],
)
def test_what_would_show_where_it_is_judged_must_show_there(monkeypatch, samples, shown, earned):
    """A further effect changes what is left there by 77 nats: a tenth of them at least it must gain. But
    one that brings the fitted recordings more than a nat a sample may lose a hundredth of that there."""
    monkeypatch.setattr(earning, "credible", lambda judged: True)
    before, after = _changed(PROMISED, shown)
    base, rival = _judged(before, 0.0, Further), _judged(after, FITTED, Further)
    base.fit.white = np.zeros(samples)
    assert earns(rival, base, 0.0) is earned


@pytest.mark.parametrize(
    ("fitted", "shown", "earned"), [(120.0, 0.7, True), (120.0, 0.2, False), (220.0, 0.2, True)]
)
def test_what_can_hardly_show_where_it_is_judged_must_be_clear_or_do_what_it_can(
    monkeypatch, fitted, shown, earned
):
    """A further effect changes what is left there by 10 nats, of the 16 that one that shows must bring."""
    monkeypatch.setattr(earning, "credible", lambda judged: True)
    before, after = _changed(10.0, shown)
    assert earns(_judged(after, fitted, Further), _judged(before, 0.0, Further), 0.0) is earned


@pytest.mark.parametrize(
    ("fitted", "shown", "earned"), [(169.0, 0.12, True), (169.0, 0.05, False), (90.0, 0.12, False)]
)
def test_what_is_clear_where_it_is_fitted_need_not_bring_all_that_is_asked_elsewhere(
    monkeypatch, fitted, shown, earned
):
    """A further effect that brings more than any imperfection of the first shows a little elsewhere, 12 of
    the 100 that it changes there, and 16 would be asked of another."""
    monkeypatch.setattr(earning, "credible", lambda judged: True)
    before, after = _changed(100.0, shown)
    assert earns(_judged(after, fitted, Further), _judged(before, 0.0, Further), 0.0) is earned


@pytest.mark.parametrize(
    ("promised", "shown", "earned"), [(600.0, 0.8, True), (1200.0, 0.4, False), (300.0, 0.9, False)]
)
def test_what_the_fitted_recordings_hardly_excite_may_be_told_by_those_that_judge(
    monkeypatch, promised, shown, earned
):
    """71 nats of the 80 that a further effect must bring: a quarter less, and most of what it promises."""
    monkeypatch.setattr(earning, "credible", lambda judged: True)
    before, after = _changed(promised, shown)
    base, rival = _judged(before, 0.0, Further), _judged(after, 71.0, Further)
    base.fit.white = np.zeros(20_000)
    assert earns(rival, base, 0.0) is earned


@pytest.mark.parametrize(("independent", "earned"), [(5.0, True), (float(SAMPLES), False)])
def test_little_that_judges_asks_for_little(monkeypatch, independent, earned):
    """0.5 of log-likelihood is much of 5 independent samples of a slow residual, and nothing of 4,000."""
    monkeypatch.setattr(earning, "credible", lambda judged: True)
    kind = type("Slow", (Further,), {"independent": independent})
    before = np.random.default_rng(0).standard_normal(SAMPLES)
    after = before * np.exp(-0.5 / independent)
    assert earns(_judged(after, 80.0, kind), _judged(before, 0.0, kind), 0.0) is earned


@pytest.mark.parametrize(("fitted", "earned"), [(220.0, True), (120.0, False)])
def test_what_slow_misfit_hides_where_it_is_judged_must_be_clear_where_it_is_fitted(
    monkeypatch, fitted, earned
):
    """A change of 5 nats under a residual of 5 independent samples tells nothing, though the share of 5 is
    little: of a drive's encoder ripple, 1,469 fitted, the recording that judges lost 4 and was believed."""
    monkeypatch.setattr(earning, "credible", lambda judged: True)
    kind = type("Slow", (Further,), {"independent": 5.0})
    before, after = _changed(SAMPLES, 0.0)
    assert earns(_judged(after, fitted, kind), _judged(before, 0.0, kind), 0.0) is earned


@pytest.mark.parametrize(
    ("maps", "names", "astray"),
    [(500.0, 500.0, True), (500.0, 120.0, False), (120.0, 500.0, False)],
)
def test_maps_along_the_measured_motion_are_asked_where_nothing_runs_there(
    monkeypatch, maps, names, astray
):
    monkeypatch.setattr(unnamed, "cost_of", lambda *_: names)
    alone = SimpleNamespace(white=np.zeros(100), cost=maps)
    assert unnamed._astray(None, None, alone) is astray


def test_what_noise_makes_of_a_free_run_at_most(stage, references):
    loud = replace(stage, machine=Imperfections(0.0, 1e-12, 0.5, None))
    rest, device = np.zeros_like(references[0]), SimulatedMachine(loud)
    rng = np.random.default_rng(5)
    made = [float(np.sum(device.run(rest, rest, rng).y ** 2)) for _ in range(300)]
    base = Base.of(loud, 0.1)
    trial = prepare(base.simulator, device.run(references[0], rest, rng), 1e-7)
    scene = Scene(loud.loop, (trial,), Noise(1e-12, 0.5))
    assert noise_error(scene, scene) == pytest.approx(np.median(made), rel=0.1)
    share = np.mean(np.array(made) > noise_error(scene, scene, 0.05))
    assert 0.01 < share < 0.1
    assert noise_error(None, scene, 0.05) == 0.0


@pytest.mark.parametrize(("kept", "borne"), [(1.0, True), (0.3, False)])
def test_held_out_recordings_bear_out_what_they_gain_most_of(stage, record, scenes, kept, borne):
    """Numbers fitted to noise lose as much on others as they promise there."""
    scene, held, model = scenes(record(stage))
    base = judge(scene, held, model, 1)
    white = np.random.default_rng(5).standard_normal(len(base.held_white))
    effect = np.full(len(white), 0.3) * np.sign(np.sin(np.arange(len(white))))
    missing = replace(base, held_white=white + kept * effect)
    rival = replace(base, held_white=white + (kept - 1.0) * effect)
    assert borne_out(rival, missing) is borne
    assert not borne_out(missing, missing)


@pytest.mark.parametrize(("there", "gained"), [(True, True), (False, False)])
def test_who_gains_half_of_what_can_show_gains_enough(stage, record, scenes, there, gained):
    """Where the fitted recordings can show little of an effect no tenth of what others show is asked."""
    load = EffectSpec("constant_load", {"force": 0.06})
    scene, held, model = scenes(record(replace(stage, effects=(load,) if there else ())))
    base = judge(scene, held, model, 1)
    with_it = judge(scene, held, model.with_effect(load), 0)
    assert earning._under_its_noise(with_it, base, 1e6) is gained


def _wandering(stage, limit, seed, samples=3000):  # type: ignore[no-untyped-def]
    """A path behind an amplifier at its limit, which something unrecorded and slow moves as well."""
    rng, n = np.random.default_rng(seed), np.arange(samples)
    step = stage.sample_time
    pole = np.exp(-2 * np.pi * 14.0 * step)
    steps = 0.75 * limit * np.sqrt(1.0 - pole**2) * rng.standard_normal(samples)
    slow = scipy.signal.lfilter([1.0], [1.0, -pole], steps)
    lines = np.fft.rfftfreq(samples, step)
    phases = np.exp(2j * np.pi * rng.random(len(lines)))
    path = np.fft.irfft(
        np.where((lines > 0.4) & (lines < 5.0), phases, 0.0) / (lines + 0.3), samples
    )
    path *= 0.004 / path.std() * np.clip((n - 5) / 300, 0.0, 1.0) ** 3
    machine = replace(stage, effects=(EffectSpec("saturation", {"limit": limit}),))
    run = SimulatedMachine(machine).run(path, slow, rng)
    return replace(run, u=run.u - slow, f=np.zeros(samples))


def test_slow_noise_does_not_speak_for_who_moves_less(stage, scenes, monkeypatch):
    """Under white noise a smaller limit on a lighter machine leaves less of noise as large as the limit."""
    limit = 0.2
    scene, held, model = scenes([_wandering(stage, limit, seed) for seed in (1, 2)])
    noise = Noise(1e-7, 0.75 * limit)
    scene, held = replace(scene, noise=noise), replace(held, noise=noise)
    built = model.with_effect(EffectSpec("saturation", {"limit": limit}))
    found = judge(scene, held, built)
    assert found.model.effects[0].parameters["limit"] == pytest.approx(limit, rel=0.05)
    assert abs(found.model.corrections.get("mass", 0.0)) < 0.05
    assert len(found.fit.white) == scene.samples
    monkeypatch.setattr(judging, "_as_it_began", lambda *_: None)
    misled = judge(scene, held, built)
    assert misled.model.effects[0].parameters["limit"] < 0.5 * limit
    assert misled.fitted < found.fitted - judging.MISLED


def test_who_was_judged_under_louder_noise_is_no_likelier_for_it(stage, record, scenes):  # type: ignore[no-untyped-def]
    friction = EffectSpec("coulomb_friction", {"level": 8.0})
    scene, held, model = scenes(record(replace(stage, effects=(friction,))))
    loud = replace(scene, noise=Noise(1e-5, 0.2))
    quiet_one = replace(judge(scene, held, model, 1), held=held)
    worth, white = judging.held_out(held, scene, quiet_one.fit)
    quiet_one = replace(quiet_one, held_out=worth, held_white=white)
    loud_one = replace(quiet_one, held=held.like(loud))
    worth, white = judging.held_out(held, loud, loud_one.fit)
    loud_one = replace(loud_one, held_out=worth, held_white=white)
    one, other = levelled([loud_one, quiet_one])
    assert one.held_out > other.held_out + 50.0
    one, other = whitened_alike([loud_one, quiet_one])
    assert one.held_out == pytest.approx(other.held_out, abs=1e-6)
    assert other.held_white == pytest.approx(quiet_one.held_white)

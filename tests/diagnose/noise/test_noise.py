"""Noise and whitening: the innovations of the right model are white and of unit variance."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.doubt import judged_by
from ffl.diagnose.noise.imitate import believable, imitated
from ffl.diagnose.noise.noise import Noise, Paths, fit_noise, spectrum
from ffl.diagnose.noise.whitening import Whitener
from ffl.diagnose.noise.whittle import whittle
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import Simulator
from ffl.systems.plant import Imperfections
from ffl.systems.state_space import StateSpace

TRUE = Noise(2e-7, 0.01, 1e-7, 40.0, 0.015, 8.0)


def _loop_noise(stage, n, rng, true=TRUE):  # type: ignore[no-untyped-def]
    step = stage.sample_time
    out = []
    for white, coloured, corner in (
        (true.force, true.force_coloured, true.force_corner),
        (true.sensor, true.sensor_coloured, true.sensor_corner),
    ):
        a = np.exp(-2 * np.pi * corner * step)
        x = np.zeros(n + 2000)
        drive = np.sqrt(1 - a * a) * rng.standard_normal(n + 2000)
        for k in range(1, len(x)):
            x[k] = a * x[k - 1] + drive[k]
        out.append(white * rng.standard_normal(n) + coloured * x[2000:])
    zero = np.zeros(n)
    return stage.loop.system.filter(np.column_stack([zero, zero, out[0], out[1]]))[:, 0]


@pytest.fixture(scope="module")
def noise(stage):  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(3)
    return [_loop_noise(stage, 6000, rng)[500:] for _ in range(3)]


def test_innovations_of_the_true_noise_are_white(stage, noise):  # type: ignore[no-untyped-def]
    white = Whitener.of(stage.loop, TRUE)(np.column_stack(noise))
    n = white.size
    assert np.mean(white**2) == pytest.approx(1.0, abs=5 * np.sqrt(2 / n))
    for lag in (1, 2, 5, 20):
        r = np.mean([w[lag:] @ w[:-lag] / (w @ w) for w in white.T])
        assert abs(r) < 5 / np.sqrt(n)


def test_what_stands_still_is_in_the_noise_that_scores(stage, noise):  # type: ignore[no-untyped-def]
    """A force left out: noise of the mean knows of it, the envelope of what moves does not."""
    zero, left_out = np.zeros(6000), np.full(6000, 0.1)
    offset = stage.loop.system.filter(np.column_stack([zero, zero, left_out, zero]))[500:, 0]
    left = [x + offset for x in noise]

    def power(quantile):  # type: ignore[no-untyped-def]
        found = fit_noise(stage.loop, left, Noise(1e-7, 0.1), quantile=quantile)
        white = Whitener.of(stage.loop, found)(np.column_stack(left))
        return float(np.mean(white**2))

    assert power(None) < 1.15
    assert power(0.35) > 1.5


def test_the_likeliest_size_of_noise(stage, scenes, record):  # type: ignore[no-untyped-def]
    scene, _, model = scenes(record(stage))
    white = scene.whiten(scene.residuals(model))
    around = [scene.noise.scaled(np.sqrt(np.mean(white**2)) * f) for f in (0.98, 1.0, 1.02)]
    tried = [replace(scene, noise=n) for n in around]
    scores = [s.log_likelihood(s.whiten(s.residuals(model))) for s in tried]
    assert scores[1] > max(scores[0], scores[2])
    assert scene.likeliest(white) == pytest.approx(scores[1], abs=0.1)


def test_fitted_density_is_the_true_one(stage, noise):  # type: ignore[no-untyped-def]
    fitted = fit_noise(stage.loop, noise, Noise(1e-7, 0.1))
    paths = Paths.of(stage.loop, np.geomspace(1.0, 450.0, 60))
    assert np.abs(np.log(fitted.density(paths) / TRUE.density(paths))).max() < 0.35


def test_likelihood_prefers_the_true_noise(stage, noise):  # type: ignore[no-untyped-def]
    def value(n: Noise) -> float:
        w = Whitener.of(stage.loop, n)
        return sum(-0.5 * w(e) @ w(e) - w.log_scale(len(e)) for e in noise)

    best = value(TRUE)
    assert best > value(TRUE.scaled(1.1))
    assert best > value(Noise(2e-7, 0.02))


def test_lower_envelope_ignores_what_happens_now_and_then(stage, noise):  # type: ignore[no-untyped-def]
    spoiled = [e.copy() for e in noise]
    for e in spoiled:
        e[1000:1600] += 3e-5 * np.sin(0.1 * np.arange(600))
    plain = spectrum(noise, stage.sample_time, 0.3)
    robust = spectrum(spoiled, stage.sample_time, 0.3)
    mean = spectrum(spoiled, stage.sample_time, None)
    assert np.abs(np.log(robust.power / plain.power)).max() < 1.5
    assert np.log(mean.power / plain.power).max() > 3.0


def test_unknown_start_is_absorbed(stage):  # type: ignore[no-untyped-def]
    system = stage.loop.system
    n = system.order
    start = np.zeros(n)
    start[: n - 1] = 1e-5 / max(np.abs(system.c[0]).max(), 1e-300)
    free = np.array(
        [(system.c[0] @ np.linalg.matrix_power(system.a, k) @ start) for k in range(400)]
    )
    doubt = np.outer(start, start)
    sure, unsure = Whitener.of(stage.loop, TRUE), Whitener.of(stage.loop, TRUE, doubt)
    assert np.sum(unsure(free) ** 2) < 3.0 < np.sum(sure(free) ** 2)


def test_the_array_form_is_the_riccati_equation(stage):  # type: ignore[no-untyped-def]
    """Gains and scales against P+ = A P A' + Q - K r K', formed outright."""
    noise = Noise(2e-7, 0.01, 1e-7, 30.0, 0.02, 10.0)
    w = Whitener.of(stage.loop, noise)
    a, c = w.a, w.c
    system, n = stage.loop.system, stage.loop.system.order
    ar = np.exp(-2 * np.pi * np.array([30.0, 10.0]) * stage.sample_time)
    inward, outward = np.zeros((n + 2, 4)), np.zeros(4)
    inward[:n, 0], inward[:n, 1] = 0.01 * system.b[:, 2], 2e-7 * system.b[:, 3]
    inward[n, 2], inward[n + 1, 3] = 1e-7 * np.sqrt(1 - ar[0] ** 2), 0.02 * np.sqrt(1 - ar[1] ** 2)
    outward[:2] = 0.01 * system.d[0, 2], 2e-7
    p = sum(
        np.linalg.matrix_power(a, k) @ inward @ inward.T @ np.linalg.matrix_power(a, k).T
        for k in range(4000)
    )
    for gain, scale in zip(w.gains[:50], w.scales[:50], strict=True):
        r = float(c @ p @ c + outward @ outward)
        own = (a @ p @ c + inward @ outward) / r
        assert scale == pytest.approx(np.sqrt(r), rel=1e-5)
        np.testing.assert_allclose(gain, own, atol=1e-4 * np.abs(own).max())
        p = a @ p @ a.T + inward @ inward.T - np.outer(own, own) * r


def test_states_that_nearly_run_together_leave_whitening_its_digits(stage):  # type: ignore[no-untyped-def]
    """The same loop in states that differ by a hundred-thousandth: the same innovations."""
    system, n = stage.loop.system, stage.loop.system.order
    force = system.b[:, 2:3]
    size = np.sqrt(sum((np.linalg.matrix_power(system.a, k) @ force) ** 2 for k in range(4000)))
    turn = (np.ones((n, n)) + 1e-5 * np.diag(np.arange(1.0, n + 1.0))) / size.T
    back = np.linalg.inv(turn)
    bent = StateSpace(
        turn @ system.a @ back, turn @ system.b, system.c @ back, system.d, system.sample_time
    )
    plain = Whitener.of(stage.loop, TRUE)
    other = Whitener.of(SimpleNamespace(system=bent), TRUE)
    x = np.random.default_rng(0).standard_normal(2000)
    assert np.all(np.isfinite(other.scales))
    np.testing.assert_allclose(other(x), plain(x), atol=0.02 * np.abs(plain(x)).max())


def test_a_linear_machine_imitates_what_its_transfer_functions_say(stage, record):  # type: ignore[no-untyped-def]
    noise = Noise(2e-7, 0.01, 1e-7, 30.0, 0.02, 10.0)
    loud = replace(stage, machine=Imperfections())
    trial = prepare(Simulator(loud), record(stage)[0], 1e-7)
    draws = imitated(loud, [trial], noise, np.random.default_rng(0), 8)
    variance = np.mean([np.mean(one.y[0] ** 2) for one in draws])
    n = 4096
    paths = Paths.of(stage.loop, (np.arange(n) + 0.5) / n * 0.5 / stage.sample_time)
    assert variance == pytest.approx(float(np.mean(noise.density(paths))), rel=0.1)


def test_noise_beyond_what_the_plant_file_states_is_not_imitated(stage):  # type: ignore[no-untyped-def]
    stated = replace(stage, machine=Imperfections(0.0, 1e-7, 0.01))
    capped = believable(Noise(3e-7, 0.3, 4e-7, 30.0, 0.4, 10.0), stated)
    assert np.hypot(capped.sensor, capped.sensor_coloured) == pytest.approx(1.5e-7)
    assert np.hypot(capped.force, capped.force_coloured) == pytest.approx(0.015)
    quiet = Noise(1e-8, 0.001)
    assert believable(quiet, stated) == quiet


def test_chance_in_corrections_is_granted_when_another_recording_judges(stage, record):  # type: ignore[no-untyped-def]
    simulator = Simulator(stage)
    trials = tuple(prepare(simulator, r, 1e-7) for r in record(stage))
    noise = Noise(2e-7, stage.machine.force_noise)
    base = Model(Base.of(stage, 0.1))
    scene, held = (Scene(stage.loop, (t,), noise) for t in trials)
    found = fit(scene, base)
    off = base.at(found.model.theta + 2.0 * found.spread)  # two standard errors away, by chance
    judged = judged_by(held, found)
    best, chance = (held.whiten(held.residuals(m)) for m in (found.model, off))
    granted = judged.judge(held.residuals(off))
    assert chance @ chance > best @ best
    assert granted @ granted < best @ best + 0.3 * (chance @ chance - best @ best)
    wrong = base.at(found.model.theta + 200.0 * found.spread)  # far beyond what was left open
    far = judged.judge(held.residuals(wrong))
    assert far @ far > 10.0 * (granted @ granted)


def test_noise_that_is_nearly_all_slow_is_found(stage):  # type: ignore[no-untyped-def]
    """From two beginnings its corner ended at the least there is, 700 nats behind."""
    slow = Noise(1e-7, 2e-4, 3e-7, 140.0, 2e-3, 5.0)
    paths = Paths.of(stage.loop, spectrum([np.zeros(7500)], stage.sample_time, None).frequencies)
    rng = np.random.default_rng(5)
    residuals = [_loop_noise(stage, 8000, rng, slow)[500:] for _ in range(2)]
    seen, found = (
        spectrum(residuals, stage.sample_time, None),
        fit_noise(stage.loop, residuals, Noise(1e-7, 2e-3)),
    )

    def likelihood(noise):  # type: ignore[no-untyped-def]
        density = noise.density(paths)
        return -float(np.sum(seen.weight * (np.log(density) + seen.power / density)))

    assert likelihood(found) > likelihood(slow) - 3.0


def test_lost_samples_are_foretold_from_the_others(stage):  # type: ignore[no-untyped-def]
    """The likelihood of what is left is that of a Gaussian without them, whatever stands in their place."""
    n, rng = 400, np.random.default_rng(11)
    lost = np.zeros(n, bool)
    lost[[0, 90, 91, 399]] = True
    lost[150:230] = True
    w = Whitener.of(stage.loop, TRUE, lost=lost)
    usual = Whitener.of(stage.loop, TRUE)
    full = np.linalg.inv(usual(np.eye(n)))  # e = full @ white
    covariance = full @ full.T  # the oracle's, N x N
    e = full @ rng.standard_normal(n)
    kept = covariance[np.ix_(~lost, ~lost)]
    root = np.linalg.cholesky(kept)
    white = w(e)
    assert not np.any(white[lost])
    wanted = np.linalg.solve(root, e[~lost])
    assert white @ white == pytest.approx(wanted @ wanted, rel=1e-6)
    assert w.log_scale(n) == pytest.approx(np.log(np.diag(root)).sum(), rel=1e-6)
    other = np.where(lost, 1e3, e)
    assert np.array_equal(w(other), white)
    assert np.allclose(w(np.column_stack([e, other]))[:, 1], white, rtol=1e-12)
    assert np.array_equal(w.steady(e), usual.steady(e))


@pytest.mark.parametrize("numbers", [2, 6])
def test_whittles_likelihood_and_its_gradient(stage, numbers):
    """By its formula, and by central differences."""
    rng = np.random.default_rng(numbers)
    frequencies = np.geomspace(1.0, 450.0, 60)
    paths = Paths.of(stage.loop, frequencies)
    power, weight = rng.exponential(1e-12, 60), rng.uniform(1.0, 20.0, 60)
    known = paths.sensor, paths.force, paths.cosine, paths.sample_time, power, weight, 1e-7
    p = np.log([1e-6, 0.3, 0.5, 20.0, 2.0, 7.0])[:numbers]
    value, gradient = whittle(p, *known)
    e = [*np.exp(p), 0.0, 1.0, 0.0, 1.0][:6] if numbers == 2 else np.exp(p)
    noise = Noise(float(np.hypot(e[0], 1e-7)), e[1], e[2] * e[0], e[3], e[4] * e[1], e[5])
    density = noise.density(paths)
    assert value == pytest.approx(np.sum(weight * (np.log(density) + power / density)), rel=1e-12)
    steps = 1e-5 * np.eye(numbers)
    slopes = [(whittle(p + s, *known)[0] - whittle(p - s, *known)[0]) / 2e-5 for s in steps]
    np.testing.assert_allclose(gradient, slopes, rtol=1e-6, atol=1e-6 * np.abs(gradient).max())

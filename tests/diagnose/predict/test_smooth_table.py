"""A table of friction believed to be smooth: worth what it says, plain where the data do not see it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose.contest.judging import PER_NUMBER
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.predict import dry_in_noise
from ffl.diagnose.predict.foretold import refitted
from ffl.diagnose.predict.slipping import Slip
from ffl.diagnose.predict.smooth_table import EITHER_WAY, REACH, SPREAD, _believed, smoothed
from ffl.diagnose.recorded.trials import prepare
from ffl.systems import EffectSpec
from ffl.systems.plant import Imperfections

KNOTS, LEVEL = 5, 1.5
NOISE = Noise(1e-7, 0.1)


def covariance(n):
    x, way = np.tile(np.linspace(0.0, 1.0, n), 2), np.repeat([0, 1], n)
    alike = np.where(way[:, None] == way, 1.0, EITHER_WAY)
    return SPREAD**2 * alike * np.exp(-0.5 * ((x[:, None] - x) / REACH) ** 2)


@pytest.mark.parametrize("seed", range(3))
def test_it_is_the_evidence_of_gaussian_levels(seed):
    """Against the densities themselves, which know no QR."""
    rng = np.random.default_rng(seed)
    k = covariance(KNOTS)
    root = rng.normal(0.0, 3.0, (2 * KNOTS, 2 * KNOTS))
    off = rng.normal(0.0, 0.3, 2 * KNOTS)
    believed, price = _believed(root, off)
    doubt = np.linalg.inv(root.T @ root)
    np.testing.assert_allclose(believed, k @ np.linalg.solve(doubt + k, off), atol=1e-6)

    def log_density(d, s):
        return -0.5 * (d @ np.linalg.solve(s, d) + np.linalg.slogdet(2 * np.pi * s)[1])

    # log p(d^ | table) - log p(d^ | plain), of which the fit itself is l(d^) - l(0) = d^'S^-1 d^/2
    ratio = log_density(off, doubt + k) - log_density(off, doubt)
    fit = 0.5 * off @ root.T @ root @ off
    assert fit - price == pytest.approx(ratio, abs=1e-5)


def test_levels_that_nothing_shows_are_plain_and_cost_nothing():
    believed, price = _believed(np.zeros((2 * KNOTS, 2 * KNOTS)), np.full(2 * KNOTS, 7.0))
    np.testing.assert_allclose(believed, 0.0, atol=1e-12)
    assert price == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("wavy", [True, False])
def test_a_level_that_goes_by_position_is_worth_more_than_a_plain_one_and_no_other_is(
    stage, record, wavy
):
    noisy = replace(stage, machine=Imperfections(NOISE.sensor, 1e-7, NOISE.force, None))
    low, high = -0.005, 0.105
    grid = np.linspace(low, high, 17)
    wave = 0.5 * np.sin(2.0 * np.pi * (grid - low) / (high - low)) * wavy
    rows = (LEVEL * (1.0 + wave)).tolist()
    table = {"grid": grid.tolist(), "positive": rows, "negative": rows}
    machine = EffectSpec("position_dependent_friction", {"level": LEVEL, "table": table})
    runs = record(replace(noisy, effects=(machine,)), 3)
    model = Model(Base.of(noisy, max(float(np.ptp(r.y)) for r in runs)))
    trials = [prepare(model.base.simulator, r, NOISE.sensor) for r in runs]
    scene, held = (Scene(noisy.loop, (t,), NOISE) for t in trials)
    low, high = (end(end(t.y) for t in trials) for end in (min, max))

    def fitted(spec):
        return refitted(Slip(model.with_effect(spec), NOISE), scene.trials)

    plain = fitted(EffectSpec("coulomb_friction", {"level": LEVEL}))
    flat = [LEVEL] * KNOTS
    begun = {"grid": np.linspace(low, high, KNOTS).tolist(), "positive": flat, "negative": flat}
    free = fitted(EffectSpec("position_dependent_friction", {"level": LEVEL, "table": begun}))
    level = plain.judged(scene, held, plain.scaled(scene.trials)[0])
    none = plain.model.effects[0].parameters | {"level": 0.0}
    bare = replace(plain.model, effects=(EffectSpec("coulomb_friction", none),))
    assert smoothed(free, replace(level, fit=replace(level.fit, model=bare)), scene, held) is None
    found = smoothed(free, level, scene, held)
    assert found.price != PER_NUMBER * found.freedom
    brought = found.score - level.score
    levels = np.array(found.model.effects[-1].parameters["table"]["positive"])
    if not wavy:
        assert brought < 3.0
        assert np.abs(levels / LEVEL - 1.0).max() < 0.15
        return
    told = np.interp(np.linspace(low, high, KNOTS), grid, rows)
    assert brought > 10.0
    assert np.argmax(levels) == np.argmax(told)
    assert np.corrcoef(levels, told)[0, 1] > 0.6


@pytest.mark.parametrize(
    ("brought", "more", "taken"), [(400.0, 18.0, True), (21717.0, 252.0, False)]
)
def test_it_must_say_more_than_a_filter_errs_by(monkeypatch, brought, more, taken):
    monkeypatch.setattr(dry_in_noise, "credible", lambda judged: True)

    def judged(score, name, price):  # type: ignore[no-untyped-def]
        model = SimpleNamespace(names=(name,), coordinates=[0])
        fit = SimpleNamespace(white=np.zeros(16332))
        return SimpleNamespace(score=score, held_out=0.0, model=model, fit=fit, price=price)

    plain = judged(brought, "coulomb_friction", None)
    table = judged(brought + more, "position_dependent_friction", 4.0)
    none = judged(0.0, "nothing", None)
    assert dry_in_noise._best([plain, table], none) is (table if taken else plain)

"""What the true structure leaves held out once fitted: against fits of noisy runs."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.challenge import fitted as module
from ffl.challenge.body import FAMILIES
from ffl.challenge.detect import Lens
from ffl.challenge.draw import draw_noise, draw_setup, measure
from ffl.challenge.fitted import Moved, fitted, floors_of
from ffl.challenge.stage import Part, assemble, run, whole_run

DRAWS = 150


@pytest.fixture
def stage(monkeypatch):
    """A rigid stage with a constant load, whose size alone is not known."""
    rng = np.random.default_rng(5)
    setup = draw_setup("rigid", "exact", rng)
    scales = measure(setup)
    noise = replace(draw_noise(setup, scales, rng).scaled(5.0), resolution=0.0)
    monkeypatch.setitem(module.FAMILIES, "rigid", replace(FAMILIES["rigid"], doubts=()))
    return setup, [Part("constant_load", "motor", 3, 1.0)], scales, noise


@pytest.mark.slow(20)
def test_it_is_what_fits_of_noisy_runs_add(stage):
    setup, parts, scales, noise = stage
    lens = Lens(setup)
    machine, _ = assemble(setup, parts, scales)
    larger, _ = assemble(setup, [replace(parts[0], size=1.01)], scales)

    def fit_runs(build, noise=None, rng=None):
        return [whole_run(build, setup, e, noise, rng)[0] for e in setup.fit]

    clean = fit_runs(machine)
    slope = [(a - b) / 0.01 for a, b in zip(fit_runs(larger), clean, strict=True)]
    white = lens.whiten(noise, slope)
    errors = []
    for draw in range(DRAWS):
        noisy = fit_runs(machine, noise, np.random.default_rng(draw))
        left = lens.whiten(noise, [a - b for a, b in zip(noisy, clean, strict=True)])
        errors.append(white @ left / (white @ white))
    for (y, u), e in zip(fitted(setup, parts, scales, noise), setup.validate, strict=True):
        sides = zip(run(larger, setup, e, None), run(machine, setup, e, None), strict=True)
        told = [np.var(errors) * np.mean(((a - b) / 0.01) ** 2) for a, b in sides]
        assert [y, u] == pytest.approx(told, rel=0.35)


def test_it_grows_with_the_noise_and_with_what_is_not_known(stage, monkeypatch):
    setup, parts, scales, noise = stage
    (y, u), *_ = fitted(setup, parts, scales, noise)
    (louder, _), *_ = fitted(setup, parts, scales, noise.scaled(2.0))
    assert louder == pytest.approx(4.0 * y, rel=0.02)
    doubts = (("mass", 0.003), ("viscous", 0.05))
    monkeypatch.setitem(module.FAMILIES, "rigid", replace(FAMILIES["rigid"], doubts=doubts))
    (more, more_u), *_ = fitted(setup, parts, scales, noise)
    assert more > y
    assert more_u > u


def test_each_number_is_moved_and_no_other(stage):
    setup, _, scales, _ = stage
    part = Part("cogging", "motor", 8, 1.0)
    _, (plain,) = assemble(setup, [part], scales)
    for which, name in ((0, "amplitude"), (1, "period"), (2, "phase")):
        moved = Moved(part.name, part.at, part.seed, part.size, which, 0.01)
        _, (other,) = assemble(setup, [moved], scales)
        changed = {k for k in plain if np.any(plain[k] != other[k])}
        assert name in changed
        assert changed <= {name, "second_amplitude"}


def test_floors_with_and_without_an_oracle():
    rng = np.random.default_rng(1)
    y0, u0 = np.sin(np.arange(500) / 20.0), np.cos(np.arange(500) / 20.0)
    y, u = y0 + 0.01 * rng.standard_normal(500), u0 + 0.02 * rng.standard_normal(500)
    plain = floors_of(y, y0, u, u0, None)
    assert set(plain) == {"nrmse_after", "u_nrmse_after"}
    with_it = floors_of(y, y0, u, u0, (3e-4, 0.0))
    assert with_it["nrmse_fitted"] == pytest.approx(2.0 * plain["nrmse_after"], rel=0.1)
    assert with_it["u_nrmse_fitted"] == pytest.approx(plain["u_nrmse_after"])

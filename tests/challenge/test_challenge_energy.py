"""What an effect's energy is counted by: noise is white of unit variance through it, and a constant
force is worth what force noise of its loudness leaves of it."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.challenge.body import FAMILIES
from ffl.challenge.build import Build
from ffl.challenge.detect import Lens
from ffl.challenge.draw import draw_noise, draw_setup, measure
from ffl.challenge.linear import Noise
from ffl.challenge.stage import whole_run


def setup_of(family, seed=5):
    rng = np.random.default_rng(seed)
    setup = draw_setup(family, "exact", rng)
    scales = measure(setup)
    return setup, draw_noise(setup, scales, rng)


@pytest.mark.parametrize("family", FAMILIES)
def test_noise_comes_out_white_and_of_unit_variance(family):
    setup, noise = setup_of(family)
    noise = replace(noise.scaled(3.0), resolution=0.0)
    build, rng = Build.of(setup.true), np.random.default_rng(1)
    left = [
        whole_run(build, setup, e, noise, rng)[0] - whole_run(build, setup, e, None)[0]
        for e in setup.fit
    ]
    white = Lens(setup).whiten(noise, left)
    assert len(white) == sum(len(e.reference) - e.skip for e in setup.fit)
    assert np.mean(white**2) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / len(white)) + 0.02)
    assert abs(np.mean(white[1:] * white[:-1])) < 5.0 / np.sqrt(len(white)) + 0.02


@pytest.mark.parametrize("family", [f for f in FAMILIES if f != "stiffness"])
def test_a_constant_force_is_worth_the_samples_it_stands_out_in(family):
    # Force noise alone of s per sample: a constant force F has (F/s)^2 in every recorded one.
    setup, _ = setup_of(family)
    size = 1e-3 * measure(setup).command
    noise = Noise(sensor=1e-9 * (measure(setup).high - measure(setup).low), force=size)
    traces = []
    for e in setup.fit:
        build, n = Build.of(setup.true), len(e.reference)
        still = np.zeros(n)
        pushed = build.run(
            setup.servo, still, still, setup.sample_time, setup.steps, None, np.full(n, size)
        )
        traces.append(pushed[0])
    white = Lens(setup).whiten(noise, traces)
    assert white @ white == pytest.approx(len(white), rel=0.1)

"""Noise on the output: backward regression shrinks, two stages do not."""

import numpy as np
import pytest

import ffl.identify.kernel2018 as paper
from ffl.errors import InputError
from ffl.identify import Edges, KernelInverse, TwoStageInverse
from ffl.identify.kernels import OBF

CLOSED_LOOP = (
    0.97 + 0.05j,
    0.97 - 0.05j,
    0.97 + 0.14j,
    0.97 - 0.14j,
    0.9 + 0.24j,
    0.9 - 0.24j,
    0.97,
)
FORWARD = KernelInverse(
    OBF.of_poles(CLOSED_LOOP, direct=1, scale=1e-2), 0, 300, Edges("zero", "zero")
)
INVERSE = KernelInverse(
    OBF.of_poles(paper.STABLE, paper.OUTSIDE, direct=3, scale=1e4, pole_spread=0.5),
    300,
    300,
    Edges("known", "known"),
    noise_variance=1e-2,
)


def excess(theta, seed=0):
    """||r - P F r||/sqrt(N) on a new reference, without output noise."""
    rng = np.random.default_rng(seed)
    quiet = paper.Realisation(None, rng.standard_normal(paper.N), np.zeros(paper.N))
    return paper.tracking_error(theta, quiet)


def test_noise_on_the_output_costs_and_two_stages_repair_it():
    naive, repaired = [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        r = rng.standard_normal(1000)
        y = paper.system().filter(r) + 0.03 * rng.standard_normal(1000)
        backward = KernelInverse(INVERSE.kernel, 300, 300, Edges("zero", "zero", skip_after=300))
        naive.append(excess(backward.fit(y, r).inverse_.theta))
        found = TwoStageInverse(FORWARD, INVERSE).fit(r, y)
        repaired.append(excess(found.inverse_.theta))
        assert found.noise_variance_ == pytest.approx(9e-4, rel=0.2)
    assert np.mean(naive) > 0.6
    assert np.mean(repaired) < 0.1


def test_contract():
    model = TwoStageInverse(FORWARD, INVERSE)
    assert model.get_params() == {"forward": FORWARD, "backward": INVERSE, "outside": "zero"}
    rng = np.random.default_rng(0)
    r = rng.standard_normal(1000)
    model.fit(r, paper.system().filter(r) + 0.01 * rng.standard_normal(1000))
    assert not hasattr(FORWARD, "inverse_")
    assert len(model.predict(r)) == 1000


def test_refusals():
    with pytest.raises(InputError, match="does not look ahead"):
        TwoStageInverse(INVERSE, INVERSE).fit(np.ones(9), np.ones(9))
    with pytest.raises(InputError, match="equal lengths"):
        TwoStageInverse(FORWARD, INVERSE).fit(np.ones(9), np.ones(8))

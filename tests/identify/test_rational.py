"""Variable projection: the Jacobian's minimum, poles from nothing, the posterior that counts them."""

from itertools import pairwise

import numpy as np
import pytest

import ffl.identify.kernel2018 as paper
from ffl.errors import InputError
from ffl.identify import RationalInverse
from ffl.identify.kernels import OBF
from ffl.identify.rational import project, projected, search
from ffl.identify.regression import Edges, backward_regression

TRUE_INSIDE = np.array([0.9815 + 0.08401042j, 0.9815 - 0.08401042j, 0.9834])
TRUE_OUTSIDE = np.array([1.0035 + 0.18435767j, 1.0035 - 0.18435767j])


def nearest(found, truth):
    return max(np.abs(np.asarray(found) - p).min() for p in truth)


def rows_with(noise, seed=3):
    task = paper.draw(np.random.SeedSequence(seed))
    rows = task.regression
    exact = rows.apply(paper.true_taps())
    rng = np.random.default_rng(seed + 1000)
    return backward_regression(
        rows.output,
        exact + noise * rng.standard_normal(len(exact)),
        rows.n_ac,
        rows.n_c,
        Edges("known", "known"),
        lead=rows.n_c,
    )


def test_poles_without_noise_come_back_from_a_wrong_start():
    rows = rows_with(1e-4)
    start = OBF.of_poles([0.95 + 0.15j, 0.95 - 0.15j, 0.9], [1.05 + 0.3j, 1.05 - 0.3j], direct=3)
    found = project(rows, rows.lags, start, 100)
    assert found.status == "converged"
    assert nearest(found.kernel.poles, TRUE_INSIDE) < 2e-3
    assert nearest(found.kernel.outside, TRUE_OUTSIDE) < 1e-4


def test_jacobian_of_the_projected_residual():
    rows = rows_with(1.0)
    kernel = OBF.of_poles([0.95 + 0.15j, 0.95 - 0.15j, 0.5], [1.05 + 0.2j, 1.05 - 0.2j], direct=3)
    _, jacobian = projected(rows, rows.lags, kernel)
    x, h = kernel.coordinates, 1e-6
    for i in range(1, len(x)):
        step = h * np.eye(len(x))[i]
        up, down = (projected(rows, rows.lags, kernel.at(x + s))[0] for s in (step, -step))
        column = (up - down) / (2 * h)
        error = np.linalg.norm(jacobian[:, i - 1] - column)
        assert error < 1e-6 * np.linalg.norm(column)


def test_projection_ends_where_no_small_step_is_better():
    rows = rows_with(1.0)
    start = OBF.of_poles([0.95 + 0.15j, 0.95 - 0.15j], [1.05 + 0.2j, 1.05 - 0.2j], direct=3)
    found = project(rows, rows.lags, start, 100)
    x = found.kernel.coordinates
    for i in range(1, len(x)):
        for h in (1e-3, -1e-3):
            near = found.kernel.at(x + h * np.eye(len(x))[i])
            a = rows.apply(near.basis(rows.lags)[0])
            residual = rows.target - a @ np.linalg.lstsq(a, rows.target, rcond=None)[0]
            assert residual @ residual > found.squares


def test_search_finds_resonances_and_their_number_from_nothing():
    rows = rows_with(0.05)
    found, steps = search(rows, rows.lags, 3, 5)
    assert nearest(found.kernel.poles, TRUE_INSIDE[:2]) < 5e-3
    assert nearest(found.kernel.outside, TRUE_OUTSIDE) < 2e-3
    assert len(steps) in (3, 4)  # two pairs, and the slow real pole where the noise lets it be seen
    assert all(b.criterion < a.criterion for a, b in pairwise(steps))


def test_estimator_without_prior_knowledge_tracks_nearly_as_well():
    excess = []
    for seed in range(6):
        task = paper.draw(np.random.SeedSequence(seed))
        model = RationalInverse(300, 300, 3, edges=Edges("known", "known"))
        model.fit(task.regression.output, task.regression.target, lead=300)
        perfect = np.linalg.norm(task.noise) / np.sqrt(paper.N)
        excess.append(paper.tracking_error(model.inverse_.theta, task) - perfect)
        assert model.noise_variance_ == pytest.approx(1.0, abs=0.15)
    assert np.mean(excess) < 0.03  # least squares: 0.5


def test_known_starts_skip_the_search():
    rows = rows_with(0.3)
    model = RationalInverse(
        300, 300, 3, poles=paper.STABLE, outside=paper.OUTSIDE, edges=Edges("known", "known")
    ).fit(rows.output, rows.target, lead=300)
    assert model.steps_ == ()
    assert (len(model.poles_), len(model.outside_)) == (3, 2)
    assert nearest(model.outside_, TRUE_OUTSIDE) < 5e-3
    band = model.inverse_.impulse_band(0.95)
    truth = paper.true_taps()
    assert np.mean((truth >= band.lower) & (truth <= band.upper)) > 0.8


def test_refusals():
    rows = rows_with(0.3)
    with pytest.raises(InputError, match="reach beyond n_ac"):
        RationalInverse(1, 50, 3).fit(rows.output[:400], rows.target[:400])
    exact = backward_regression(
        rows.output, rows.output[300:1300], 300, 300, Edges("known", "known"), 300
    )
    with pytest.raises(InputError, match="holds no noise"):
        RationalInverse(300, 300, 1, edges=Edges("known", "known")).fit(
            exact.output, exact.target, lead=300
        )

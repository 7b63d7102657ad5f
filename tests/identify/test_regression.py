"""Backward regression: FFT products and blockwise QR against dense ones; edges; refusals in words."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ffl.errors import InputError
from ffl.identify.regression import Edges, backward_regression, least_squares

RNG = np.random.default_rng(3)


def record(n=300, n_ac=4, n_c=7, seed=0, noise=0.0, tail=40):
    """Output with tails, target and taps: target(t) = sum theta_k output(t - k) + noise."""
    rng = np.random.default_rng(seed)
    theta = rng.standard_normal(n_ac + n_c + 1)
    y = rng.standard_normal(n + 2 * tail)
    lags = np.arange(-n_ac, n_c + 1)
    r = np.array(
        [sum(c * y[tail + t - k] for c, k in zip(theta, lags, strict=True)) for t in range(n)]
    )
    return y, r + noise * rng.standard_normal(n), theta, tail


def test_known_taps_come_back():
    y, r, theta, tail = record()
    for edges, lead, output in (
        (Edges("known", "known"), tail, y),
        (Edges("drop", "drop"), None, y[tail:-tail]),
    ):
        regression = backward_regression(output, r, 4, 7, edges, lead)
        np.testing.assert_allclose(least_squares(regression), theta, atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 9), st.integers(0, 9), st.integers(0, 1000))
def test_products_equal_the_dense_matrix(n_ac, n_c, seed):
    rng = np.random.default_rng(seed)
    y = rng.standard_normal(60)
    regression = backward_regression(y, rng.standard_normal(60), n_ac, n_c)
    dense = regression.matrix()
    t = 5 + n_c
    row = [y[t - k] for k in range(-n_ac, n_c + 1)]
    np.testing.assert_array_equal(dense[t - regression.first], row)
    b, x = rng.standard_normal((n_ac + n_c + 1, 3)), rng.standard_normal((len(dense), 2))
    np.testing.assert_allclose(regression.apply(b), dense @ b, atol=1e-11)
    np.testing.assert_allclose(regression.transpose(x), dense.T @ x, atol=1e-11)
    np.testing.assert_allclose(regression.apply(b[:, 0]), dense @ b[:, 0], atol=1e-11)


def test_triangle_keeps_all_that_least_squares_asks():
    y, r, _, tail = record(n=5000, noise=0.5)  # more rows than one block
    regression = backward_regression(y, r, 4, 7, Edges("known", "known"), tail)
    dense, triangle = regression.matrix(), regression.triangle
    np.testing.assert_allclose(triangle.r.T @ triangle.r, dense.T @ dense, atol=1e-8)
    theta, squares, *_ = np.linalg.lstsq(dense, r, rcond=None)
    np.testing.assert_allclose(least_squares(regression), theta, atol=1e-12)
    assert triangle.rest == pytest.approx(squares[0], rel=1e-12)
    assert triangle.r.shape == (12, 12)
    assert triangle.n_rows == 5000


def test_edge_protocols_choose_the_rows_they_say():
    y, r, _, tail = record()
    inner = y[tail:-tail]
    drop = backward_regression(inner, r, 4, 7)
    assert (drop.first, drop.n_rows) == (7, 300 - 11)
    assert "rows 7..295 of 300" in drop.says
    zero = backward_regression(inner, r, 4, 7, Edges("zero", "zero", skip_after=2))
    assert zero.n_rows == 298
    np.testing.assert_array_equal(zero.matrix(0, 1)[0], [*inner[4::-1], *np.zeros(7)])
    hold = backward_regression(inner, r, 4, 7, Edges("drop", "hold"))
    np.testing.assert_array_equal(hold.matrix(hold.n_rows - 1)[0, :5], [inner[-1]] * 5)


def test_zero_padding_a_moving_machine_costs_and_dropped_rows_mend_it():
    y, r, theta, tail = record(n=60, noise=0.01)
    inner = y[tail:-tail]
    padded = least_squares(backward_regression(inner, r, 4, 7, Edges("zero", "zero")))
    dropped = least_squares(backward_regression(inner, r, 4, 7))
    assert np.linalg.norm(padded - theta) > 10 * np.linalg.norm(dropped - theta)


@pytest.mark.parametrize(
    ("output", "target", "options", "words"),
    [
        (np.ones(50), RNG.standard_normal(50), {}, "output is constant"),
        (RNG.standard_normal(50), np.zeros(50), {}, "target is zero"),
        (RNG.standard_normal(49), RNG.standard_normal(50), {}, "equal lengths"),
        (RNG.standard_normal(10), RNG.standard_normal(10), {}, "fewer than the model's 12 taps"),
        (np.append(RNG.standard_normal(49), np.nan), np.ones(50), {}, "1 samples are NaN"),
        (RNG.standard_normal(50), np.full(50, np.inf), {}, "target: 50 samples are NaN"),
        (RNG.standard_normal((50, 2)), np.ones(50), {}, "one column"),
        (["a"] * 50, np.ones(50), {}, "not a numeric array"),
        (RNG.standard_normal(50), np.ones(50), {"edges": Edges("known", "drop")}, "missing"),
        (RNG.standard_normal(50), np.ones(50), {"lead": 3}, "output is short"),
        (RNG.standard_normal(50), np.ones(50), {"n_c": -1}, "0 or more taps"),
        (RNG.standard_normal(13), np.ones(13), {"edges": Edges(skip_after=2)}, "leave no row"),
    ],
)
def test_bad_input_is_refused_in_words(output, target, options, words):
    arguments = {"n_ac": 4, "n_c": 7, **options}
    with pytest.raises(InputError, match=words):
        backward_regression(output, target, **arguments)


def test_edges_refuse_what_they_do_not_know():
    with pytest.raises(InputError, match="none of"):
        Edges("reflect")
    with pytest.raises(InputError, match="0 or more rows"):
        Edges(skip_before=-1)


def test_rank_is_said_in_words():
    t = np.arange(400)
    regression = backward_regression(np.sin(0.3 * t), RNG.standard_normal(400), 4, 7)
    with pytest.raises(InputError, match="excites only 2 of 12 directions"):
        least_squares(regression)
    short = backward_regression(RNG.standard_normal(20), RNG.standard_normal(20), 4, 7)
    with pytest.raises(InputError, match="9 rows for 12 taps"):
        least_squares(short)

import numpy as np
import pytest

from ffl.diagnose.hypothesis.triangle import lengths, triangle


@pytest.mark.parametrize("n", [5, 70, 1000, 20_003])
def test_solves_least_squares_as_a_plain_qr_does(n):
    rng = np.random.default_rng(3)
    scale = np.array([1.0, 1e-6, 1e6, 1e-3])
    columns = rng.standard_normal((n, 4)) * scale
    target = rng.standard_normal(n)
    r, seen = triangle(columns, target)
    expected = np.linalg.lstsq(columns / scale, target, rcond=None)[0] / scale
    np.testing.assert_allclose(np.linalg.solve(r, seen), expected, rtol=1e-9)
    left = target - columns @ expected
    assert seen @ seen == pytest.approx(target @ target - left @ left, rel=1e-10)


def test_keeps_what_depends_on_the_rest_visible():
    x = np.random.default_rng(4).standard_normal((3000, 2))
    r, _ = triangle(np.column_stack([x, x.sum(axis=1)]), x[:, 0])
    assert abs(r[2, 2]) < 1e-12 * abs(r[0, 0])


def test_lengths_are_norms_of_columns():
    x = np.random.default_rng(5).standard_normal((300, 3)) * [1e-150, 1.0, 1e150]
    np.testing.assert_allclose(lengths(x), np.linalg.norm(x, axis=0), rtol=1e-13)

"""Forward response of a non-causal FIR inverse: two roads, known answers, derivative, label."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ffl.identify.bayes import circle, roots
from ffl.identify.bayes.protocol import (
    inliers,
    inverse_fit,
    paper_data,
    shifted,
    simulate_paper_system,
    true_forward_impulse,
    true_inverse_impulse,
)
from ffl.identify.bayes.records import reduce_record

TRUTH = true_inverse_impulse(4, 1)


def taps_with_roots(inside, outside):
    """Real taps whose polynomial has the given real roots."""
    return np.poly([*inside, *outside]).real


def test_a_known_inverse_gives_its_known_forward_response():
    xi, inside = roots.forward_response(np.array([0.0, 1.0, -0.5]), 1, 6)
    np.testing.assert_allclose(xi, 0.5 ** np.arange(6), atol=1e-14)
    assert inside == 1


def test_an_advance_in_the_inverse_is_a_delay_in_the_forward_response():
    xi, _ = roots.forward_response(np.array([1.0, -0.5, 0.0]), 1, 6)  # q - 0.5
    np.testing.assert_allclose(xi, [0, 1, 0.5, 0.25, 0.125, 0.0625], atol=1e-14)


@pytest.mark.parametrize(("n_ac", "n_c"), [(4, 2), (3, 1), (2, 4), (0, 3)])
def test_roots_and_fft_agree_on_the_paper_inverse(n_ac, n_c):
    theta = true_inverse_impulse(max(n_ac, 2), n_c - 1) if n_ac else np.array([1.0, -0.6, 0.2])
    n_ac = max(n_ac, 2) if n_ac else 0
    xi, inside = roots.forward_response(theta, n_ac, 80)
    np.testing.assert_allclose(xi, circle.circle_response(theta, n_ac, 80, 4096), atol=1e-12)
    assert inside == circle.inside_count(theta, n_ac)


radius_in = st.floats(-0.85, 0.85).filter(lambda r: abs(r) > 0.05)
radius_out = st.floats(1.2, 30.0)


@settings(max_examples=60, deadline=None)
@given(st.lists(radius_in, min_size=1, max_size=3), st.lists(radius_out, max_size=3))
def test_roots_fft_and_winding_number_agree(inside, outside):
    theta = taps_with_roots(inside, outside)
    n_c = 2
    n_ac = len(theta) - n_c
    # residues of roots that nearly coincide cancel in the sum: such examples say nothing
    assume(all(abs(a - b) > 0.1 for i, a in enumerate(inside) for b in inside[:i]))
    xi, count = roots.forward_response(theta, n_ac, 40)
    reference = circle.circle_response(theta, n_ac, 40, 4096)
    np.testing.assert_allclose(xi, reference, atol=1e-10 * np.abs(reference).max())
    assert count == circle.inside_count(theta, n_ac) == len(inside)


def test_truncation_leaves_a_root_far_outside_so_the_causal_expansion_diverges():
    outermost = np.abs(roots.all_roots(TRUTH)).max()
    assert outermost > 5
    series = np.zeros(60)  # 1/theta in |z| > max |p|: long division from the highest power
    series[0] = 1 / TRUTH[0]
    for t in range(1, 60):
        k = min(t, 5)
        series[t] = -(TRUTH[1 : k + 1] @ series[t - 1 :: -1][:k]) / TRUTH[0]
    assert np.abs(series[-1]) > 1e30
    assert np.abs(roots.forward_response(TRUTH, 4, 60)[0]).max() < 2


def test_aberth_follows_real_roots_that_become_a_pair_and_back():
    real = taps_with_roots([0.5, 0.6], [5.0])
    pair = np.poly([0.5 + 0.2j, 0.5 - 0.2j, 5.0]).real
    for start, goal in ((real, pair), (pair, real)):
        found = roots.refine_roots(goal, np.roots(start).astype(complex))
        np.testing.assert_allclose(np.poly(found), goal, atol=1e-12)


def test_a_vanishing_leading_tap_changes_nothing():
    theta = np.array([0.0, 1.0, -0.9, 0.2])
    xi, inside = roots.forward_response(theta, 2, 30)
    shorter, same = roots.forward_response(theta[1:], 1, 30)
    np.testing.assert_allclose(xi, shorter, atol=1e-12)
    assert inside == same


def test_jacobian_equals_central_differences():
    _, slope = circle.circle_jacobian(TRUTH, 4, 60)
    step = 1e-6
    numeric = [
        (
            circle.circle_response(TRUTH + step * e, 4, 60)
            - circle.circle_response(TRUTH - step * e, 4, 60)
        )
        / (2 * step)
        for e in np.eye(6)
    ]
    np.testing.assert_allclose(slope, np.transpose(numeric), atol=2e-8)


def test_theorem_1_inverts_the_true_forward_response():
    theta = circle.invert_response(true_forward_impulse(200), 4, 2)
    np.testing.assert_allclose(theta, TRUTH, atol=1e-12)


def test_the_reduced_record_has_the_misfit_of_the_full_one():
    rng = np.random.default_rng(0)
    u, y, xi = rng.standard_normal(5000), rng.standard_normal(5000), rng.standard_normal(30)
    direct = np.sum((y - np.convolve(xi, u)[:5000]) ** 2)  # more rows than one block of the QR
    record = reduce_record(u, y, 30)
    assert record.misfit(xi) == pytest.approx(direct, rel=1e-12)
    fast = roots.misfit(record.factor, record.target, record.floor, xi)
    assert fast == pytest.approx(direct, rel=1e-12)


@pytest.mark.parametrize(("n_ac", "n_c"), [(3, 2), (2, 3), (4, 1)])
def test_roots_and_fft_agree_on_both_sides_of_zero(n_ac, n_c):
    theta = taps_with_roots([0.5, -0.3], [1.4, -2.0])
    xi, _ = roots.forward_response(theta, n_ac, 60, before=12)
    other = circle.circle_response(theta, n_ac, 60, 4096, before=12)
    assert np.abs(xi[:12]).max() > 0.05
    np.testing.assert_allclose(xi, other, atol=1e-12)


def test_the_derivative_holds_on_both_sides_of_zero():
    theta, step = taps_with_roots([0.5, -0.3], [1.4, -2.0]), 1e-6
    _, slope = circle.circle_jacobian(theta, 3, 40, before=8)
    numeric = [
        (
            circle.circle_response(theta + step * e, 3, 40, before=8)
            - circle.circle_response(theta - step * e, 3, 40, before=8)
        )
        / (2 * step)
        for e in np.eye(len(theta))
    ]
    np.testing.assert_allclose(slope, np.transpose(numeric), atol=1e-7)


def test_a_record_of_both_sides_has_the_misfit_of_the_two_sided_sum():
    rng = np.random.default_rng(3)
    u, y, xi = rng.standard_normal(3000), rng.standard_normal(3000), rng.standard_normal(25)
    record = reduce_record(u, y, 20, before=5)
    output = np.convolve(xi, u)[5:3005]  # xi[5] stands at t = 0
    assert record.misfit(xi) == pytest.approx(np.sum((y - output) ** 2), rel=1e-12)
    late = reduce_record(u, y, 20, at_rest=False, before=5)
    assert late.misfit(xi) == pytest.approx(np.sum((y - output)[19:] ** 2), rel=1e-12)


def test_an_unknown_start_leaves_out_the_rows_it_reaches():
    rng = np.random.default_rng(1)
    past, u = rng.standard_normal(50), rng.standard_normal(300)
    xi = 0.8 ** np.arange(20)
    y = np.convolve(xi, np.concatenate([past, u]))[50:350]
    assert reduce_record(u, y, 20, at_rest=False).misfit(xi) < 1e-20
    assert reduce_record(u, y, 20, at_rest=True).misfit(xi) > 0.1


def test_six_true_taps_fit_99_per_cent_and_x_cut_at_n_caps_them_near_69():
    fits, cut = [], []
    for seed in range(20):
        data = paper_data(seed)
        fits.append(inverse_fit(TRUTH, 4, data.u, data.x, 60))
        zeroed = np.where(np.arange(64) < 60, data.x, 0.0)
        cut.append(inverse_fit(TRUTH, 4, data.u, zeroed, 60))
    assert 99.0 < np.mean(fits) < 99.6
    assert 60 < np.mean(cut) < 80


def test_the_true_inverse_restores_the_input_of_a_long_record():
    u = np.random.default_rng(2).standard_normal(400)
    x = simulate_paper_system(u)
    long = true_inverse_impulse(12, 60)
    error = u[:380] - shifted(x, 12, 61, 380) @ long
    assert np.abs(error).max() < 1e-8


def test_a_data_set_depends_on_its_seed_alone_and_has_its_signal_to_noise_ratio():
    first, again, other = paper_data(3), paper_data(3), paper_data(4)
    np.testing.assert_array_equal(first.y, again.y)
    assert np.abs(first.y - other.y).max() > 0.1
    long = paper_data(5, n_samples=100_000)
    noise = np.var(long.y - long.x[:100_000])
    assert 10 * np.log10(np.var(long.x) / noise) == pytest.approx(14.0, abs=0.1)


def test_outliers_are_those_of_the_box_plot():
    values = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 8.0, 8.1])
    # quartiles 2.5 and 6.5: whiskers reach from -3.5 to 12.5
    assert inliers(values).all()
    assert inliers(np.append(values, 40.0)).tolist() == [True] * 7 + [False]

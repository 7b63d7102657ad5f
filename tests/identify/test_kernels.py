"""One contract for every kernel: covariance, factor and gradient agree, and say what they claim."""

import dataclasses

import numpy as np
import pytest

from ffl.bases import OBF as Basis
from ffl.errors import InputError
from ffl.identify.evidence import regularised
from ffl.identify.kernels import DC, KERNELS, OBF, TC, Diagonal, Direct, Fixed, StableSpline
from ffl.identify.regression import backward_regression
from ffl.identify.sections import PolePair, RealPole, chain_responses, sections_of

LAGS = np.arange(-20, 21)
PAIR = (0.8 + 0.1j, 0.8 - 0.1j)
BEYOND = (1.2 + 0.2j, 1.2 - 0.2j)
CASES = {
    "tc": TC(2.0, 0.8, 0.71, peak=-1),
    "tc causal": TC(2.0, 0.8, side="causal"),
    "tc anticausal": TC(2.0, decay_anticausal=0.7, side="anticausal", peak=-3),
    "dc": DC(2.0, 0.8, 0.7, peak=-1, correlation=0.5),
    "dc alternating": DC(2.0, 0.8, 0.7, correlation=-0.5),
    "dc fixed scale": DC(2.0, 0.8, 0.7, fixed=("scale",)),
    "stable spline": StableSpline(3.0, 0.85, 0.8, peak=2),
    "stable spline causal": StableSpline(3.0, 0.85, side="causal"),
    "diagonal": Diagonal(2.0, 0.9, 0.85),
    "diagonal causal": Diagonal(2.0, 0.9, side="causal", peak=3),
    "obf": OBF.of_poles([*PAIR, 0.5], [1.3], direct=3, scale=10.0),
    "obf causal": OBF.of_poles([*PAIR, -0.5], repeat=2),
    "obf fixed poles": OBF.of_poles(PAIR, BEYOND, learn_poles=False),
    "direct": Direct(-2, 0, 5.0),
    "sum": OBF.of_poles(PAIR, BEYOND, direct=2, scale=3.0)
    + Direct(-2, 1, 30.0)
    + TC(1.0, 0.8, 0.71),
    "product": OBF.of_poles(PAIR, scale=3.0) * TC(1.0, 0.8, 0.71),
    "product of sum": (DC(correlation=0.5) + Diagonal()) * TC(1.0, 0.8, 0.71),
    "fixed": Fixed(TC()),
}


@pytest.fixture(scope="module")
def rows():
    rng = np.random.default_rng(0)
    y = np.convolve(rng.standard_normal(300), [1.0, 0.6, 0.3])[:300]
    theta = np.exp(-0.2 * np.abs(LAGS)) + np.where(np.abs(LAGS + 1) < 2, 3.0, 0.0)
    r = np.convolve(y, theta, mode="same") + 0.3 * rng.standard_normal(300)
    return backward_regression(y, r, 20, 20)


def test_every_registered_kernel_has_a_case():
    assert set(KERNELS.values()) <= {type(kernel) for kernel in CASES.values()}


@pytest.mark.parametrize("kernel", CASES.values(), ids=CASES.keys())
def test_factor_is_the_covariance(kernel):
    matrix, columns = kernel.matrix(LAGS), kernel.factor(LAGS).columns
    np.testing.assert_allclose(columns @ columns.T, matrix, atol=1e-12 * np.abs(matrix).max())
    assert np.linalg.eigvalsh(matrix).min() > -1e-12 * np.abs(matrix).max()


@pytest.mark.parametrize("kernel", CASES.values(), ids=CASES.keys())
def test_coordinates_go_round_and_stay_in_bounds(kernel):
    again = kernel.at(kernel.coordinates)
    np.testing.assert_allclose(again.matrix(LAGS), kernel.matrix(LAGS), rtol=1e-11, atol=1e-11)
    assert len(kernel.names) == len(kernel.coordinates) == len(kernel.bounds) == len(kernel.spread)
    for value, (low, high) in zip(kernel.coordinates, kernel.bounds, strict=True):
        assert low < value < high


@pytest.mark.parametrize("kernel", CASES.values(), ids=CASES.keys())
@pytest.mark.parametrize("reduce", [False, True])
def test_gradient_of_the_evidence(kernel, reduce, rows):
    data = rows.triangle if reduce else rows

    def value(x, log_noise):
        factor = kernel.at(x).factor(LAGS)
        return regularised(data, factor, np.exp(log_noise)).negative_log_evidence

    x, log_noise, h = kernel.coordinates, np.log(0.2), 1e-5
    solution = regularised(data, kernel.factor(LAGS), 0.2)
    found = np.append(kernel.gradient(LAGS, solution.kernel_slope()), solution.noise_slope)
    steps = h * np.eye(len(x) + 1)
    expected = [
        (value(x + s[:-1], log_noise + s[-1]) - value(x - s[:-1], log_noise - s[-1])) / (2 * h)
        for s in steps
    ]
    np.testing.assert_allclose(found, expected, rtol=2e-5, atol=1e-6 * np.abs(expected).max())


def test_closed_forms_on_one_side():
    k = np.arange(1, 8)
    tc = TC(2.0, 0.8, side="causal").matrix(k)
    np.testing.assert_allclose(tc, 2.0 * 0.8 ** np.maximum.outer(k, k))
    dc = DC(2.0, 0.8, side="causal", correlation=np.sqrt(0.8)).matrix(k)
    np.testing.assert_allclose(dc, tc)  # TC is DC with correlation sqrt(decay)
    spline = StableSpline(6.0, 0.8, side="causal").matrix(k)
    larger, mean = np.maximum.outer(k, k), np.add.outer(k, k)
    np.testing.assert_allclose(spline, 3 * 0.8 ** (mean + larger) - 0.8 ** (3.0 * larger))


@pytest.mark.parametrize("kind", [TC, DC, StableSpline, Diagonal])
def test_sides_and_peak(kind):
    shifted = kind(peak=-3).matrix(LAGS)
    assert np.argmax(np.diag(shifted)) == np.flatnonzero(LAGS == -3)[0]
    np.testing.assert_allclose(kind().matrix(LAGS - 3), kind(peak=3).matrix(LAGS))
    causal = np.diag(kind(side="causal", peak=2).matrix(LAGS))
    np.testing.assert_array_equal(causal > 0, LAGS >= 2)
    anticausal = np.diag(kind(side="anticausal", peak=-2).matrix(LAGS))
    np.testing.assert_array_equal(anticausal > 0, LAGS <= -2)
    mirrored = kind(decay_causal=0.7, decay_anticausal=0.9).matrix(-LAGS)
    np.testing.assert_allclose(mirrored, kind(decay_causal=0.9, decay_anticausal=0.7).matrix(LAGS))


def test_obf_kernel_is_the_projector_on_the_basis():
    lags = np.arange(-400, 401)
    kernel = OBF.of_poles([*PAIR, 0.5], BEYOND, scale=1.0)
    functions = Basis([*PAIR, 0.5], BEYOND).impulse_responses(400, 400)
    np.testing.assert_allclose(kernel.matrix(lags), functions @ functions.T, atol=1e-12)
    whole = kernel.matrix(lags)
    np.testing.assert_allclose(whole @ whole, whole, atol=1e-11)  # equation (9): orthonormal
    other = OBF.of_poles([0.5, *PAIR], BEYOND, scale=1.0)  # the set of poles matters, not its order
    np.testing.assert_allclose(other.matrix(lags), whole, atol=1e-11)


def test_direct_terms_are_poles_at_the_origin():
    """Three poles of (8) at 0 before the others: q^0, q^1, q^2, the rest three samples earlier."""
    functions, _ = OBF.of_poles(outside=[1.25], direct=3).basis(LAGS)
    np.testing.assert_array_equal(functions[:, :3], np.eye(41)[:, [20, 19, 18]])
    expected = np.where(LAGS <= -3, np.sqrt(1 - 0.64) * 0.8 ** (-LAGS - 3.0), 0.0)
    np.testing.assert_allclose(functions[:, 3], expected, atol=1e-15)


def test_chain_is_orthonormal_even_for_repeated_and_clustered_poles():
    chain = sections_of([0.98 + 0.1j, 0.98 - 0.1j, 0.98, 0.98, -0.9]) * 2
    states, _ = chain_responses(chain, 4000)
    np.testing.assert_allclose(states.T @ states, np.eye(10), atol=1e-12)


@pytest.mark.parametrize(
    "section",
    [RealPole.at(-0.7), PolePair.at(0.9 + 0.2j), PolePair(-1.0, -4.0), PolePair(-1.0, -2.0)],
)
def test_section_holds_its_poles_and_their_tangents(section):
    matrix, slopes = section.lattice()
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(len(matrix)), atol=1e-14)
    eigenvalues = np.linalg.eigvals(matrix[:-1, :-1])
    np.testing.assert_allclose(
        np.sort_complex(eigenvalues), np.sort_complex(section.poles), atol=1e-7
    )
    names = [f.name for f in dataclasses.fields(section)]
    for slope, name in zip(slopes, names, strict=True):
        up, down = (
            dataclasses.replace(section, **{name: getattr(section, name) + h}).lattice()[0]
            for h in (1e-6, -1e-6)
        )
        np.testing.assert_allclose(slope, (up - down) / 2e-6, atol=1e-8)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: TC(side="left"), "none of"),
        (lambda: TC(scale=0.0), "positive and finite"),
        (lambda: TC(decay_causal=1.0), r"lie in \(0, 1\)"),
        (lambda: TC(fixed=("peak",)), "no hyperparameters"),
        (lambda: DC(correlation=1.0), "correlation"),
        (lambda: Direct(1, 0), "first <= last"),
        (lambda: Direct(0, 1, -1.0), "positive"),
        (lambda: Direct(0, 1).matrix(LAGS), "no covariance matrix"),
        (lambda: OBF(direct=-1), "0 or more"),
        (lambda: OBF(scale=np.inf), "positive and finite"),
        (lambda: OBF.of_poles([1.2]), "not inside the unit circle"),
        (lambda: OBF.of_poles(outside=[0.9]), "not outside"),
        (lambda: OBF.of_poles([0.9 + 0.1j]), "write pairs in full"),
        (lambda: TC(scale=np.nan), "positive and finite"),
    ],
)
def test_kernels_refuse_what_is_no_kernel(make, words):
    with pytest.raises(InputError, match=words):
        make()

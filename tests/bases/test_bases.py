"""One contract for every registered basis, and what each is known to be."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ffl.bases import BASES, FIR, OBF, Derivatives, SumBasis, derivative, make_basis
from ffl.errors import InputError
from ffl.systems import Move, moves

T = 1e-3
INSIDE = [0.9039, 0.9853, 0.9854 + 0.0457j, 0.9854 - 0.0457j, 0.9988]
OUTSIDE = [1.008 + 0.0477j, 1.008 - 0.0477j, 1.078]
SPECS = {
    "fir": {"kind": "fir", "preview": 3, "lag": 6},
    "obf": {"kind": "obf", "poles": INSIDE, "outside": OUTSIDE, "feedthrough": True, "repeat": 2},
    "derivatives": {"kind": "derivatives"},
}
REFERENCE = moves([Move(0.5, 0.1, 0.4, 4.0, 200.0)], 2.0, T)
LTI = sorted(SPECS)


@pytest.mark.parametrize("kind", LTI)
def test_contract_shapes_linearity_and_rest(kind):
    basis = make_basis([SPECS[kind]], T)
    phi = basis.regressors(REFERENCE)
    assert phi.shape == (len(REFERENCE), basis.n_parameters)
    assert len(set(basis.names)) == basis.n_parameters
    assert np.all(np.isfinite(phi))
    size = np.abs(phi).max(axis=0)
    assert np.all(
        np.abs(basis.regressors(-2.5 * REFERENCE) + 2.5 * phi).max(axis=0) <= 2e-8 * size
    )  # snap divides rounding by T^4
    assert np.abs(basis.regressors(np.zeros(200))).max() == 0


@pytest.mark.parametrize("kind", LTI)
def test_contract_shift_in_time_shifts_the_regressors(kind):
    basis = make_basis([SPECS[kind]], T)
    later = np.concatenate([np.zeros(300), REFERENCE])
    assert basis.regressors(later)[300:] == pytest.approx(basis.regressors(REFERENCE), abs=1e-10)


@pytest.mark.parametrize("kind", LTI)
def test_contract_response_is_that_of_the_regressors(kind):
    """A long sine: the middle of the filtered signal has the amplitude and phase of Psi."""
    basis = make_basis([SPECS[kind]], T)
    f = 11.0
    t = np.arange(40001) * T
    phi = basis.regressors(np.sin(2 * np.pi * f * t))
    expected = np.imag(np.exp(2j * np.pi * f * t)[:, None] * basis.response([f]))
    middle = slice(20000, 21000)
    scale = np.abs(expected).max(axis=0)
    assert np.abs((phi - expected)[middle] / scale).max() < 1e-6


def test_every_registered_basis_is_in_the_contract_or_has_its_own_test():
    assert {"fir", "obf", "derivatives"} <= set(BASES)


def test_obf_is_orthonormal_on_the_unit_circle_and_in_time():
    basis = OBF(INSIDE, OUTSIDE, feedthrough=True, repeat=2, sample_time=T)
    assert basis.n_parameters == 18
    z = np.exp(2j * np.pi * np.arange(1 << 16) / (1 << 16))
    psi = basis.at(z)
    gram = psi.conj().T @ psi / len(z)
    assert np.abs(gram - np.eye(18)).max() < 1e-10
    phi = basis.impulse_responses(4000, 30000)
    assert np.abs(phi.T @ phi - np.eye(18)).max() < 1e-10


def printed(z, inside, anticausal):
    """(6) and (7) as the paper prints them, complex, for complete pole sequences."""
    columns = []
    all_pass = np.ones_like(z)
    for p in inside:
        columns.append(np.sqrt(1 - abs(p) ** 2) / (z - p) * all_pass)
        all_pass = all_pass * (1 - np.conj(p) * z) / (z - p)
    all_pass = np.ones_like(z)
    for p in anticausal:
        columns.append(np.sqrt(1 - abs(p) ** 2) / (1 - np.conj(p) * z) * all_pass)
        all_pass = all_pass * (z - p) / (1 - np.conj(p) * z)
    return np.column_stack(columns)


@pytest.mark.parametrize("repeat", [1, 3])
def test_obf_is_a_unitary_transformation_of_equations_6_and_7(repeat):
    basis = OBF(INSIDE, OUTSIDE, feedthrough=True, repeat=repeat, sample_time=T)
    z = np.exp(2j * np.pi * np.arange(1 << 16) / (1 << 16))
    anticausal = [0.0, *(1 / np.conj(np.array(OUTSIDE)))]
    paper = printed(z, INSIDE * repeat, anticausal * repeat)
    transform = paper.conj().T @ basis.at(z) / len(z)
    n = basis.n_parameters
    assert np.abs(transform.conj().T @ transform - np.eye(n)).max() < 1e-9
    assert np.abs(paper @ transform - basis.at(z)).max() < 1e-8


def test_a_direct_term_is_the_reference_itself():
    basis = OBF([0.5], [2.0], feedthrough=True, sample_time=T)
    phi = basis.regressors(REFERENCE)
    assert phi[:, 1] == pytest.approx(REFERENCE, abs=1e-15)


@given(st.floats(-0.99, 0.99), st.integers(1, 4))
def test_real_pole_chain_is_takenaka_malmquist(pole, repeat):
    basis = OBF([pole], repeat=repeat)
    phi = basis.impulse_responses(0, 40)
    t = np.arange(1, 41)
    assert phi[1:, 0] == pytest.approx(np.sqrt(1 - pole**2) * pole ** (t - 1.0), abs=1e-12)


def test_repetition_extends_the_basis_and_keeps_what_was_there():
    once = OBF(INSIDE, OUTSIDE, True, 1, T).impulse_responses(50, 50)
    twice = OBF(INSIDE, OUTSIDE, True, 2, T).impulse_responses(50, 50)
    assert twice[:, :5] == pytest.approx(once[:, :5], abs=1e-12)
    assert twice[:, 10:14] == pytest.approx(once[:, 5:], abs=1e-12)


def test_fir_taps_are_shifts_with_the_ends_held():
    basis = FIR(preview=1, lag=2)
    r = np.array([0.0, 1.0, 3.0, 2.0])
    expected = [[1, 0, 0, 0], [3, 1, 0, 0], [2, 3, 1, 0], [2, 2, 3, 1]]
    assert basis.regressors(r) == pytest.approx(np.array(expected, float))
    placed = FIR(delays=[-2, 1])
    assert placed.regressors(r)[:, 0] == pytest.approx([3, 2, 2, 2])


def test_derivatives_of_a_polynomial_are_exact():
    t = np.arange(200) * T
    r = 3 * t**2
    assert derivative(r, 1, T)[5:-5] == pytest.approx(6 * t[5:-5], abs=1e-9)
    assert derivative(r, 2, T)[5:-5] == pytest.approx(6.0, abs=1e-6)
    assert Derivatives(["acceleration"], T).regressors(r)[5:-5, 0] == pytest.approx(6.0, abs=1e-6)


def test_sum_of_bases_stands_side_by_side():
    both = make_basis([SPECS["fir"], SPECS["derivatives"]], T)
    assert isinstance(both, SumBasis)
    assert both.n_parameters == 10 + 4
    assert both.regressors(REFERENCE)[:, :10] == pytest.approx(FIR(3, 6).regressors(REFERENCE))
    assert both.response([3.0]).shape == (1, 14)


@pytest.mark.parametrize(
    ("specs", "message"),
    [
        ([], "empty"),
        ([{"kind": "fri"}], r"\[0\].kind = 'fri': unknown basis; did you mean 'fir'"),
        (
            [{"kind": "obf", "poles": [0.5], "outsid": [2.0]}],
            r"\[0\].outsid: unknown key.*'outside'",
        ),
        ([{"kind": "obf", "poles": [[0.5, 0.1]]}], r"\[0\] poles holds 0.5\+0.1i without"),
        ([{"kind": "obf", "poles": [1.0]}], "on the unit circle; move it"),
        ([{"kind": "obf", "poles": [1.1]}], "not inside the unit circle; put it under 'outside'"),
        ([{"kind": "obf", "poles": [0.5], "outside": [0.9]}], "put it under 'poles'"),
        ([{"kind": "obf", "poles": [0.5], "outside": [[0, 1], [0, -1]]}], "on the unit circle"),
        ([{"kind": "obf", "poles": [0.5], "repeat": 0}], "repeat = 0"),
        ([{"kind": "obf", "poles": []}], "at least one pole"),
        ([{"kind": "obf", "poles": ["x"]}], "give a list of reals"),
        ([{"kind": "fir", "preview": -1}], "must not be negative"),
        ([{"kind": "fir", "delays": [1, 1]}], "different whole numbers"),
        ([{"kind": "fir", "delays": [1], "lag": 2}], "not both"),
        ([{"kind": "derivatives", "orders": ["speed"]}], "order 'speed' unknown"),
        ([{"kind": "derivatives", "orders": []}], "at least one"),
        ([{"kind": "free"}, {"kind": "fir"}], "use it alone"),
    ],
)
def test_wrong_bases_are_refused(specs, message):
    with pytest.raises(InputError, match=message):
        make_basis(specs, T)


def test_reference_shorter_than_the_taps_is_refused():
    with pytest.raises(InputError, match="lengthen the reference"):
        FIR(3, 6).regressors(np.zeros(5))


def test_the_free_signal_never_makes_its_matrix():
    with pytest.raises(InputError, match="riccati"):
        make_basis([{"kind": "free"}], T).regressors(REFERENCE)


def test_a_filter_is_its_taps_and_holds_the_ends():
    basis = make_basis([{"kind": "filter", "first": -1, "taps": [2.0, 3.0, -1.0]}], T)
    r = np.array([1.0, 1.0, 4.0, 2.0])
    expected = [2 * 1 + 3 * 1 - 1, 2 * 4 + 3 - 1, 2 * 2 + 3 * 4 - 1, 2 * 2 + 3 * 2 - 4]
    assert basis.regressors(r)[:, 0] == pytest.approx(expected)
    f = 7.0
    t = np.arange(4001) * T
    phi = basis.regressors(np.sin(2 * np.pi * f * t))[:, 0]
    wanted = np.imag(np.exp(2j * np.pi * f * t) * basis.response([f])[0, 0])
    assert np.abs(phi - wanted)[100:-100].max() < 1e-12
    late = make_basis([{"kind": "filter", "first": 2, "taps": [1.0]}], T)
    assert late.regressors(r)[:, 0] == pytest.approx([1, 1, 1, 1])
    assert late.preview == 0


def test_a_combination_carries_learned_parameters():
    inner = {"kind": "fir", "preview": 1, "lag": 1}
    basis = make_basis([{"kind": "combination", "basis": [inner], "theta": [1.0, -2.0, 0.5]}], T)
    assert basis.n_parameters == 1
    expected = make_basis([inner], T).regressors(REFERENCE) @ [1.0, -2.0, 0.5]
    assert np.array_equal(basis.regressors(REFERENCE)[:, 0], expected)
    for table, message in (
        ({"theta": [1.0]}, "wants 3 finite numbers"),
        ({"theta": [1.0, np.nan, 0.0]}, "wants 3 finite numbers"),
    ):
        with pytest.raises(InputError, match=message):
            make_basis([{"kind": "combination", "basis": [inner], **table}], T)
    with pytest.raises(InputError, match="taps must be"):
        make_basis([{"kind": "filter", "taps": []}], T)
    with pytest.raises(InputError, match="whole number"):
        make_basis([{"kind": "filter", "taps": [1.0], "first": 0.5}], T)


@pytest.mark.parametrize("wrong", [{"delays": [1.2, 1.7]}, {"preview": 2.5}])
def test_taps_are_whole_samples(wrong):
    with pytest.raises(InputError, match="whole number"):
        FIR(**wrong)

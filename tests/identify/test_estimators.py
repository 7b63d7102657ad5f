"""Estimators behave as people expect; coloured noise; the inverse as filter, basis, feedforward."""

from types import SimpleNamespace

import numpy as np
import pytest

from ffl.bases.base import Basis
from ffl.errors import InputError
from ffl.identify import KernelInverse, LeastSquaresInverse
from ffl.identify.bayes import DirectBayesianInverse
from ffl.identify.kernels import OBF, TC, Direct
from ffl.identify.noise import NoiseModel, fit_noise, noise_of, whitened
from ffl.identify.regression import Edges, backward_regression
from ffl.recordings import Recording
from ffl.systems import Zpk, two_sided_filter

PLANT = Zpk([1.25], [0.8, 0.5], 0.4, 0.01)  # non-minimum phase, relative degree 1


def record(n=600, seed=0, noise=0.3, colour=None, tail=60):
    rng = np.random.default_rng(seed)
    r = rng.standard_normal(n)
    y = PLANT.filter(np.pad(r, tail))
    v = noise * rng.standard_normal(n + 200)
    if colour is not None:
        v = colour.filter(v)
    return y, r + v[200:], tail


CASES = {
    "least squares": LeastSquaresInverse(30, 20, Edges("known", "known")),
    "kernel": KernelInverse(None, 30, 20, Edges("known", "known")),
    "obf": KernelInverse(
        OBF.of_poles([0.5], [1.3], direct=2, scale=10.0), 30, 20, Edges("known", "known")
    ),
}


@pytest.mark.parametrize("model", CASES.values(), ids=CASES.keys())
def test_contract(model):
    params = model.get_params()
    copy = type(model)(**params)
    assert all(copy.get_params()[k] is params[k] for k in params)
    assert not [name for name in vars(model) if name.endswith("_")]
    y, r, tail = record()
    assert copy.fit(y, r, lead=tail) is copy
    inverse = copy.inverse_
    assert inverse.theta.shape == (51,)
    assert copy.edges_.startswith("rows 0..599 of 600 used")
    assert copy.noise_variance_ == pytest.approx(0.09, rel=0.25)
    again = type(model)(**params).fit(y, r, lead=tail)
    np.testing.assert_array_equal(again.inverse_.theta, inverse.theta)
    assert copy.set_params(n_ac=10).n_ac == 10
    with pytest.raises(InputError, match="has no parameter"):
        copy.set_params(order=3)
    assert type(model).__name__ in repr(model)


@pytest.mark.parametrize("model", CASES.values(), ids=CASES.keys())
def test_identified_feedforward_tracks(model):
    y, r, tail = record(noise=0.05, n=2000)
    inverse = type(model)(**model.get_params()).fit(y, r, lead=tail).inverse_
    reference = np.sin(0.05 * np.arange(400)) * np.hanning(400)
    before, after = inverse.preview
    f = inverse.feedforward(reference, before, after)
    assert len(f) == 400 + 50
    output = PLANT.filter(f)[before : before + 400]
    assert np.linalg.norm(reference - output) < 0.05 * np.linalg.norm(reference)


def test_clone_by_scikit_learn_if_it_is_there():
    base = pytest.importorskip("sklearn.base")
    model = CASES["obf"]
    assert base.clone(model, safe=False).get_params() == model.get_params()


def test_not_fitted_is_said():
    with pytest.raises(InputError, match="call fit first"):
        KernelInverse().predict(np.ones(10))


def test_recordings_map_output_to_command():
    y, u, tail = record()
    recording = SimpleNamespace(y=y[tail : tail + 600], u=u, sample_time=0.01)
    model = LeastSquaresInverse(20, 20).fit(recording)
    arrays = LeastSquaresInverse(20, 20).fit(recording.y, recording.u)
    np.testing.assert_array_equal(model.inverse_.theta, arrays.inverse_.theta)
    assert model.inverse_.sample_time == 0.01
    with pytest.raises(InputError, match="recording with u and y"):
        LeastSquaresInverse(20, 20).fit(y)


@pytest.mark.parametrize(
    "method",
    [LeastSquaresInverse(2, 4), KernelInverse(TC(), 2, 4), DirectBayesianInverse(2, 4)],
    ids=lambda method: type(method).__name__,
)
def test_a_known_load_drives_the_plant_beside_the_command(method):
    """y = 0.2 q^-1 (u + d)/(1 - 0.9 q^-1), so that u + d = 5 y(t+1) - 4.5 y(t)."""
    rng = np.random.default_rng(3)
    u, n = rng.standard_normal(800), np.arange(800)
    d = 2.0 * np.sin(0.02 * n) + 0.5 * u
    y = Zpk([], [0.9], 0.2, 1e-3).filter(u + d) + 1e-4 * rng.standard_normal(800)
    recording = Recording.from_signals(1e-3, y=y, u=u, d=d)
    fitted = method.fit(recording)
    taps = fitted.theta_ if hasattr(fitted, "theta_") else fitted.inverse_.theta
    assert taps[:4] == pytest.approx([0.0, 5.0, -4.5, 0.0], abs=0.02)


def test_inverse_is_a_basis_and_looks_ahead():
    y, r, tail = record()
    inverse = CASES["kernel"].fit(y, r, lead=tail).inverse_
    basis = inverse.basis("printer")
    assert isinstance(basis, Basis)
    reference = np.concatenate([np.zeros(100), np.ones(100)])
    assert basis.regressors(reference).shape == (200, 1)
    assert (basis.names, basis.n_parameters, basis.preview) == (["printer"], 1, 30)
    np.testing.assert_array_equal(basis.regressors(reference)[:, 0], inverse.feedforward(reference))
    # the reference holds its last value: the feedforward ends at the static gain
    assert inverse.feedforward(reference)[-1] == pytest.approx(inverse.theta.sum())
    f = [0.5, 3.0, 20.0]
    direct = [sum(inverse.theta * np.exp(-2j * np.pi * x * inverse.lags)) for x in f]
    np.testing.assert_allclose(inverse.response(f), direct, atol=1e-12)
    np.testing.assert_allclose(basis.response(f)[:, 0], direct, atol=1e-12)


def test_feedforward_equals_the_convolution():
    y, r, tail = record()
    inverse = CASES["kernel"].fit(y, r, lead=tail).inverse_
    reference = np.random.default_rng(0).standard_normal(80)
    whole = inverse.feedforward(reference, 30, 20, outside="zero")
    np.testing.assert_allclose(whole, np.convolve(reference, inverse.theta), atol=1e-12)
    with pytest.raises(InputError, match="neither"):
        inverse.feedforward(reference, outside="wrap")
    with pytest.raises(InputError, match="0 or more"):
        inverse.feedforward(reference, before=-1)


def test_bands_and_draws_agree():
    y, r, tail = record()
    inverse = CASES["kernel"].fit(y, r, lead=tail).inverse_
    draws = inverse.draws(4000, np.random.default_rng(1))
    np.testing.assert_allclose(draws.std(axis=0), inverse.standard_deviation, rtol=0.1, atol=1e-6)
    np.testing.assert_allclose(
        np.cov(draws.T), inverse.covariance, atol=0.1 * inverse.covariance.max()
    )
    f = np.array([0.02, 0.1, 0.3])
    band = inverse.magnitude_band(f, 0.9)
    sampled = np.abs(draws @ np.exp(-2j * np.pi * np.outer(inverse.lags, f)))
    np.testing.assert_allclose(
        band.upper - band.lower,
        np.diff(np.quantile(sampled, [0.05, 0.95], axis=0), axis=0)[0],
        rtol=0.15,
    )
    with pytest.raises(InputError, match="between 0 and 1"):
        inverse.impulse_band(1.0)


COLOUR = Zpk([0.0], [0.95], 1.0, 0.01)  # v = eps/(1 - 0.95 q^-1): a slow load


def test_coloured_noise_costs_where_ignored_and_is_repaired():
    """Remark 2: 8 records of 600 samples; error of theta, squared, white : coloured : known."""
    truth = two_sided_filter(PLANT.inverse(), np.ones(1), 30, 20)
    known = NoiseModel(np.array([1.0, -0.95]), 0.09)
    squares = {"white": [], "coloured": [], "known": []}
    for seed in range(8):
        y, r, tail = record(seed=seed, colour=COLOUR)
        for name, noise in (("white", "white"), ("coloured", "coloured"), ("known", known)):
            model = KernelInverse(
                OBF.of_poles([0.5], [1.25], direct=2, scale=10.0, learn_poles=False),
                30,
                20,
                Edges("known", "known"),
                noise=noise,
            ).fit(y, r, lead=tail)
            squares[name].append(np.sum((model.inverse_.theta - truth) ** 2))
    mean = {name: np.mean(values) for name, values in squares.items()}
    assert mean["white"] > 3.0 * mean["coloured"]
    assert mean["coloured"] < 1.3 * mean["known"]


def test_noise_models():
    rng = np.random.default_rng(0)
    v = COLOUR.filter(rng.standard_normal(20000))
    found = fit_noise(v)
    assert found.order <= 4
    assert found.filter[1] == pytest.approx(-0.95, abs=0.02)
    assert found.variance == pytest.approx(1.0, rel=0.05)
    assert fit_noise(rng.standard_normal(5000)).order <= 1
    assert fit_noise(v, 3).order == 3
    exact = noise_of(COLOUR, 2.0, order=5)
    np.testing.assert_allclose(exact.filter, [1, -0.95, 0, 0, 0, 0], atol=1e-9)
    assert exact.variance == pytest.approx(2.0)


def test_noise_of_a_non_causal_inverse_is_its_minimum_phase_twin():
    """|P^-1|^2 with a zero of P at 1.25: the same spectrum as with the zero reflected to 0.8."""
    twin = Zpk([0.8], [0.8, 0.5], 0.4 * 1.25, 0.01)
    found, expected = noise_of(PLANT.inverse(), order=40), noise_of(twin.inverse(), order=40)
    np.testing.assert_allclose(found.filter, expected.filter, atol=1e-9)
    with pytest.raises(InputError, match="unit circle"):
        noise_of(Zpk([], [1.0], 1.0, 0.01))
    with pytest.raises(InputError, match="1 or more"):
        noise_of(PLANT, order=0)


def test_whitening_keeps_theta():
    y, r, tail = record(noise=0.0)
    rows = backward_regression(y, r, 30, 20, Edges("known", "known"), lead=tail)
    theta = two_sided_filter(PLANT.inverse(), np.ones(1), 30, 20)
    again = whitened(rows, NoiseModel(np.array([1.0, -0.5, 0.2]), 1.0))
    assert (again.n_rows, again.first) == (598, 2)
    np.testing.assert_allclose(again.apply(theta), again.target, atol=5e-3)
    with pytest.raises(InputError, match="leaves no row"):
        whitened(rows, NoiseModel(np.ones(700), 1.0))


@pytest.mark.parametrize("noise", ["pink", 0, -2, None])
def test_noise_must_be_known(noise):
    y, r, tail = record()
    with pytest.raises(InputError, match="AR order"):
        KernelInverse(TC(), 30, 20, Edges("known", "known"), noise=noise).fit(y, r, lead=tail)


def test_kernel_without_learning_is_used_as_given():
    y, r, tail = record()
    kernel = TC(1.0, 0.6, 0.8) + Direct(-1, 0)
    model = KernelInverse(kernel, 30, 20, Edges("known", "known"), learn=False, noise_variance=0.09)
    model.fit(y, r, lead=tail)
    assert model.evidence_.n_evaluations == 1
    assert model.noise_variance_ == 0.09
    assert model.kernel_.names == ()


def test_taps_that_the_data_cannot_see_keep_the_spread_of_the_prior():
    """Their prior variance lies below what the kernel's factor keeps: without it they had none."""
    y, r, _ = record(tail=0)
    kernel = TC(scale=0.5, decay_causal=0.2, decay_anticausal=0.2)
    found = KernelInverse(kernel, 0, 60, learn=False).fit(y, r).inverse_
    prior = np.sqrt(np.diag(kernel.matrix(found.lags)))
    np.testing.assert_allclose(found.standard_deviation[30:], prior[30:], rtol=1e-6)
    assert found.covariance[40, 40] == pytest.approx(prior[40] ** 2)

"""Inverse from one noisy closed-loop trial: no bias by instruments, tracking beside learning."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.bases import FIR, OBF, Derivatives, FreeSignal, SumBasis
from ffl.errors import InputError
from ffl.identify import InstrumentalInverse, ParametricInverse
from ffl.learn import LearningTask, Weights, learn
from ffl.machines import SimulatedMachine
from ffl.systems import Controller, Move, Plant, Zpk, load_plant, moves

INSIDE = [0.9039, 0.9853, 0.9854 + 0.0457j, 0.9854 - 0.0457j, 0.9988]
OUTSIDE = [1.008 + 0.0477j, 1.008 - 0.0477j, 1.078]
MODEL = load_plant("flatbed_printer")
BUILT = load_plant("flatbed_printer_built")
REFERENCE = moves(
    [Move(s, d, 0.6, 3.0, 60.0) for s, d in ((1.5, 0.3), (3.5, -0.3), (5.5, 0.3))], 8.0, 1e-3
)
BASIS = OBF(INSIDE, OUTSIDE, feedthrough=True, sample_time=1e-3)


def machine(sensor_noise):
    return SimulatedMachine(
        replace(BUILT, machine=replace(BUILT.machine, sensor_noise=sensor_noise))
    )


def tracking(model, rng):
    recording = machine(3e-7).run(REFERENCE, model.predict(REFERENCE), rng)
    return np.linalg.norm(REFERENCE - recording.y)


def test_one_trial_of_identification_beside_ten_of_learning():
    """Printer as built: feedback only 2.85, the model's inverse 0.19, ten trials of OBF 0.0023."""
    printer = machine(3e-7)
    first = printer.run(REFERENCE, None, np.random.default_rng(1))
    found = InstrumentalInverse(BASIS, MODEL).fit(first)
    identified = tracking(found, np.random.default_rng(2))
    task = LearningTask(MODEL, printer, BASIS, REFERENCE, Weights(50.0, 1e-7, 0.0))
    learned = [trial.error_norm for trial in learn(task, 10, np.random.SeedSequence(1))]
    assert learned[0] > 2.5
    assert identified < 0.004
    assert identified < 2.0 * learned[-1]
    assert identified < 0.1 * learned[1]  # the second trial of each: what one recording buys
    assert found.rank_ == 9


def test_instruments_remove_what_the_feedback_of_noise_costs():
    """Sensor noise of 0.1 mm, 8 trials: mean tracking error, least squares : instrumental > 2."""
    errors = {"least_squares": [], "instrumental": []}
    for seed in range(8):
        recording = machine(1e-4).run(REFERENCE, None, np.random.default_rng(seed))
        for method, values in errors.items():
            model = InstrumentalInverse(BASIS, MODEL, method).fit(recording)
            values.append(tracking(model, np.random.default_rng(100)))
    assert np.mean(errors["least_squares"]) > 2.0 * np.mean(errors["instrumental"])


SMALL = Plant(
    "small",
    Zpk([0.7], [1.0, 0.8], 0.02, 0.01),
    Controller.of_error(Zpk([], [], 2.0, 0.01)),
)


def small_trial(seed, n=3000):
    """A plant whose inverse the basis holds exactly: u(t) = 50 (y(t+1) - 1.8 y(t) + ..)/(..)."""
    rng = np.random.default_rng(seed)
    r = np.concatenate([np.zeros(20), np.cumsum(rng.standard_normal(n)) * 0.1])
    noise = 0.05 * rng.standard_normal(len(r))
    inputs = np.column_stack([r, np.zeros_like(r), np.zeros_like(r), noise])
    y, u = SMALL.loop.system.filter(inputs).T
    return type("Trial", (), {"r": r, "f": np.zeros_like(r), "u": u, "y": y})()


def test_estimate_is_consistent_and_its_standard_errors_are_right():
    functions = SumBasis([FIR(1, 0, sample_time=0.01), OBF([0.7], sample_time=0.01)])
    f = np.array([1.0, 5.0, 20.0, 40.0])
    psi = functions.response(f)
    stacked = np.vstack([psi.real, psi.imag])
    target = SMALL.system.inverse().response(f)
    truth = np.linalg.lstsq(stacked, np.concatenate([target.real, target.imag]), rcond=None)[0]
    scores, biased = [], []
    for seed in range(40):
        trial = small_trial(seed)
        found = InstrumentalInverse(functions, SMALL).fit(trial)
        scores.append((found.theta_ - truth) / found.inverse_.standard_errors)
        biased.append(InstrumentalInverse(functions, SMALL, "least_squares").fit(trial).theta_)
    scores, biased = np.array(scores), np.array(biased)
    assert np.abs(scores.mean(axis=0)).max() < 0.6  # 40 trials: standard error 0.16
    assert scores.std(axis=0).min() > 0.6
    assert scores.std(axis=0).max() < 1.6
    assert np.abs((biased.mean(axis=0) - truth) / biased.std(axis=0)).max() > 5.0


def test_inverse_has_response_band_and_basis():
    found = InstrumentalInverse(BASIS, MODEL).fit(
        machine(3e-7).run(REFERENCE, None, np.random.default_rng(1))
    )
    inverse = found.inverse_
    assert isinstance(inverse, ParametricInverse)
    f = np.array([0.5, 2.0, 5.0])
    truth = np.abs(BUILT.system.inverse().response(f))
    band = inverse.magnitude_band(f)
    np.testing.assert_allclose(np.abs(inverse.response(f)), truth, rtol=0.03)
    assert np.all(band.lower < band.middle)
    column = inverse.basis("printer").regressors(REFERENCE)
    np.testing.assert_array_equal(column[:, 0], found.predict(REFERENCE))
    assert inverse.basis().preview == -1
    assert inverse.basis().response(f).shape == (3, 1)


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        ({"y": np.full(8000, 0.1)}, {}, "output is constant"),
        ({"r": np.zeros(8000)}, {}, "excite nothing that could serve"),
        ({"u": np.full(8000, np.nan)}, {}, "8000 samples are NaN"),
        ({}, {"method": "magic"}, "neither"),
        ({}, {"model": replace(MODEL, controller=None)}, "no \\[controller\\]"),
    ],
)
def test_refusals(change, options, words):
    recording = machine(3e-7).run(REFERENCE, None, np.random.default_rng(1))
    columns = {n: change.get(n, getattr(recording, n)) for n in ("r", "f", "u", "y")}
    arguments = {"basis": BASIS, "model": MODEL, **options}
    with pytest.raises(InputError, match=words):
        InstrumentalInverse(**arguments).fit(type("Trial", (), columns)())


def test_more_refusals():
    recording = machine(3e-7).run(REFERENCE, None, np.random.default_rng(1))
    with pytest.raises(InputError, match="takes one recording"):
        InstrumentalInverse(BASIS, MODEL).fit(recording, recording.u)
    short = type("Trial", (), {n: getattr(recording, n)[:5] for n in ("r", "f", "u", "y")})()
    with pytest.raises(InputError, match="fewer than the 9 functions"):
        InstrumentalInverse(BASIS, MODEL).fit(short)
    with pytest.raises(InputError, match="call fit first"):
        InstrumentalInverse(BASIS, MODEL).predict(REFERENCE)
    theta, spread = np.zeros(8000), np.zeros((8000, 1))
    free = ParametricInverse(FreeSignal(), theta, spread, 1e-3)
    with pytest.raises(InputError, match="not time-invariant"):
        free.response([1.0])


def test_a_recording_that_begins_in_motion_says_as_much_as_a_whole_one():
    """Cut on the way, as if it had begun at rest, -9.8 N s/m and 0.28 kg were told for 17.8 and 5.2."""
    model = load_plant("emps")
    basis = Derivatives(["velocity", "acceleration"], sample_time=1e-3)
    device = SimulatedMachine(
        replace(model, machine=replace(model.machine, sensor_noise=1e-6, force_noise=0.0))
    )
    whole = device.run(REFERENCE / 3.0, None, np.random.default_rng(0))
    cut = replace(whole, **{c: getattr(whole, c)[1700:] for c in "trfuy"})
    assert abs(cut.y[10] - cut.y[0]) > 1e-4  # moving
    found = [InstrumentalInverse(basis, model).fit(one) for one in (whole, cut)]
    errors = [np.sqrt(np.sum(one.inverse_.spread**2, axis=1)) for one in found]
    assert np.all(np.abs(found[1].theta_ - found[0].theta_) < 4.0 * np.hypot(*errors))
    assert found[1].theta_[1] == pytest.approx(found[0].theta_[1], rel=0.02)
    assert np.all(errors[1] < 4.0 * errors[0])
    assert found[1].instrument_strength_ > 0.99


def test_an_inverse_stands_beside_other_functions_in_either_order():
    taps = InstrumentalInverse(BASIS, MODEL).fit(
        machine(3e-7).run(REFERENCE, None, np.random.default_rng(1))
    )
    parts = [taps.inverse_.basis(), Derivatives(["velocity"], sample_time=1e-3)]
    for both in (parts, parts[::-1]):
        assert SumBasis(both).sample_time == 1e-3

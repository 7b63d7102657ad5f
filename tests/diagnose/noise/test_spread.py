"""Standard errors where what is left is not white: what they state is what repetition shows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.signal

from ffl.diagnose.hypothesis.fit import Fit
from ffl.diagnose.noise.spread import error_of, own_error_of, spread, stepped_error_of
from ffl.systems.plant import EffectSpec

TRUE = np.array([2.0, -1.0])
N = 4000
NUMBER = SimpleNamespace(kind="effect")
OPTION = SimpleNamespace(kind="option", lower=np.log(0.05), upper=np.log(20.0))


def model_of(*coordinates):  # type: ignore[no-untyped-def]
    return SimpleNamespace(coordinates=coordinates)


def fitted(rng, alike):  # type: ignore[no-untyped-def]
    """Two slow columns in first-order noise; J is minus the derivative of the residual."""
    t = np.arange(N) / N
    table = np.column_stack([np.sin(2 * np.pi * 3 * t), np.cos(2 * np.pi * 5 * t)])
    noise = scipy.signal.lfilter([1.0], [1.0, -alike], rng.standard_normal(N))
    y = table @ TRUE + noise
    theta = np.linalg.lstsq(table, y, rcond=None)[0]
    return theta, Fit(model_of(NUMBER, NUMBER), y - table @ theta, table, table, "converged")


def covered(errors, alike, draws=150):  # type: ignore[no-untyped-def]
    rng, within = np.random.default_rng(3), []
    for _ in range(draws):
        theta, fit = fitted(rng, alike)
        within.append(np.abs(theta - TRUE) < 2.0 * errors(fit))
    return float(np.mean(within))


def blocks(fit):  # type: ignore[no-untyped-def]
    return spread(fit, [N // 4, N - N // 4])


def test_two_standard_errors_hold_in_coloured_noise():
    assert covered(lambda fit: fit.spread, 0.9) < 0.5
    assert covered(blocks, 0.9) > 0.88


def test_in_white_noise_they_are_those_of_white_noise():
    ratios = []
    rng = np.random.default_rng(4)
    for _ in range(50):
        _, fit = fitted(rng, 0.0)
        ratios.append(blocks(fit) / fit.spread)
    assert np.min(ratios) == pytest.approx(1.0)
    assert np.mean(ratios) < 1.15
    assert 0.93 < covered(blocks, 0.0) < 1.0


def test_what_the_data_do_not_see_stays_unknown():
    _, fit = fitted(np.random.default_rng(5), 0.0)
    three = model_of(NUMBER, NUMBER, NUMBER)
    table = np.column_stack([fit.jacobian, np.zeros(N)])
    blind = replace(fit, model=three, jacobian=table)
    found = blocks(blind)
    assert found[2] > 1e6 * found[0]
    np.testing.assert_allclose(found[:2], blocks(fit), rtol=1e-6)


def test_an_option_that_nothing_shows_is_no_doubt_of_the_others():
    """How a mass is shared, beside a spring that hardly depends on it: its column is a ten-thousandth of
    the others', and nearly theirs. The mass was told to 14 % (20270103/0098), and 6.3 % not as missing."""
    rng = np.random.default_rng(6)
    _, fit = fitted(rng, 0.0)
    nearly = 1e-4 * fit.jacobian @ [1.0, 1.0] + 1e-6 * rng.standard_normal(N)
    table = np.column_stack([fit.jacobian, nearly])
    free = replace(fit, model=model_of(NUMBER, NUMBER, NUMBER), jacobian=table)
    within = replace(fit, model=model_of(NUMBER, NUMBER, OPTION), jacobian=table)
    plain = fit.spread
    assert np.all(free.spread[:2] > 20.0 * plain)
    np.testing.assert_allclose(within.spread[:2], plain, rtol=1e-3)
    assert within.spread[2] == pytest.approx(np.log(400.0) / np.sqrt(12.0), rel=0.01)
    np.testing.assert_allclose(blocks(within)[:2], blocks(fit), rtol=1e-2)


def judged_of(table, white):  # type: ignore[no-untyped-def]
    numbers = [("correction", -1, "mass"), ("effect", 0, "amplitude"), ("effect", 0, "phase")]
    coordinates = [
        SimpleNamespace(kind=k, effect=i, name=n, place=None, log=False) for k, i, n in numbers
    ]
    values = SimpleNamespace(parameters={"amplitude": 2.0, "phase": 1.0, "frequency": 3.0})
    model = SimpleNamespace(coordinates=coordinates, effects=(values,))
    fit = Fit(model, white, table, table, "converged")
    scene = SimpleNamespace(trials=[range(len(white))])
    return SimpleNamespace(model=model, fit=fit, scene=scene, spread=spread(fit, [len(white)]))


@pytest.mark.parametrize("alike", [0.0, 0.9])
def test_by_itself_an_effect_is_as_sure_as_beside_nobody(alike):
    """A column that nearly goes with another: its size may be anything, that it is there is sure."""
    rng, t = np.random.default_rng(5), np.arange(N) / N
    noise = scipy.signal.lfilter([1.0], [1.0, -alike], rng.standard_normal(N))
    own = np.column_stack([np.sin(2 * np.pi * 3 * t), np.cos(2 * np.pi * 3 * t)])
    twin = own[:, 0] + 0.02 * np.cos(2 * np.pi * 7 * t)
    judged = judged_of(np.column_stack([twin, own]), noise)
    apart = Fit(model_of(NUMBER, NUMBER), noise, own, own, "converged")
    alone = spread(apart, [N])
    assert own_error_of(judged, 0, "amplitude") == pytest.approx(alone[0], rel=1e-6)
    assert own_error_of(judged, 0, "phase") == pytest.approx(alone[1], rel=1e-6)
    assert error_of(judged, 0, "amplitude") > 20.0 * alone[0]
    assert own_error_of(judged, 0, "frequency") is None  # held


def test_what_no_sample_sees_has_no_error_of_its_own():
    own = np.zeros((N, 2))
    own[:, 0] = 1.0
    judged = judged_of(np.column_stack([np.linspace(0.0, 1.0, N), own]), np.ones(N))
    assert own_error_of(judged, 0, "phase") == error_of(judged, 0, "phase")


@dataclass(frozen=True)
class Sticks:
    effects: tuple[EffectSpec, ...]


@pytest.mark.parametrize(("flat", "said"), [(0.01, 0.0100001), (1e-7, 1e-5), (0.5, None)])
def test_a_number_that_acts_in_steps_is_told_by_how_far_it_may_be_moved(flat, said):
    """What is left stays as it is within a share `flat` of 2 % and is far more beyond."""

    def cost(model):  # type: ignore[no-untyped-def]
        return 100.0 if abs(model.effects[0].parameters["band"] / 2.0 - 1.0) < flat else 200.0

    judged = SimpleNamespace(
        model=Sticks((EffectSpec("valve_stiction", {"band": 2.0}),)),
        scene=SimpleNamespace(cost=cost),
        fit=SimpleNamespace(cost=100.0, white=np.zeros(100)),
    )
    found = stepped_error_of(judged, 0, "band")
    if said is None:
        assert found is None
    else:  # to the next step that was tried
        assert 2.0 * said <= found * 1.0001
        assert found < 2.0 * 2.2 * max(said, flat)

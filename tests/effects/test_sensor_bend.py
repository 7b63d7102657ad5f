"""A scale that bends, beside what else a sensor does: the written-out law, and in which order."""

import itertools

import numpy as np
import pytest

from ffl.diagnose.recorded.first_state import behind_sensor
from ffl.effects import EFFECTS
from ffl.machines import Simulator
from ffl.systems.loop import Controller
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.zpk import Zpk

STEP, LEVEL, RATIO = 4.0, 3.0, 1.8
TANKS = Zpk([-1.0], [0.94, 0.97], 0.03 * 0.06 / 2.0, STEP)
BEND = EffectSpec("sensor_bend", {"level": LEVEL, "ratio": RATIO})
EFFECT = EFFECTS["sensor_bend"]


def pump(n=300):
    t = np.arange(n)
    return np.where(t % 80 < 40, 6.0, 1.0) + np.sin(2 * np.pi * t / 29)


def bent(x, level=LEVEL, ratio=RATIO):
    return np.where(x > level, level + ratio * (x - level), x)


@pytest.mark.parametrize(("level", "ratio"), [(3.0, 1.8), (1.0, 0.4), (-1.0, 2.5)])
def test_the_law_is_as_written(level, ratio):
    simulator = Simulator(Plant("tanks", TANKS, None, "V", "V"))
    spec = EffectSpec("sensor_bend", {"level": level, "ratio": ratio})
    x = simulator.run((), None, pump()).y
    y = simulator.run([spec], None, pump()).y
    assert np.abs(x - y).max() > 0.5
    np.testing.assert_allclose(y, bent(x, level, ratio), atol=1e-12)
    np.testing.assert_allclose(y, EFFECT.shown(spec.parameters, x), atol=1e-12)


def test_a_sensor_ends_after_all_else_that_it_does_wherever_that_is_named():
    plant = Plant("tanks", TANKS, None, "V", "V")
    clip = EffectSpec("sensor_nonlinearity", {"kind": "clipping", "level": 4.0})
    ripple = EffectSpec("encoder_ripple", {"amplitude": 0.1, "period": 1.0})
    simulator = Simulator(plant)
    x = simulator.run((), None, pump()).y
    for order in itertools.permutations([clip, BEND, ripple]):
        y = simulator.run(order, None, pump()).y
        assert y.max() == 4.0
        below = y < 4.0
        expected = bent(x) + 0.1 * np.sin(2 * np.pi * x)
        # A bend may see the ripple or not, whichever was named first.
        np.testing.assert_allclose(y[below], expected[below], atol=0.1 * (RATIO - 1.0) + 1e-12)
    for order in ([clip, BEND], [BEND, clip]):
        y = simulator.run(order, None, pump()).y
        np.testing.assert_allclose(y, np.minimum(bent(x), 4.0), atol=1e-12)


def test_what_the_sensor_passes_is_the_slope_of_what_it_shows():
    x = np.linspace(-1.0, 7.0, 400)
    slope = (EFFECT.shown(BEND.parameters, x + 1e-6) - EFFECT.shown(BEND.parameters, x)) / 1e-6
    away = np.abs(x - LEVEL) > 1e-3
    np.testing.assert_allclose(EFFECT.passes(BEND.parameters, x)[away], slope[away], atol=1e-8)


@pytest.mark.parametrize("ratio", [0.6, 1.8, 2.5, 12.0])
@pytest.mark.parametrize("measured", [0.0, 2.0, 5.0])
def test_a_loop_at_rest_stands_where_its_bent_sensor_shows_what_it_should(ratio, measured):
    controller = Controller.of_error(Zpk([0.96], [1.0], 0.5, STEP))
    simulator = Simulator(Plant("tanks", TANKS, controller, "V", "V"))
    values = {"level": -0.5, "ratio": ratio}
    level = simulator.at_rest(measured)
    start = behind_sensor(simulator, level, lambda x: EFFECT.shown(values, x) - x)
    run = simulator.run([EffectSpec("sensor_bend", values)], np.full(5, measured), start=start)
    assert run.y[0] == pytest.approx(measured, abs=1e-3)


def test_the_amount_is_what_the_ratio_is_beyond_one():
    found = EFFECT.from_coefficients(np.array([0.8]), {"level": LEVEL})
    assert found == {"level": LEVEL, "ratio": 1.8}
    assert EFFECT.coefficients_of(found) == pytest.approx([0.8])
    assert EFFECT.parameter("ratio").neutral == 1.0

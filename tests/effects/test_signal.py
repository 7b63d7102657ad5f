"""What an effect of the drive adds to a command, said by its regressors, is what the kernel adds."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.effects import EFFECTS, Motion
from ffl.machines.simulator import Simulator
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.zpk import Zpk

MASS = Simulator(
    Plant("mass", Zpk(np.array([-1.0]), np.array([1.0, 1.0]), 1e-6, 1e-3)), open_loop=True
)


@pytest.mark.parametrize(
    ("name", "parameters"), [("saturation", {"limit": 0.6}), ("dead_zone", {"half_width": 0.25})]
)
def test_signal_is_what_the_kernel_adds_to_the_command(name, parameters):
    u = np.sin(np.linspace(0.0, 20.0, 500))
    spec = EffectSpec(name, parameters)
    motion = replace(Motion.still(0.0, 1e-3), u=u)
    added = MASS.run([spec], feedforward=u).contribution.sum(axis=1)
    np.testing.assert_allclose(EFFECTS[name].signal(spec, motion), added, atol=1e-12)


def test_the_signal_of_a_periodic_disturbance_is_what_the_kernel_adds():
    """Amplitude and phase are not coefficients of sine and cosine."""
    values = {"amplitude": 0.7, "frequency": 3.0, "phase": 2.0}
    spec = EffectSpec("periodic_disturbance", values)
    zero = np.zeros(700)
    added = MASS.run([spec], feedforward=zero).contribution.sum(axis=1)
    middle = 1e-3 * (np.arange(700) + 0.5)  # the kernel's is the mean over a sample
    motion = Motion(middle, zero, zero, zero, zero, zero, 1e-3)
    said = EFFECTS[spec.name].signal(spec, motion)
    newton = MASS.force_per_input
    np.testing.assert_allclose(said / newton, added, atol=1e-4 * np.abs(added).max())


@pytest.mark.parametrize("kind", ["clipping", "rectified"])
def test_what_a_sensor_passes_is_how_what_it_shows_of_a_machine_changes(kind):
    u = np.sin(np.arange(400) * 0.05) * np.linspace(0.2, 1.0, 400)
    plain, more = (MASS.run((), feedforward=f * u).y for f in (1.0, 1.0 + 1e-7))
    level = 0.6 * float(np.abs(plain).max())
    spec = EffectSpec("sensor_nonlinearity", {"kind": kind, "level": level})
    seen, after = (MASS.run((spec,), feedforward=f * u).y for f in (1.0, 1.0 + 1e-7))
    clear = np.minimum(np.abs(plain), np.abs(np.abs(plain) - level)) > 1e-3 * level
    assert np.count_nonzero(clear) > 300
    passed = EFFECTS[spec.name].passes(spec.parameters, plain)
    error = (after - seen - passed * (more - plain))[clear]
    assert np.abs(error).max() < 1e-6 * np.abs(more - plain).max()

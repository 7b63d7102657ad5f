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

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

"""Bouc and Wen's law where it hardens, against small steps of the law as the benchmark states it."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ffl.effects.paths import bouc_wen
from ffl.machines.simulator import Simulator
from ffl.systems import EffectSpec, Physics, Plant
from ffl.systems.continuous import zero_order_hold

ALPHA, BETA, GAMMA, DELTA = 5e4, 1e3, 0.8, -1.1  # N/m, 1/m, benchmark of Noel and Schoukens
FORCE = ALPHA / BETA / -(GAMMA + DELTA)
VALUES = {"force": FORCE, "displacement": FORCE / ALPHA, "exponent": 1.0}
VALUES["beta"] = GAMMA * BETA * FORCE / ALPHA
SPEC = EffectSpec("hysteresis", VALUES, {"kind": "hardening"})


def rate(v, z):
    return ALPHA * v - BETA * (GAMMA * abs(v) * z + DELTA * v * abs(z))


@pytest.mark.parametrize("exponent", [1.0, 1.0 + 1e-9])
def test_along_a_path(exponent):
    t = np.linspace(0.0, 3.0, 2001)
    x = 1e-3 * np.sin(2 * np.pi * t) * (1 + 0.5 * t)
    z = np.zeros(len(x))
    for k in range(1, len(x)):
        z[k] = z[k - 1]
        for _ in range(20):
            half = z[k] + 0.5 * rate(0.05 * (x[k] - x[k - 1]), z[k])
            z[k] += rate(0.05 * (x[k] - x[k - 1]), half)
    own = FORCE * bouc_wen(x, VALUES["displacement"], exponent, VALUES["beta"], True)
    assert np.abs(own - z).max() < 1e-4 * np.ptp(z)


def test_in_the_simulator():
    mass, damping, spring, step = 2.0, 10.0, 5e4, 1e-3
    root = np.sqrt(complex(damping**2 / 4 - mass * spring)) / mass
    poles = [-damping / 2 / mass + root, -damping / 2 / mass - root]
    system = zero_order_hold([], poles, 1 / mass, step)
    plant = Plant("bw", system, None, "N", "m", physics=Physics(mass, 1.0))
    u = 60.0 * np.sin(2 * np.pi * 31.0 * step * np.arange(400))
    run = Simulator(plant).run((SPEC,), np.zeros(400), u)

    def law(t, s):
        push = u[min(int(t / step + 1e-9), 399)] - damping * s[1] - spring * s[0] - s[2]
        return [s[1], push / mass, rate(s[1], s[2])]

    fine = [np.zeros(3)]
    for k in range(399):
        part = solve_ivp(law, (k * step, (k + 1) * step - 1e-12), fine[-1], rtol=1e-8, atol=1e-12)
        fine.append(part.y[:, -1])
    y = np.array(fine)[:, 0]
    assert np.abs(run.y - y).max() < 0.01 * np.abs(y).max()

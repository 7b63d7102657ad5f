"""Bouc and Wen's law where it hardens, against small steps of the law as the benchmark states it."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ffl.effects import EFFECTS
from ffl.effects.motion import Extent
from ffl.effects.paths import RUNAWAY, bouc_wen, bouc_wen_step
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


@pytest.mark.parametrize(("start", "move"), [(-50.0, 0.3), (0.0, 1.1), (2.0, -0.6), (-0.5, 0.9)])
def test_far_out_and_back_at_any_rate(start, move):
    """dz/dx = 1 + |z|^n ((1 + beta) - beta sign(z dx)) at n = 1.57, beta = 9.5: 19 times as stiff on the
    way back, over which steps of a fixed length jumped from one end to the other."""
    n, beta = 1.57, 9.5

    def slope(x, z):
        return 1.0 + np.abs(z) ** n * (1 + beta - beta * np.sign(z * move))

    true = solve_ivp(slope, (0.0, move), [start], rtol=1e-10, atol=1e-12).y[0, -1]
    own = bouc_wen_step(start, move, 1.0, n, beta, 1.0)
    assert own == pytest.approx(true, rel=4e-3, abs=4e-3)


def test_what_leaves_all_bounds_is_followed_to_their_end():
    assert bouc_wen_step(0.0, 30.0, 1.0, 1.57, 0.5, 1.0) == RUNAWAY
    assert bouc_wen_step(0.0, -30.0, 1.0, 1.57, 0.5, 1.0) == -RUNAWAY


def test_a_path_before_the_recording_winds_it_up_by_its_own_length_at_most():
    """Six strokes of what hardens without end began a recording at a million times its force."""
    effect = EFFECTS["hysteresis"]
    packed = [FORCE, VALUES["displacement"], 1.5, 9.0, 1.0]
    far, near = (effect.after_travel([0.0, 0.0], packed, k * packed[1])[0] for k in (60.0, 1.0))
    assert far == near
    assert 1.0 < near < 3.0


def test_what_no_travel_turns_around_is_no_loop():
    wide = EffectSpec("hysteresis", {"force": 1.0, "displacement": 2.0})
    effect = EFFECTS["hysteresis"]
    assert not effect.credible(wide, Extent(5.0, 1.5))
    assert effect.credible(wide, Extent(5.0, 2.5))
    assert effect.credible(
        EffectSpec(wide.name, wide.parameters, {"kind": "hardening"}), Extent(5.0, 1.5)
    )

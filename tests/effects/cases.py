"""Every effect on a rigid stage: parameters, the same physics for the oracle, and the error allowed.

`bound` is the largest error of y relative to what the effect does to y, with one step per sample;
measured values are about half of it.
"""

from __future__ import annotations

import numpy as np
from oracle import MASS, SAMPLE_TIME, Case

from ffl.effects.slip import WEIGHTS, YIELDS
from ffl.systems.loop import Controller
from ffl.systems.plant import Plant
from ffl.systems.references import Move, moves
from ffl.systems.zpk import Zpk

TURN = 2 * np.pi
GRID, UP, DOWN = [-0.02, 0.0, 0.02], [3.0, 5.0, 4.0], [4.0, 2.0, 6.0]

STAGE = Plant(
    "stage",
    Zpk([-1.0], [1.0, 1.0], SAMPLE_TIME**2 / (2 * MASS), SAMPLE_TIME),
    Controller.of_error(Zpk([0.98], [0.8], 4000.0, SAMPLE_TIME)),
    "N",
    "m",
)


def reference() -> np.ndarray:
    """Forth and back with standstill between."""
    there, back = Move(0.02, 0.02, 0.2, 5.0, 500.0), Move(0.25, -0.03, 0.2, 5.0, 500.0)
    return moves([there, back], 0.5, SAMPLE_TIME)


def stuck(band):
    stem = [0.0]

    def drive(u, x, z):
        if x == 0.0:  # a run begins
            stem[0] = 0.0
        stem[0] = u if abs(u - stem[0]) > band else stem[0]
        return stem[0]

    return drive


def play(gap):
    def sense(x, memory):
        y = memory.get("y", x)
        memory["y"] = min(max(y, x - gap / 2), x + gap / 2)
        return memory["y"]

    return Case(sense=sense, turn=sense)


def bristle(level, stiffness, micro_damping):
    def rate(x, v, z):
        return [v - abs(v) * z[0] * stiffness / level]

    def force(t, x, v, z):
        return -(stiffness * z[0] + micro_damping * rate(x, v, z)[0])

    return Case(force=force, rate=rate, states=1)


def slip(level, stiffness, micro_damping):
    """Elements that slide one after the other: dz_i/dt = v within their limits."""
    limits = YIELDS * level / stiffness

    def rate(x, v, z):
        return np.where((np.abs(z) < limits) | (z * v < 0), v, 0.0)

    def force(t, x, v, z):
        held = np.clip(z, -limits, limits)
        return -float(WEIGHTS @ (stiffness * held + micro_damping * rate(x, v, z)))

    return Case(force=force, rate=rate, states=len(limits))


def wen(force, displacement, exponent, beta):
    def rate(x, v, z):
        return [
            v / displacement
            * (1 - abs(z[0]) ** exponent * ((1 - beta) + beta * np.sign(v * z[0])))
        ]  # fmt: skip

    return Case(force=lambda t, x, v, z: -force * z[0], rate=rate, states=1)


ORACLE = {
    "coulomb_friction": (
        {"level": 5.0},
        Case(levels=lambda x, v: (5.0, 5.0)),
        1e-12,
    ),
    "asymmetric_friction": (
        {"level_positive": 5.0, "level_negative": 3.0},
        Case(levels=lambda x, v: (5.0, 3.0)),
        1e-12,
    ),
    "viscous_friction": (
        {"coefficient": 20.0},
        Case(force=lambda t, x, v, z: -20.0 * v),
        1e-12,
    ),
    "stribeck_friction": (
        {"coulomb_level": 4.0, "static_level": 6.0, "stribeck_velocity": 0.02},
        Case(levels=lambda x, v: (4 + 2 * np.exp(-((v / 0.02) ** 2)),) * 2),
        2e-5,
    ),
    "presliding_friction": (
        {"level": 5.0, "stiffness": 2e5, "micro_damping": 100.0},
        bristle(5.0, 2e5, 100.0),
        1e-5,
    ),
    "position_dependent_friction": (
        {"table": {"grid": GRID, "positive": UP, "negative": DOWN}},
        Case(levels=lambda x, v: (np.interp(x, GRID, UP), np.interp(x, GRID, DOWN))),
        3e-5,
    ),
    "logarithmic_friction": (
        {"level": 2.0, "velocity": 0.01},
        Case(force=lambda t, x, v, z: -2.0 * np.arcsinh(v / 0.01)),
        2e-9,
    ),
    "constant_load": ({"force": -3.0}, Case(force=lambda t, x, v, z: -3.0), 1e-12),
    "cogging": (
        {"amplitude": 3.0, "period": 0.005, "phase": 0.3, "amplitude_2": 0.5, "phase_2": 0.1},
        Case(
            force=lambda t, x, v, z: (
                3 * np.sin(TURN * x / 0.005 + 0.3) + 0.5 * np.sin(2 * TURN * x / 0.005 + 0.1)
            )
        ),
        1e-6,
    ),
    "linear_stiffness": (
        {"stiffness": 1000.0, "centre": 0.01},
        Case(force=lambda t, x, v, z: -1000.0 * (x - 0.01)),
        1e-12,
    ),
    "hardening_spring": (
        {"cubic_coefficient": 1e6, "centre": 0.001},
        Case(force=lambda t, x, v, z: -1e6 * (x - 0.001) ** 3),
        2e-9,
    ),
    "preloaded_spring": (
        {"preload": 5.0, "centre": 0.004, "width": 2e-4},
        Case(force=lambda t, x, v, z: -5.0 * min(max((x - 0.004) / 2e-4, -1.0), 1.0)),
        6e-6,
    ),
    "gravity_torque": (
        {"amplitude": 200.0, "centre": -20.0, "turn": 360.0},
        Case(force=lambda t, x, v, z: -200.0 * np.sin(np.deg2rad(x + 20.0))),
        2e-9,
    ),
    "position_dependent_gain": (
        {"linear_coefficient": 10.0, "quadratic_coefficient": -100.0, "centre": 0.01},
        Case(drive=lambda u, x, z: u * (1 + 10 * (x - 0.01) - 100 * (x - 0.01) ** 2)),
        5e-5,
    ),
    "quadratic_drag": (
        {"coefficient": 50.0},
        Case(force=lambda t, x, v, z: -50 * v * abs(v)),
        2e-8,
    ),
    "backlash": ({"gap": 1e-4}, play(1e-4), 1e-11),
    "hysteresis": (
        {"force": 5.0, "displacement": 1e-3, "exponent": 1.5, "beta": 0.4},
        wen(5.0, 1e-3, 1.5, 0.4),
        3e-5,
    ),
    "saturation": ({"limit": 6.0}, Case(drive=lambda u, x, z: min(max(u, -6.0), 6.0)), 1e-11),
    "dead_zone": (
        {"half_width": 1.0},
        Case(drive=lambda u, x, z: np.sign(u) * max(abs(u) - 1.0, 0.0)),
        1e-12,
    ),
    "slew_limit": (
        {"rate": 400.0},
        Case(
            drive=lambda u, x, z: z[0],
            drive_rate=lambda u, z: [min(max(1e6 * (u - z[0]), -400.0), 400.0)],
            states=1,
            method="LSODA",
        ),
        1e-3,
    ),
    "valve_stiction": ({"band": 0.7}, Case(drive=stuck(0.7)), 1e-11),
    "input_delay": ({"delay": 1.3e-3}, Case(split=0.3, late=1), 1e-11),
    "actuator_lag": (
        {"time_constant": 2e-3},
        Case(drive=lambda u, x, z: z[0], drive_rate=lambda u, z: [(u - z[0]) / 2e-3], states=1),
        1e-11,
    ),
    "encoder_ripple": (
        {"amplitude": 1e-5, "period": 0.004, "phase": 1.0},
        Case(sense=lambda x, memory: x + 1e-5 * np.sin(TURN * x / 0.004 + 1.0)),
        1e-10,
    ),
    "sensor_nonlinearity": (
        {"kind": "clipping", "level": 0.01},
        Case(sense=lambda x, memory: min(max(x, -0.01), 0.01)),
        1e-12,
    ),
    "sensor_lead": (
        {"lead": 8e-5},
        Case(sense=lambda x, memory: x + 8e-5 * memory["v"]),
        1e-11,
    ),
    "sensor_bend": (
        {"level": 0.012, "ratio": 1.9},
        Case(sense=lambda x, memory: x if x < 0.012 else 0.012 + 1.9 * (x - 0.012)),
        1e-11,
    ),
    "periodic_disturbance": (
        {"amplitude": 2.0, "frequency": 37.0, "phase": 0.4},
        Case(force=lambda t, x, v, z: 2 * np.sin(TURN * 37 * t + 0.4)),
        3e-6,
    ),
    "drift": (
        {"amplitude": 3.0, "time_constant": 0.2},
        Case(force=lambda t, x, v, z: 3 * (1 - np.exp(-t / 0.2))),
        1e-10,
    ),
}

# Effects of the linear part that the one-mass oracle cannot state; see test_two_masses.py.
LINEAR = {
    "flexible_mode": {"frequency": 60.0, "damping": 0.02, "mass_fraction": 0.2},
    "mass_change": {"change": 0.1},
}
# Effects between and after lags in a row; see test_cascade.py.
FLOW = ("outflow", "overflow", "spill")
PARAMETERS = {name: case[0] for name, case in ORACLE.items()} | LINEAR

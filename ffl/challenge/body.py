"""Machines of the challenge as mass, damping and stiffness matrices in continuous time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg


@dataclass(frozen=True)
class Body:
    """M q'' + D q' + K q = motor * constant * u, y = gauge q + gauge_rate q'.

    `motor` is at once the direction in which the actuator pushes and the map from q to the
    position of its point; `load` is the same for the far end.
    """

    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    motor: np.ndarray
    load: np.ndarray
    gauge: np.ndarray
    gauge_rate: np.ndarray
    constant: float
    moving_mass: float


Vector = Sequence[float] | np.ndarray


def _body(
    mass: float | np.ndarray,
    damping: float | np.ndarray,
    stiffness: float | np.ndarray,
    motor: Vector,
    load: Vector,
    gauge: Vector,
    constant: float,
    moving: float,
    gauge_rate: np.ndarray | None = None,
) -> Body:
    n = len(motor)
    m, d, k = (np.array(a, float).reshape(n, n) for a in (mass, damping, stiffness))
    rate = np.zeros(n) if gauge_rate is None else gauge_rate
    pushed, far, seen, seen_rate = (np.array(a, float) for a in (motor, load, gauge, rate))
    return Body(m, d, k, pushed, far, seen, seen_rate, float(constant), float(moving))


def rigid(p: dict) -> Body:
    """One mass on a guide with viscous friction."""
    return _body(p["mass"], p["viscous"], 0.0, [1], [1], [1], p["constant"], p["mass"])


def stiffness_driven(p: dict) -> Body:
    """A stage on a flexure: one mass, one spring, no feedback."""
    w = 2 * np.pi * p["frequency"]
    m = p["mass"]
    return _body(m, 2 * p["zeta"] * w * m, m * w**2, [1], [1], [1], p["constant"], m)


def _two_mass(p: dict, gauge: list[int]) -> Body:
    m1, m2 = p["mass"] * p["share"], p["mass"] * (1 - p["share"])
    reduced = m1 * m2 / p["mass"]
    w = 2 * np.pi * p["resonance"]
    pull = np.array([[1.0, -1.0], [-1.0, 1.0]])
    damping = 2 * p["zeta"] * w * reduced * pull + np.diag([p["viscous"], 0.0])
    stiffness = w**2 * reduced * pull
    mass = np.diag([m1, m2])
    return _body(mass, damping, stiffness, [1, 0], [0, 1], gauge, p["constant"], p["mass"])


def two_mass_motor(p: dict) -> Body:
    """Motor and load joined by a spring, measured at the motor (collocated)."""
    return _two_mass(p, [1, 0])


def two_mass_load(p: dict) -> Body:
    """Motor and load joined by a spring, measured at the load (non-collocated)."""
    return _two_mass(p, [0, 1])


def printer(p: dict) -> Body:
    """Gantry driven at one end and measured at the other: rigid body and three modes.

    Modal masses equal the moving mass; the modes' shapes at the sensor have the gains g1 to g3 of
    which the first is negative. With 9 and 14 Hz, -0.77 and 4.37 the transfer has a quadruple of
    complex zeros at 7.3 Hz, two of them in the right half plane (flatbed printer, figure 2).
    """
    m = p["mass"]
    w = 2 * np.pi * np.array([p["f1"], p["f2"], p["f3"]])
    zeta = np.array([p["z1"], p["z2"], p["z3"]])
    damping = np.diag([p["viscous"], *(2 * zeta * w * m)])
    stiffness = np.diag([0.0, *(w**2 * m)])
    gauge = [1, p["g1"], p["g2"], p["g3"]]
    mass = m * np.eye(4)
    return _body(mass, damping, stiffness, np.ones(4), gauge, gauge, p["constant"], m)


# G and C of the 2018 kernel paper, section 6, as printed.
KERNEL_2018 = {
    "zeros": (*np.roots([1, -1.963, 0.9704]), *np.roots([1, -2.007, 1.041])),
    "poles": (1.0, 1.0, *np.roots([1, -1.927, 0.9418]), *np.roots([1, -1.893, 0.9418])),
    "gain": 4.0564e-4,
}
CONTROLLER_2018 = ((0.9834,), (0.8597,), 59.073)


def kernel2018(p: dict) -> Body:
    """G of the 2018 kernel paper in continuous time: the body whose zero-order hold it is.

    Residues of the step response: G(z) z/(z-1) belongs to the sampled step response of
    a0/s^2 + a1/s + sum (b0 + b1 s)/(s^2 + ...), fitted exactly (as many unknowns as residues).
    """
    poles = np.array(KERNEL_2018["poles"])
    step = p["sample_time"]
    modes = [np.log(poles[2]) / step, np.log(poles[4]) / step]
    n = 40
    z = np.exp(1j * np.linspace(0.02, 3.0, n))
    target = KERNEL_2018["gain"] * np.prod(z[:, None] - np.array(KERNEL_2018["zeros"]), axis=1)
    target = target / np.prod(z[:, None] - poles, axis=1)
    columns = [step**2 * (z + 1) / (2 * (z - 1) ** 2), step / (z - 1)]
    for s in modes:
        w2, d2 = abs(s) ** 2, -2 * s.real
        a = np.array([[0.0, 1.0], [-w2, -d2]])
        big = np.zeros((3, 3))
        big[:2, :2], big[1, 2] = a, 1.0
        e = scipy.linalg.expm(big * step)
        x = np.array([np.linalg.solve(zz * np.eye(2) - e[:2, :2], e[:2, 2]) for zz in z])
        columns += [x[:, 0], x[:, 1]]
    matrix = np.array(columns).T
    scale = np.linalg.norm(matrix, axis=0)
    stacked = np.vstack([matrix.real, matrix.imag]) / scale
    c = np.linalg.lstsq(stacked, np.r_[target.real, target.imag], rcond=None)[0] / scale
    m = p["mass"] / c[0]
    gauge = np.array([1.0, c[2] / c[0], c[4] / c[0]])
    rate = np.array([c[1] / c[0], c[3] / c[0], c[5] / c[0]])
    f = np.array([p["f1"], p["f2"]])
    w = np.array([abs(s) for s in modes]) * f
    d = np.array([-2 * s.real for s in modes]) * f
    return _body(
        m * np.eye(3),
        m * np.diag([p["viscous"], *d]),
        m * np.diag([0.0, *(w**2)]),
        np.ones(3),
        np.ones(3),
        gauge,
        p["constant"],
        m,
        rate,
    )


@dataclass(frozen=True)
class Family:
    """How machines of one kind are drawn: ranges of the true parameters and of the motion."""

    assemble: Callable[[dict], Body]
    ranges: dict[str, tuple[float, float]]
    stroke: tuple[float, float]
    speed: tuple[float, float]
    acceleration: tuple[float, float]
    bandwidth: tuple[float, float]  # Hz; (0, 0): open loop
    resolution: tuple[float, float]
    sample_times: tuple[float, ...] = (0.0005, 0.001, 0.001, 0.001, 0.002)
    # parameters a careful engineer has slightly wrong: name -> relative standard deviation
    doubts: tuple[tuple[str, float], ...] = ()


_MOTION = {
    "stroke": (0.06, 0.3),
    "speed": (0.1, 0.5),
    "acceleration": (2.0, 12.0),
    "resolution": (1e-7, 2e-6),
}
_MASSES = {"mass": (3.0, 20.0), "constant": (5.0, 40.0)}
_TWO = {
    **_MASSES,
    "share": (0.3, 0.7),
    "resonance": (30.0, 80.0),
    "zeta": (0.01, 0.05),
    "damping_time": (0.4, 2.0),
}

FAMILIES: dict[str, Family] = {
    "rigid": Family(
        rigid,
        {**_MASSES, "damping_time": (0.4, 2.0)},
        **_MOTION,
        bandwidth=(8.0, 25.0),
        doubts=(("mass", 0.003), ("viscous", 0.05)),
    ),
    "two_mass_motor": Family(
        two_mass_motor,
        _TWO,
        **_MOTION,
        bandwidth=(8.0, 20.0),
        doubts=(("mass", 0.003), ("viscous", 0.05), ("resonance", 0.004), ("zeta", 0.15)),
    ),
    "two_mass_load": Family(
        two_mass_load,
        _TWO,
        **_MOTION,
        bandwidth=(5.0, 12.0),
        doubts=(("mass", 0.003), ("viscous", 0.05), ("resonance", 0.004), ("zeta", 0.15)),
    ),
    "printer": Family(
        printer,
        {
            "mass": (8.0, 15.0),
            "constant": (5.0, 30.0),
            "damping_time": (0.8, 3.0),
            "f1": (8.9, 9.1),
            "z1": (0.02, 0.05),
            "g1": (-0.79, -0.75),
            "f2": (13.8, 14.2),
            "z2": (0.02, 0.05),
            "g2": (4.2, 4.5),
            "f3": (55.0, 70.0),
            "z3": (0.01, 0.03),
            "g3": (-0.6, 0.6),
        },
        stroke=(0.1, 0.25),
        speed=(0.1, 0.3),
        acceleration=(1.0, 3.0),
        bandwidth=(1.5, 2.5),
        resolution=(5e-7, 2e-6),
        sample_times=(0.001,),
        doubts=(("mass", 0.003), ("viscous", 0.05), ("f1", 0.003), ("f2", 0.003), ("z2", 0.1)),
    ),
    "stiffness": Family(
        stiffness_driven,
        {
            "mass": (0.5, 4.0),
            "constant": (2.0, 20.0),
            "frequency": (15.0, 50.0),
            "zeta": (0.02, 0.08),
        },
        stroke=(0.0005, 0.003),
        speed=(0.005, 0.03),
        acceleration=(0.1, 1.0),
        bandwidth=(0.0, 0.0),
        resolution=(2e-9, 2e-8),
        doubts=(("mass", 0.003), ("frequency", 0.002), ("zeta", 0.1)),
    ),
    "kernel2018": Family(
        kernel2018,
        {"mass": (1.0, 1.0), "f1": (1.0, 1.0), "f2": (1.0, 1.0), "constant": (1.0, 1.0)},
        stroke=(0.1, 0.3),
        speed=(0.2, 0.5),
        acceleration=(2.0, 10.0),
        bandwidth=(1.0, 1.0),
        resolution=(1e-7, 2e-6),
        sample_times=(0.001,),
        doubts=(("mass", 0.003), ("f1", 0.003), ("f2", 0.003)),
    ),
}

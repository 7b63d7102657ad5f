"""Two masses on a spring, read off a plant's transfer function.

The modal picture takes the modes for classically damped. A guide that rubs on the motor alone is
not, and the points of the modal picture are then off by damping over resonance (measured: 1e-3 of
what friction does to y). For two masses measured at the motor, seven numbers of the transfer
function are the seven numbers of the machine, so nothing need be assumed:

    y/u = (m2 s^2 + (c + d2) s + k) / ((m1 s^2 + (c + d1) s + k) (m2 s^2 + (c + d2) s + k) - (c s + k)^2)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from ffl.effects.point import Point
from ffl.systems.state_space import Array


@dataclass(frozen=True)
class TwoMasses:
    """Points of motor and load, and the spring between them, in input units."""

    motor: Point
    load: Point
    sensor: Point
    stiffness: float
    damping: float


def collocated(a: Array, b: Array, c: Array) -> TwoMasses | None:
    """The two-mass machine with transfer c (sI - a)^-1 b, b driving and c reading one point.

    None where the plant is no such machine: not four states, not free to move, not collocated, or
    masses, spring and damper that are not all positive (the damper may be zero).
    """
    if len(a) != 4 or not (mobility := float(c @ a @ b)) > 0:
        return None
    poles = np.linalg.eigvals(a)
    fastest = np.abs(poles).max()
    if abs(c @ b) * fastest > 1e-6 * mobility or np.abs(poles).min() > 1e-6 * fastest:
        return None
    moving = np.delete(poles, np.argmin(np.abs(poles)))
    d3, d2, d1 = -moving.sum().real, _pairs(moving).real, -np.prod(moving).real
    # s^2 + p s + q, the zeros: the load alone on its spring. From Markov parameters, not roots.
    m1 = 1.0 / mobility
    third, fourth = m1 * float(c @ a @ a @ b), m1 * float(c @ a @ a @ a @ b)
    p = third + d3
    q = fourth + d3 * third + d2
    if not q > 0:
        return None
    e2, e1 = d2 - q - p * (d3 - p), d1 - q * (d3 - p)
    e = e1 * m1 / q
    # c = (p m2 - e)/2 and q m2^2 - c^2 = e2 m1 m2, a quadratic equation for m2.
    square, line, rest = q - p * p / 4, p * e / 2 - e2 * m1, -e * e / 4
    root = line * line - 4 * square * rest
    if not (square > 0 and root >= 0):
        return None
    m2 = (-line + np.sqrt(root)) / (2 * square)
    damper, spring = (p * m2 - e) / 2, q * m2
    if not (m2 > 0 and damper > -1e-9 * p * m2):
        return None
    own, guide = p * m2 - damper, m1 * (d3 - p) - damper
    physical = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-spring / m1, -(damper + guide) / m1, spring / m1, damper / m1],
            [0.0, 0.0, 0.0, 1.0],
            [spring / m2, damper / m2, -spring / m2, -(damper + own) / m2],
        ]
    )
    seen = np.array([1.0, 0.0, 0.0, 0.0])
    steps = fastest ** -np.arange(4.0)  # balances the rows c, ca, ca^2, ca^3
    ours = np.array([c @ np.linalg.matrix_power(a, k) for k in range(4)]) * steps[:, None]
    theirs = np.array([seen @ np.linalg.matrix_power(physical, k) for k in range(4)])
    theirs *= steps[:, None]
    rows = scipy.linalg.solve(theirs, ours)  # physical states from the plant's
    columns = scipy.linalg.solve(ours, theirs)
    if np.abs(rows @ b - np.array([0, 1 / m1, 0, 0])).max() > 1e-5 / m1:
        return None
    motor = Point(columns[:, 1] / m1, rows[0], rows[1])
    load = Point(columns[:, 3] / m2, rows[2], rows[3])
    return TwoMasses(motor, load, motor, float(spring), float(max(damper, 0.0)))


def across(a: Array, b: Array, c: Array, mass_ratio: float) -> TwoMasses | None:
    """The two-mass machine that b drives at one end and c reads at the other, for a mass ratio
    (load over motor).

    In every mode phi(load)/phi(motor) = (c s + k)/(m2 s^2 + c s + k) at its pole s, so this function
    of the state matrix turns what is known at one end into the other. None where the plant is no
    such machine.
    """
    if len(a) != 4:
        return None
    poles = np.linalg.eigvals(a)
    fastest = np.abs(poles).max()
    top = float(c @ a @ a @ b)  # c/(m1 m2)
    moving = np.delete(poles, np.argmin(np.abs(poles)))
    d3, d2, d1 = -moving.sum().real, _pairs(moving).real, -np.prod(moving).real
    tail = float(c @ a @ a @ a @ b) + d3 * top  # k/(m1 m2)
    if not tail > 0 or np.abs(poles).min() > 1e-6 * fastest or top * fastest < -1e-6 * tail:
        return None
    scale = tail / fastest**2
    if max(abs(c @ b) * fastest, abs(c @ a @ b)) > 1e-6 * scale:
        return None
    mass = (d2 - top * d1 / tail) / tail
    if not mass > 0:
        return None
    m1, m2 = mass / (1.0 + mass_ratio), mass * mass_ratio / (1.0 + mass_ratio)
    spring, damper = tail * m1 * m2, max(top, 0.0) * m1 * m2
    ends = damper * a + spring * np.eye(4)
    turn = np.linalg.solve(m2 * a @ a + ends, ends)
    position = np.linalg.solve(turn.T, c)
    load = Point(turn @ b, c, c @ a)
    return TwoMasses(Point(b, position, position @ a), load, load, float(spring), float(damper))


def _pairs(roots: np.ndarray) -> complex:
    """Sum of the products of two of three roots."""
    return complex(roots[0] * roots[1] + roots[0] * roots[2] + roots[1] * roots[2])

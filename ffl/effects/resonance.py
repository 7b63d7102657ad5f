"""A part on a spring and the pole it makes of the machine that it hangs on.

With s the pole, m the part's mass and G(s) the receptance of the machine at the point that the part hangs
at (position per force there, without the part), spring and damper follow from

    k + c s = -1/(1/(m s^2) + G(s)),

one complex equation for two real numbers: one spring and one damper for each pole, if any.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from ffl.effects.point import Point
from ffl.errors import InputError
from ffl.systems.state_space import Array

ROUNDING = 1e-9  # of |k + c s|: a damper that is less negative is none
RINGS = 1e-3  # of a pole: its imaginary part where it is no pair that rounding took apart
AT_REST = 1e-5  # of the fastest pole: a body that is free to move has slower ones by rounding alone


def pole_of(frequency: float, damping: float) -> complex:
    """The pole in the upper half plane, rad/s, of a resonance at `frequency` Hz with `damping`."""
    pulsation = 2.0 * np.pi * frequency
    return complex(-damping * pulsation, pulsation * np.sqrt(max(1.0 - damping**2, 0.0)))


def spring_for(a: Array, point: Point, mass: float, pole: complex) -> tuple[float, float]:
    """(stiffness, damper) between `point` of x' = a x and the part of `mass` that make `pole` one of the
    whole; `InputError` where none do: beside a mode of its own no part takes a machine to any frequency."""
    if not pole.imag > 0.0:
        raise InputError("a resonance has a damping below 1; lower it")
    receptance = point.position @ np.linalg.solve(pole * np.eye(len(a)) - a, point.force)
    whole = -1.0 / (1.0 / (mass * pole**2) + receptance)
    damper = whole.imag / pole.imag
    stiffness = whole.real - damper * pole.real
    if not stiffness > 0.0 or damper * abs(pole) < -ROUNDING * abs(whole):
        raise InputError(
            f"no spring and damper make this machine resonate at {abs(pole) / (2 * np.pi):.4g} Hz with a "
            f"damping of {-pole.real / abs(pole):.2g}: move the frequency away from the machine's own "
            'modes, or take resonance = "nearby"'
        )
    return float(stiffness), max(float(damper), 0.0)


def resonance_of(a: Array, spring: Point) -> tuple[float, float] | None:
    """(frequency in Hz, damping) of the pole of x' = a x that hangs most on `spring`: of its eigenvectors v
    and w, ds/dk = -(w'b)(c v)/(w'v), and |2 (k/s) ds/dk| is the spring's share of what the mode stores in
    all springs. None where no pole oscillates."""
    poles, left, right = scipy.linalg.eig(a, left=True, right=True)
    moves = (left.conj().T @ spring.force) * (spring.position @ right)
    moves /= np.maximum(np.abs(np.sum(left.conj() * right, axis=0)), 1e-300)
    size = np.abs(poles)
    rings = (poles.imag > RINGS * size) & (size > AT_REST * size.max())
    shares = np.where(rings, np.abs(moves) / np.maximum(size, 1e-300), 0.0)
    best = int(np.argmax(shares))
    if not shares[best] > 0.0:
        return None
    pole = poles[best]
    return float(abs(pole) / (2.0 * np.pi)), float(-pole.real / abs(pole))

"""Orthonormal chains of all-pass sections: impulse responses of (8) and their exact derivatives.

Every section is an orthogonal matrix [state+; output] = O [state; input] (normalised lattice), so
the states of a chain driven by an impulse are the Takenaka-Malmquist functions of its poles:
orthonormal however close the poles lie, real for complex pairs, smooth where a pair turns real.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from ffl.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RealPole:
    """One pole p = tanh(value): positive or negative, always inside the disc."""

    value: float

    @classmethod
    def at(cls, pole: float) -> RealPole:
        return cls(float(np.arctanh(pole)))

    @property
    def coordinates(self) -> tuple[float, ...]:
        return (self.value,)

    @property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """|p| below 1 - 1e-6."""
        return ((-7.2, 7.2),)

    @property
    def poles(self) -> NDArray[np.complex128]:
        return np.array([np.tanh(self.value)], complex)

    def lattice(self) -> tuple[Array, Array]:
        """Orthogonal (2, 2) matrix and its derivative (1, 2, 2)."""
        p, s = np.tanh(self.value), 1.0 / np.cosh(self.value)
        return np.array([[p, s], [s, -p]]), s * np.array([[[s, -p], [-p, -s]]])


@dataclass(frozen=True)
class PolePair:
    """Poles exp(s) of s^2 + 2 d s + w = 0: d = exp(log_damping), w = exp(log_stiffness).

    A complex pair where w > d^2, two positive real poles elsewhere; smooth in between. In units of
    the sample: the undamped frequency is sqrt(w) rad/sample.
    """

    log_damping: float
    log_stiffness: float

    @classmethod
    def at(cls, pole: complex) -> PolePair:
        s = np.log(complex(pole))
        return cls(float(np.log(-s.real)), float(np.log(abs(s) ** 2)))

    @property
    def coordinates(self) -> tuple[float, ...]:
        return (self.log_damping, self.log_stiffness)

    @property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Decay per sample 1e-6 .. 2, undamped frequency 1e-4 .. 3 rad/sample."""
        return ((-13.8, 0.7), (-18.4, 2.2))

    @property
    def poles(self) -> NDArray[np.complex128]:
        d, w = np.exp(self.log_damping), np.exp(self.log_stiffness)
        root = np.sqrt(complex(d * d - w))
        return np.exp(np.array([-d + root, -d - root]))

    def lattice(self) -> tuple[Array, Array]:
        """Orthogonal (3, 3) matrix and its derivatives (2, 3, 3) by log_damping, log_stiffness."""
        d, w = np.exp(self.log_damping), np.exp(self.log_stiffness)
        x = d * d - w
        c, s = _cosh_sinhc(x)
        # Reflection coefficients of z^2 + k1 (1 + k2) z + k2 and their complements, written so that
        # nothing cancels for slow poles, where |k1| is within 1e-6 of one.
        k1, k2 = -c / np.cosh(d), np.exp(-2.0 * d)
        c1 = np.sqrt(max(np.sinh(d) ** 2 - x * s * s, 1e-300)) / np.cosh(d)
        c2 = np.sqrt(-np.expm1(-4.0 * d))
        matrix = _pair_matrix(k1, k2, c1, c2)
        slopes = []
        for dd, dx in ((d, 2.0 * d * d), (0.0, -w)):
            dk1 = -0.5 * s * dx / np.cosh(d) - k1 * np.tanh(d) * dd
            dk2 = -2.0 * k2 * dd
            slopes.append(_pair_slope(k1, k2, c1, c2, dk1, dk2))
        return matrix, np.array(slopes)


Section = RealPole | PolePair


def _cosh_sinhc(x: float) -> tuple[float, float]:
    """cosh(sqrt x) and sinh(sqrt x)/sqrt x, entire functions of x."""
    if abs(x) < 1e-6:
        return 1.0 + x / 2.0 + x * x / 24.0, 1.0 + x / 6.0 + x * x / 120.0
    root = np.sqrt(abs(x))
    return (np.cosh(root), np.sinh(root) / root) if x > 0 else (np.cos(root), np.sin(root) / root)


def _pair_matrix(k1: float, k2: float, c1: float, c2: float) -> Array:
    return np.array([[-k1, -c1 * k2, c1 * c2], [c1, -k1 * k2, k1 * c2], [0.0, c2, k2]])


def _pair_slope(k1: float, k2: float, c1: float, c2: float, dk1: float, dk2: float) -> Array:
    dc1, dc2 = -k1 * dk1 / c1, -k2 * dk2 / c2
    return np.array(
        [
            [-dk1, -dc1 * k2 - c1 * dk2, dc1 * c2 + c1 * dc2],
            [dc1, -dk1 * k2 - k1 * dk2, dk1 * c2 + k1 * dc2],
            [0.0, dc2, dk2],
        ]
    )


def sections_of(poles: ArrayLike) -> tuple[Section, ...]:
    """Sections for `poles` inside the disc; both members of a complex pair are given."""
    chain: list[Section] = []
    for pole in np.atleast_1d(np.asarray(poles, complex)):
        if not abs(pole) < 1.0:
            raise InputError(
                f"pole {pole.real:g}{pole.imag:+g}i is not inside the unit circle; "
                "give poles outside as `outside`"
            )
        if pole.imag > 0:
            chain.append(PolePair.at(pole))
        elif pole.imag == 0:
            chain.append(RealPole.at(pole.real))
    n_given, n_made = len(np.atleast_1d(poles)), sum(len(s.poles) for s in chain)
    if n_given != n_made:
        raise InputError(
            f"{n_given} poles make {n_made} with their conjugates; write pairs in full"
        )
    return tuple(chain)


@njit(cache=True)
def _run_chain(matrices, sizes, slopes, owner, n_samples):  # type: ignore[no-untyped-def]
    """States of the chain after an impulse, and their tangents by each coordinate."""
    n_sections, n_coordinates = len(sizes), len(owner)
    n_states = sizes.sum()
    x, dx = np.zeros(n_states), np.zeros((n_coordinates, n_states))
    states = np.zeros((n_samples, n_states))
    tangents = np.zeros((n_coordinates, n_samples, n_states))
    new, dnew = np.zeros(3), np.zeros(3)
    for t in range(n_samples):
        signal = 1.0 if t == 0 else 0.0
        dsignal = np.zeros(n_coordinates)
        start = 0
        for i in range(n_sections):
            m = sizes[i]
            for j in range(n_coordinates):
                if owner[j] > i:  # nothing upstream of a section depends on it
                    continue
                for a in range(m + 1):
                    value = matrices[i, a, m] * dsignal[j]
                    for b in range(m):
                        value += matrices[i, a, b] * dx[j, start + b]
                    if owner[j] == i:
                        value += slopes[j, a, m] * signal
                        for b in range(m):
                            value += slopes[j, a, b] * x[start + b]
                    dnew[a] = value
                for a in range(m):
                    dx[j, start + a] = dnew[a]
                dsignal[j] = dnew[m]
            for a in range(m + 1):
                value = matrices[i, a, m] * signal
                for b in range(m):
                    value += matrices[i, a, b] * x[start + b]
                new[a] = value
            for a in range(m):
                x[start + a] = new[a]
            signal = new[m]
            start += m
        states[t] = x
        tangents[:, t] = dx
    return states, tangents


@lru_cache(maxsize=8)  # factor and gradient ask for the same chain, one after the other
def chain_responses(chain: tuple[Section, ...], n_samples: int) -> tuple[Array, Array]:
    """Responses (n_samples, n_poles) at ages 1 .. n_samples, and their derivatives by every
    coordinate of the chain (n_coordinates, n_samples, n_poles).

    Orthonormal over infinite time: sum_t phi_i(t) phi_j(t) = delta_ij. Cost O(n_samples n_poles^2).
    """
    sizes = np.array([len(section.poles) for section in chain], np.int64)
    matrices = np.zeros((len(chain), 3, 3))
    if not len(chain):
        return np.zeros((n_samples, 0)), np.zeros((0, n_samples, 0))
    owner = np.array([i for i, section in enumerate(chain) for _ in section.coordinates], np.int64)
    slopes = np.zeros((len(owner), 3, 3))
    for i, section in enumerate(chain):
        matrix, slope = section.lattice()
        m = len(matrix)
        matrices[i, :m, :m] = matrix
        slopes[owner == i, :m, :m] = slope
    states, tangents = _run_chain(matrices, sizes, slopes, owner, n_samples)
    states.flags.writeable = tangents.flags.writeable = False
    return states, tangents

"""Zeros, poles and gain: the form every system is stated in, never an expanded polynomial.

Expanding a 10th-order printer loop moved its poles outside the unit circle (1.01 to 1.03) although
the loop is stable; sections keep every zero and pole to the last digit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ffl.errors import InputError
from ffl.systems.state_space import Array, ComplexArray, StateSpace

PAIR_TOLERANCE = 1e-9
CIRCLE_TOLERANCE = 1e-9


def conjugate_complete(values: ArrayLike, what: str) -> ComplexArray:
    """`values` as complex, checked to hold the conjugate of every complex member."""
    roots = np.atleast_1d(np.asarray(values, complex)).ravel()
    if not np.all(np.isfinite(roots)):
        raise InputError(f"{what} holds NaN or infinity; give finite numbers")
    remaining = list(roots)
    paired: list[complex] = []
    while remaining:
        root = remaining.pop(0)
        if root.imag == 0:
            paired.append(root)
            continue
        gaps = [abs(other - root.conjugate()) for other in remaining]
        if not gaps or min(gaps) > PAIR_TOLERANCE * max(1.0, abs(root)):
            raise InputError(
                f"{what} holds {root.real:g}{root.imag:+g}i without its conjugate; "
                "write both members of a complex pair"
            )
        remaining.pop(int(np.argmin(gaps)))
        paired += [root, root.conjugate()]
    return np.array(paired, complex)


@dataclass(frozen=True, init=False)
class Zpk:
    """H(z) = gain * prod(z - zeros) / prod(z - poles) * z^-delay, sampled at `sample_time` seconds.

    Complex zeros and poles come in conjugate pairs. A negative `delay` is an advance (as in the
    inverse of a strictly proper system).
    """

    zeros: ComplexArray
    poles: ComplexArray
    gain: float
    sample_time: float
    delay: int

    def __init__(
        self,
        zeros: ArrayLike,
        poles: ArrayLike,
        gain: float,
        sample_time: float,
        delay: int = 0,
    ) -> None:
        object.__setattr__(self, "zeros", conjugate_complete(zeros, "zeros"))
        object.__setattr__(self, "poles", conjugate_complete(poles, "poles"))
        object.__setattr__(self, "gain", float(gain))
        if not np.isfinite(self.gain) or self.gain == 0:
            raise InputError(f"gain = {gain} must be finite and not zero")
        if not sample_time > 0:
            raise InputError(f"sample_time = {sample_time} must be positive (seconds)")
        if delay != int(delay):
            raise InputError(f"delay = {delay} must be a whole number of samples")
        object.__setattr__(self, "sample_time", float(sample_time))
        object.__setattr__(self, "delay", int(delay))

    @property
    def relative_degree(self) -> int:
        return len(self.poles) - len(self.zeros) + self.delay

    @property
    def is_stable(self) -> bool:
        return bool(len(self.poles) == 0 or np.abs(self.poles).max() < 1.0)

    def inverse(self) -> Zpk:
        """1/H: zeros and poles exchanged, delay turned into advance."""
        return Zpk(self.poles, self.zeros, 1.0 / self.gain, self.sample_time, -self.delay)

    def __mul__(self, other: Zpk) -> Zpk:
        if abs(self.sample_time - other.sample_time) > 1e-9 * self.sample_time:
            raise InputError(
                f"series: sample times {self.sample_time} and {other.sample_time} differ"
            )
        return Zpk(
            np.concatenate([self.zeros, other.zeros]),
            np.concatenate([self.poles, other.poles]),
            self.gain * other.gain,
            self.sample_time,
            self.delay + other.delay,
        )

    def at(self, z: ArrayLike) -> ComplexArray:
        """H at the complex points `z`, factor by factor."""
        points = np.atleast_1d(np.asarray(z, complex))
        value = np.full(points.shape, self.gain, complex) * points ** float(-self.delay)
        for k in range(max(len(self.zeros), len(self.poles))):
            if k < len(self.zeros):
                value = value * (points - self.zeros[k])
            if k < len(self.poles):
                value = value / (points - self.poles[k])
        return value

    def response(self, frequencies_hz: ArrayLike) -> ComplexArray:
        """H(exp(i 2 pi f T)) at the frequencies in Hz."""
        return self.at(np.exp(2j * np.pi * np.asarray(frequencies_hz, float) * self.sample_time))

    def state_space(self) -> StateSpace:
        """Series of first- and second-order sections; each zero sits with its nearest poles."""
        if self.relative_degree < 0:
            raise InputError(
                f"the system has {-self.relative_degree} more zeros than poles, so it needs the "
                "future: use two_sided_filter"
            )
        poles = np.concatenate([self.poles, np.zeros(max(self.delay, 0))])
        if self.delay < 0:  # an advance that cancels some of the poles' excess
            return Zpk(
                np.concatenate([self.zeros, np.zeros(-self.delay)]),
                self.poles,
                self.gain,
                self.sample_time,
            ).state_space()
        n, k, d = len(poles), 0, 1.0
        a, b, c = np.zeros((n, n)), np.zeros(n), np.zeros(n)
        for group, zeros in _sections(poles, self.zeros):
            own_a, own_b, own_c, own_d = _section(group, zeros)
            here, before = slice(k, k + len(group)), slice(k)
            a[here, here], a[here, before] = own_a, np.outer(own_b, c[before])
            b[here] = np.multiply(own_b, d)
            c[before] *= own_d
            c[here] = own_c
            k, d = k + len(group), d * own_d
        return StateSpace(a, b, c * self.gain, d * self.gain, self.sample_time)

    def filter(self, u: ArrayLike) -> Array:
        """Causal response to `u` from initial rest; see `two_sided_filter` for the bounded one."""
        return self.state_space().filter(u)

    def impulse_response(self, n: int) -> Array:
        """First `n` samples of the causal impulse response."""
        return self.state_space().impulse_response(n)


def as_zpk(system: Zpk | StateSpace) -> Zpk:
    """Zeros, poles and gain of a SISO system; the gain is matched where the response is largest."""
    if isinstance(system, Zpk):
        return system
    zeros, poles = _tidy(system.zeros), _tidy(system.poles)
    unit = Zpk(zeros, poles, 1.0, system.sample_time)
    points = 1.5 * np.exp(1j * np.array([0.0, 0.7, 1.9, np.pi]))
    if system.order and np.abs(poles).max(initial=0.0) > 1.2:
        points = points * np.abs(poles).max()
    ratio = system.at(points) / unit.at(points)
    return Zpk(zeros, poles, float(np.median(ratio.real)), system.sample_time)


def as_state_space(system: Zpk | StateSpace) -> StateSpace:
    return system if isinstance(system, StateSpace) else system.state_space()


def _tidy(roots: ComplexArray) -> ComplexArray:
    """Eigenvalues of a real matrix with rounding removed from real ones and pairs made exact."""
    real = roots[np.abs(roots.imag) <= 1e-12 * np.maximum(1.0, np.abs(roots))].real
    upper = roots[roots.imag > 1e-12 * np.maximum(1.0, np.abs(roots))]
    return np.concatenate([real.astype(complex), upper, upper.conj()])


def _take_nearest(pool: list[complex], target: complex) -> complex:
    return pool.pop(int(np.argmin([abs(root - target) for root in pool])))


def _sections(
    poles: ComplexArray, zeros: ComplexArray
) -> list[tuple[list[complex], list[complex]]]:
    """Groups of one or two poles with at most as many zeros, complex pairs kept together."""
    pairs = sorted((p for p in poles if p.imag > 0), key=lambda p: -abs(p))
    reals = [p for p in poles if p.imag == 0]
    zero_pairs = [z for z in zeros if z.imag > 0]
    zero_reals = [z for z in zeros if z.imag == 0]
    sections: list[tuple[list[complex], list[complex]]] = []
    for pole in pairs:
        taken: list[complex] = []
        if zero_pairs:
            zero = _take_nearest(zero_pairs, pole)
            taken = [zero, zero.conjugate()]
        sections.append(([pole, pole.conjugate()], taken))
    while zero_pairs:  # more zero pairs than pole pairs: two real poles carry one
        zero = zero_pairs.pop()
        group = [_take_nearest(reals, zero), _take_nearest(reals, zero)]
        sections.append((group, [zero, zero.conjugate()]))
    for pole in sorted(reals, key=lambda p: -abs(p)):
        sections.append(([pole], [_take_nearest(zero_reals, pole)] if zero_reals else []))
    for group, taken in sections:  # what is left goes where there is room
        while zero_reals and len(taken) < len(group):
            taken.append(_take_nearest(zero_reals, group[0]))
    return sections


def _section(
    poles: list[complex], zeros: list[complex]
) -> tuple[list[list[float]], list[float], list[float], float]:
    """(A, b, c, d) of prod(z - zeros) / prod(z - poles) for one pole, two real poles or a complex pair."""
    if len(poles) == 1:
        p = poles[0].real
        if not zeros:
            return [[p]], [1.0], [1.0], 0.0
        return [[p]], [1.0], [p - zeros[0].real], 1.0
    if poles[0].imag == 0:  # states 1/(z-p1) and 1/((z-p1)(z-p2)): numerator in Newton form
        p1, p2 = poles[0].real, poles[1].real
        a, b = [[p1, 0.0], [1.0, p2]], [1.0, 0.0]
        if len(zeros) == 2:
            at_p2 = ((p2 - zeros[0]) * (p2 - zeros[1])).real
            c, d = [p1 + p2 - (zeros[0] + zeros[1]).real, at_p2], 1.0
        elif zeros:
            c, d = [1.0, p2 - zeros[0].real], 0.0
        else:
            c, d = [0.0, 1.0], 0.0
        return a, b, c, d
    # Modal form keeps the pair exactly: with s = z - re, the states are im/(s^2+im^2), s/(s^2+im^2).
    re, im = poles[0].real, abs(poles[0].imag)
    a, b = [[re, im], [-im, re]], [0.0, 1.0]
    if len(zeros) == 2:
        s1, s2 = zeros[0] - re, zeros[1] - re
        c, d = [((s1 * s2).real - im**2) / im, -(s1 + s2).real], 1.0
    elif zeros:
        c, d = [-(zeros[0].real - re) / im, 1.0], 0.0
    else:
        c, d = [1.0 / im, 0.0], 0.0
    return a, b, c, d

"""Non-causal rational orthonormal basis functions with poles in the disc and outside it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ffl.bases.arguments import check_size
from ffl.bases.base import Basis
from ffl.errors import InputError
from ffl.systems.state_space import Array, ComplexArray, StateSpace, series
from ffl.systems.two_sided import steady_state
from ffl.systems.zpk import CIRCLE_TOLERANCE, conjugate_complete


def all_pass(pole: complex, sample_time: float) -> StateSpace:
    """Orthogonal realisation of (1 - conj(p) z)/(z - p), or of the real pair's product.

    [A B; C D] is orthogonal, so the states of a chain of such sections are orthonormal in L2: for a
    real pole the Takenaka-Malmquist function itself, for a pair its real unitary transformation
    (Kautz form, with b = 2 Re p/(1 + |p|^2) and c = -|p|^2).
    """
    if pole.imag == 0:
        p = pole.real
        side = np.sqrt((1.0 - p) * (1.0 + p))
        return StateSpace(p, side, side, -p, sample_time)
    square = abs(pole) ** 2
    b, c = 2.0 * pole.real / (1.0 + square), -square
    s = abs(1.0 - pole) * abs(1.0 + pole) / (1.0 + square)  # sqrt(1 - b^2) without cancellation
    scale = np.sqrt((1.0 - square) * (1.0 + square))
    rows = np.array([[b, s * c, scale * s], [s, -b * c, -scale * b]])
    last = np.cross(rows[0], rows[1])
    last *= np.sign(last[2])  # feedthrough of the all-pass is |p|^2 > 0
    return StateSpace(rows[:, :2], rows[:, 2], last[:2], last[2], sample_time)


def chain(poles: ComplexArray, sample_time: float) -> StateSpace:
    """All-pass sections in series in the order given; one section per pole or conjugate pair."""
    total = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), 1.0, sample_time)
    for pole in poles:
        if pole.imag >= 0:
            total = series(total, all_pass(complex(pole), sample_time))
    return total


class OBF(Basis):
    """psi_s,k of equation (6) from `poles` inside the unit circle and psi_u,k of (7) from `outside`.

    Args:
        poles: poles of the strictly causal functions, |p| < 1, conjugate pairs complete.
        outside: poles of the anti-causal functions where they really lie, |p| > 1; in the paper's
            notation xi_u = 1/conj(p).
        feedthrough: puts xi_u,1 = 0 first, a direct term.
        repeat: how often the sequences are used, 1 = once (cyclic repetition, section III-C).
        sample_time: s.

    Complex pairs give real functions through a unitary transformation of the pair, so that the span
    and the orthonormality on the unit circle are those of (6) and (7).
    Source: 2018 printer paper, equations (6), (7); section III-C.
    """

    in_samples = True

    def __init__(
        self,
        poles: Sequence[complex] | ComplexArray,
        outside: Sequence[complex] | ComplexArray = (),
        feedthrough: bool = False,
        repeat: int = 1,
        sample_time: float = 1.0,
    ) -> None:
        inside = conjugate_complete(np.asarray(poles, complex), "poles")
        beyond = conjugate_complete(np.asarray(outside, complex), "outside")
        if isinstance(repeat, bool) or int(repeat) != repeat or repeat < 1:
            raise InputError(
                f"repeat = {repeat}: how often the pole sequence is used, a whole number from 1 on"
            )
        once = len(inside) + len(beyond) + bool(feedthrough)
        check_size(once * int(repeat), f"obf: repeat = {repeat}")
        for name, roots, wrong in (
            ("poles", inside, np.abs(inside) >= 1.0 - CIRCLE_TOLERANCE),
            ("outside", beyond, np.abs(beyond) <= 1.0 + CIRCLE_TOLERANCE),
        ):
            if wrong.any():
                root = roots[int(np.argmax(wrong))]
                on_circle = abs(abs(root) - 1.0) <= CIRCLE_TOLERANCE
                side = "inside" if name == "poles" else "outside"
                other = "outside" if name == "poles" else "poles"
                mend = "move it off the circle" if on_circle else f"put it under '{other}'"
                place = "on the unit circle" if on_circle else f"not {side} the unit circle"
                raise InputError(
                    f"{name}: {root.real:g}{root.imag:+g}i has magnitude {abs(root):.9g}, {place}; {mend}"
                )
        anticausal = 1.0 / beyond.conj() if beyond.size else beyond
        if feedthrough:
            anticausal = np.concatenate([[0.0], anticausal])
        if inside.size + anticausal.size == 0:
            raise InputError("obf: give at least one pole in 'poles' or 'outside', or feedthrough")
        self.sample_time = float(sample_time)
        self.repeat = int(repeat)
        self.forward_poles = np.tile(inside, repeat)  # xi_s, in the order of the chain
        self.backward_poles = np.tile(anticausal, repeat)  # xi_u
        self._causal = chain(self.forward_poles, self.sample_time)
        self._anticausal = chain(self.backward_poles, self.sample_time)

    @property
    def names(self) -> list[str]:
        causal = [f"psi_s{k + 1}" for k in range(self._causal.order)]
        return causal + [f"psi_u{k + 1}" for k in range(self._anticausal.order)]

    @property
    def preview(self) -> int:
        return -1 if self._anticausal.order and np.any(self._anticausal.a) else 0

    def regressors(self, reference: ArrayLike) -> Array:
        """Causal states run forwards; anti-causal ones backwards from rest at the last value.

        Cost O(N n^2).
        """
        r = np.asarray(reference, float)
        forwards, backwards = self._causal, self._anticausal
        columns = []
        if forwards.order:
            eye, zero = np.eye(forwards.order), np.zeros_like(forwards.b)
            states = StateSpace(forwards.a, forwards.b, eye, zero, self.sample_time)
            columns.append(states.filter(r, steady_state(states, r[0])).reshape(len(r), -1))
        if backwards.order:  # psi_u = (I - zA)^-1 B: the state after the sample it has just seen
            a, b = backwards.a, backwards.b
            states = StateSpace(a, b, a, b, self.sample_time)
            out = states.filter(r[::-1], steady_state(states, r[-1])).reshape(len(r), -1)
            columns.append(out[::-1])
        return np.hstack(columns)

    def at(self, z: ArrayLike) -> ComplexArray:
        """Psi(z), shape (F, n_parameters)."""
        points = np.atleast_1d(np.asarray(z, complex))[:, None, None]

        def solve(system: StateSpace, matrix: Any) -> ComplexArray:
            b = np.broadcast_to(system.b, (matrix.shape[0], *system.b.shape))
            return np.linalg.solve(matrix, b)[:, :, 0]

        eye_s, eye_u = np.eye(self._causal.order), np.eye(self._anticausal.order)
        return np.hstack(
            [
                solve(self._causal, points * eye_s - self._causal.a),
                solve(self._anticausal, eye_u - points * self._anticausal.a),
            ]
        )

    def response(self, frequencies_hz: ArrayLike) -> ComplexArray:
        return self.at(np.exp(2j * np.pi * np.asarray(frequencies_hz, float) * self.sample_time))

    def impulse_responses(self, before: int, after: int) -> Array:
        """phi_k(t) for t = -before .. after, shape (before + after + 1, n_parameters).

        phi_s(t) = A^(t-1) B for t >= 1; phi_u(-t) = A^t B for t >= 0 (2018 kernel paper, (9)).
        """
        pulse = np.zeros(before + after + 3)  # at rest, so zero, on both sides of the window
        pulse[before + 1] = 1.0
        return self.regressors(pulse)[1:-1]

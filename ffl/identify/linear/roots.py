"""Poles, zeros and frequency response of a fitted model with their standard errors (delta method)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ffl.identify.linear.coordinates import Point, Structure, Tangent
from ffl.identify.linear.signals import Scale
from ffl.systems.state_space import Array, ComplexArray


@dataclass(frozen=True)
class RootEstimate:
    """A pole or zero in the z-plane with first-order standard errors.

    `std_real`, `std_imag` of its parts; `frequency_hz` = |log z| / (2 pi T) and `damping` with
    theirs. A root fixed by the structure (an integrator) has zero standard errors. A negative real
    root has no continuous equivalent: its frequency lies at or above Nyquist.
    """

    value: complex
    std_real: float
    std_imag: float
    frequency_hz: float
    damping: float
    std_frequency_hz: float
    std_damping: float

    def covers(self, truth: complex, z: float = 1.959964) -> tuple[bool, bool]:
        """Do the intervals value ± z std hold the real and the imaginary part of `truth`?"""
        return (
            abs(truth.real - self.value.real) <= z * self.std_real,
            abs(truth.imag - self.value.imag) <= z * self.std_imag,
        )


def _estimate(value: complex, moves: ComplexArray, covariance: Array, t: float) -> RootEstimate:
    """`moves` (q,): derivative of the root along each local coordinate."""

    def std(gradient: Array) -> float:
        return float(np.sqrt(max(float(gradient @ covariance @ gradient), 0.0)))

    is_real = value.imag == 0
    std_real, std_imag = std(moves.real), 0.0 if is_real else std(moves.imag)
    if value == 0 or value == 1:
        frequency = 0.0 if value == 1 else np.inf
        return RootEstimate(value, std_real, std_imag, frequency, 1.0, 0.0, 0.0)
    s = np.log(complex(value)) / t
    ds = moves / (value * t)
    size = abs(s)
    d_size = np.real(np.conj(s) * ds) / size
    damping = -s.real / size
    d_damping = -(ds.real - s.real * d_size / size) / size
    hz = 2 * np.pi
    return RootEstimate(
        value,
        std_real,
        std_imag,
        float(size / hz),
        float(damping),
        std(d_size) / hz,
        std(d_damping),
    )


def _listed(
    values: ComplexArray, moves: ComplexArray, covariance: Array, sample_time: float
) -> tuple[RootEstimate, ...]:
    order = np.lexsort((values.imag, -np.abs(values)))
    return tuple(_estimate(complex(values[i]), moves[i], covariance, sample_time) for i in order)


def pole_estimates(
    point: Point, s: Structure, directions: Tangent, covariance: Array, sample_time: float
) -> tuple[RootEstimate, ...]:
    """Eigenvalues of A: d lambda = w* dA v / (w* v); the integrators stand at 1 without error."""
    n, m = s.order, s.order - s.integrators
    if n == 0:
        return ()
    values, left, right = scipy.linalg.eig(point.a[:m, :m], left=True, right=True)
    moves = np.einsum("ij,ikq,kj->jq", left.conj(), directions.matrix[:m, :m], right)
    moves = moves / np.sum(left.conj() * right, axis=0)[:, None]
    values = np.concatenate([values, np.ones(s.integrators)])
    moves = np.vstack([moves, np.zeros((s.integrators, directions.offset.size))])
    return _listed(values, moves, covariance, sample_time)


def zero_estimates(
    point: Point, directions: Tangent, covariance: Array, sample_time: float
) -> tuple[RootEstimate, ...]:
    """Finite eigenvalues of the pencil [[A, b], [c, d]] - z [[I, 0], [0, 0]]."""
    matrix = point.matrix
    n = point.a.shape[0]
    if n == 0:
        return ()
    # Rows and columns of b and c scaled to one, so that a small gain is not a zero at infinity.
    scale = np.ones(n + 1)
    scale_c = scale.copy()
    scale[n] = 1.0 / max(float(np.linalg.norm(matrix[n])), 1e-300)
    column = float(np.linalg.norm(matrix[:n, n]))
    scale_c[n] = 1.0 / max(column, float(scale[n]) * abs(point.d), 1e-300)
    balanced = scale[:, None] * matrix * scale_c
    mass = np.eye(n + 1)
    mass[n, n] = 0.0
    pair, left, right = scipy.linalg.eig(
        balanced, mass, left=True, right=True, homogeneous_eigvals=True
    )
    alpha, beta = pair
    finite = np.abs(beta) > 1e-7 * np.abs(alpha)
    values, left, right = alpha[finite] / beta[finite], left[:, finite], right[:, finite]
    values = np.where(np.abs(values.imag) < 1e-10 * np.abs(values), values.real, values)
    d = scale[:, None, None] * directions.matrix * scale_c[None, :, None]
    moves = np.einsum("ij,ikq,kj->jq", left.conj(), d, right)
    moves = moves / np.sum(left.conj() * (mass @ right), axis=0)[:, None]
    return _listed(values, moves, covariance, sample_time)


def response_std(
    point: Point,
    directions: Tangent,
    covariance: Array,
    frequencies_hz: ArrayLike,
    sample_time: float,
) -> Array:
    """sqrt(E |G^ - G|^2) at the frequencies: dG = [c X, 1] dPi [X b; 1], X = (zI - A)^-1."""
    z = np.exp(2j * np.pi * np.atleast_1d(np.asarray(frequencies_hz, float)) * sample_time)
    n = point.a.shape[0]
    inner = z[:, None, None] * np.eye(n) - point.a
    right = np.linalg.solve(inner, np.broadcast_to(point.b[:, None], (z.size, n, 1)))[:, :, 0]
    left = np.linalg.solve(
        np.swapaxes(inner, 1, 2), np.broadcast_to(point.c[:, None], (z.size, n, 1))
    )[:, :, 0]
    one = np.ones((z.size, 1))
    left, right = np.hstack([left, one]), np.hstack([right, one])
    d = np.einsum("fi,ijq,fj->fq", left, directions.matrix, right, optimize=True)
    return np.sqrt(np.maximum(np.real(np.einsum("fq,qp,fp->f", d, covariance, d.conj())), 0.0))


def offset_std(
    point: Point, s: Structure, scale: Scale, directions: Tangent, covariance: Array
) -> tuple[float, float | None]:
    """Standard errors of the offset o and of the load that stands for it, by the delta method.

    At the output o = o_s y_s + y_m - P(1) y_s/u_s u_m and the load is o / (P(1) y_s/u_s), with the
    scaled o_s, P(1), the scales y_s, u_s and the means y_m, u_m that were taken off; None where P(1) is
    0 or infinite. At the input both are o_s u_s - u_m.
    """

    def std(move: Array) -> float:
        return float(np.sqrt(np.maximum(move @ covariance @ move, 0.0)))

    own = directions.offset
    if s.offset == "none":
        return 0.0, None
    if s.offset != "output":
        return (scale.u * std(own),) * 2
    if s.integrators:
        return scale.y * std(own), None
    inner = np.eye(s.order) - point.a
    left = np.append(np.linalg.solve(inner.T, point.c), 1.0)
    right = np.append(np.linalg.solve(inner, point.b), 1.0)
    static = float(left[:-1] @ point.b) + point.d
    moved = np.einsum("i,ijq,j->q", left, directions.matrix, right)
    offset = scale.y * std(own - scale.u_mean / scale.u * moved)
    if not static:
        return offset, None
    whole = point.offset + scale.y_mean / scale.y
    return offset, scale.u * std(own / static - whole / static**2 * moved)

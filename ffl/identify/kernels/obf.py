"""Kernel of non-causal rational orthonormal basis functions, equations (8) to (10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ffl.errors import InputError
from ffl.identify.kernels.base import SCALE_BOUNDS, Array, Factor, Kernel, Slope
from ffl.identify.sections import Section, chain_responses, sections_of


@dataclass(frozen=True)
class OBF(Kernel):
    """D(k, k') = scale sum_i phi_i(k) phi_i(k'): the impulse response lies in span{phi_i}.

    `causal` and `anticausal` are chains of sections (poles inside; an anti-causal chain holds the
    reflections 1/conj(pole) of poles outside). `direct` = n adds the taps k = 0, -1, .., -(n-1),
    n poles of (8) at the origin, which a plant of relative degree n-1 needs; the anti-causal
    functions then start at k = -n. `pole_spread` is the hyperprior's standard deviation on every
    coordinate of the poles (logarithms of damping and frequency). D depends on the set of poles,
    not on their order.

    Source: 2018 kernel paper, equations (8), (9), (10), the product of phi' read as m = 0, -1, ..,
    k+1 and the poles of section 6 that lie outside reflected.
    """

    causal: tuple[Section, ...] = ()
    anticausal: tuple[Section, ...] = ()
    direct: int = 0
    scale: float = 1.0
    learn_poles: bool = True
    pole_spread: float = np.inf

    def __post_init__(self) -> None:
        if self.direct < 0:
            raise InputError(f"OBF kernel: direct = {self.direct} must be 0 or more")
        if not (np.isfinite(self.scale) and self.scale > 0):
            raise InputError(f"OBF kernel: scale = {self.scale} must be positive and finite")

    @classmethod
    def of_poles(
        cls,
        poles: Sequence[complex] = (),
        outside: Sequence[complex] = (),
        direct: int = 0,
        scale: float = 1.0,
        repeat: int = 1,
        learn_poles: bool = True,
        pole_spread: float = np.inf,
    ) -> OBF:
        """From poles inside and outside the unit circle, pairs in full, cycled `repeat` times."""
        beyond = np.atleast_1d(np.asarray(outside, complex))
        if beyond.size and np.abs(beyond).min() <= 1.0:
            raise InputError(
                "OBF kernel: `outside` holds a pole that is not outside the unit circle"
            )
        reflected = 1.0 / beyond.conj() if beyond.size else beyond
        inside, reflections = sections_of(poles) * repeat, sections_of(reflected) * repeat
        return cls(inside, reflections, direct, scale, learn_poles, pole_spread)

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles inside the unit circle."""
        return np.concatenate([s.poles for s in self.causal] or [np.zeros(0, complex)])

    @property
    def outside(self) -> NDArray[np.complex128]:
        """Poles outside the unit circle."""
        inner = np.concatenate([s.poles for s in self.anticausal] or [np.zeros(0, complex)])
        return np.asarray(1.0 / inner.conj(), complex)

    @property
    def names(self) -> tuple[str, ...]:
        if not self.learn_poles:
            return ("scale",)
        sides = (("causal", self.causal), ("anticausal", self.anticausal))
        return (
            "scale",
            *(
                f"{side}[{i}][{j}]"
                for side, chain in sides
                for i, section in enumerate(chain)
                for j in range(len(section.coordinates))
            ),
        )

    @property
    def coordinates(self) -> Array:
        poles = [c for s in (*self.causal, *self.anticausal) for c in s.coordinates]
        return np.array([np.log(self.scale), *(poles if self.learn_poles else [])])

    @property
    def bounds(self) -> list[tuple[float, float]]:
        chain = (*self.causal, *self.anticausal) if self.learn_poles else ()
        return [SCALE_BOUNDS, *(bound for section in chain for bound in section.bounds)]

    @property
    def spread(self) -> Array:
        return np.array([np.inf] + [self.pole_spread] * (len(self.names) - 1))

    def at(self, coordinates: Array) -> Self:
        scale = float(np.exp(coordinates[0]))
        if not self.learn_poles:
            return replace(self, scale=scale)
        rest = [float(c) for c in coordinates[1:]]
        moved = []
        for section in (*self.causal, *self.anticausal):
            n = len(section.coordinates)
            moved.append(type(section)(*rest[:n]))
            rest = rest[n:]
        split = len(self.causal)
        return replace(
            self, scale=scale, causal=tuple(moved[:split]), anticausal=tuple(moved[split:])
        )

    def basis(self, lags: Array) -> tuple[Array, Array]:
        """Functions phi (n_lags, n_functions), direct terms first, and their derivatives by the
        coordinates of the poles (n_coordinates, n_lags, n_functions).
        """
        lags = np.asarray(lags, int)
        functions, slopes = [np.zeros((len(lags), self.direct))], []
        for j in range(self.direct):
            functions[0][lags == -j, j] = 1.0
        n_total = self.direct + len(self.poles) + len(self.outside)
        start = self.direct
        ages = ((self.causal, lags - 1), (self.anticausal, -lags - self.direct))
        for chain, age in ages:
            response, tangent = chain_responses(chain, max(int(age.max(initial=-1)) + 1, 0))
            inside = age >= 0
            block = np.zeros((len(lags), response.shape[1]))
            block[inside] = response[age[inside]]
            functions.append(block)
            slope = np.zeros((len(tangent), len(lags), n_total))
            slope[:, inside, start : start + response.shape[1]] = tangent[:, age[inside]]
            slopes.append(slope)
            start += response.shape[1]
        return np.hstack(functions), np.concatenate(slopes)

    def factor(self, lags: Array) -> Factor:
        functions, _ = self.basis(lags)
        n_lags, p = functions.shape
        return Factor(np.sqrt(self.scale) * functions, np.zeros(p, bool), np.zeros(n_lags))

    def matrix(self, lags: Array) -> Array:
        columns = self.factor(lags).columns
        return columns @ columns.T

    def tangents(self, lags: Array, coefficients: Array) -> Array:
        if not self.learn_poles:
            return np.zeros((len(lags), 1))
        moved = np.sqrt(self.scale) * np.tensordot(
            self.basis(lags)[1], coefficients, axes=([2], [0])
        )
        return np.column_stack([np.zeros(len(lags)), moved.T])

    def gradient(self, lags: Array, slope: Slope) -> Array:
        own = slope.own()
        functions, slopes = self.basis(lags)
        root = np.sqrt(self.scale)
        by_scale = np.vdot(own, root * functions)
        if not self.learn_poles:
            return np.array([by_scale])
        by_poles = 2.0 * root * np.tensordot(slopes, own, axes=([1, 2], [0, 1]))
        return np.concatenate([[by_scale], by_poles])

"""Sums and products of kernels, and kernels whose hyperparameters stay as they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from ffl.identify.kernels.base import Array, Factor, Kernel, Slope


@dataclass(frozen=True)
class _Columns:
    """The slope as one term of a sum sees it: the same S, its own columns of S B."""

    whole: Slope
    columns: slice

    def dense(self) -> Array:
        return self.whole.dense()

    def own(self) -> Array:
        return self.whole.own()[:, self.columns]


@dataclass(frozen=True)
class _Weighted:
    """The slope as one factor of a product sees it: S times the other factor, entry by entry."""

    weighted: Array
    kernel: Kernel
    lags: Array

    def dense(self) -> Array:
        return self.weighted

    def own(self) -> Array:
        return self.weighted @ self.kernel.factor(self.lags).columns


@dataclass(frozen=True)
class Sum(Kernel):
    """D = sum of the terms' D: independent contributions to the impulse response."""

    terms: tuple[Kernel, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"{i}.{name}" for i, term in enumerate(self.terms) for name in term.names)

    @property
    def coordinates(self) -> Array:
        return np.concatenate([term.coordinates for term in self.terms])

    @property
    def starts(self) -> list[Array]:
        return _one_at_a_time(self.terms)

    @property
    def bounds(self) -> list[tuple[float, float]]:
        return [bound for term in self.terms for bound in term.bounds]

    @property
    def spread(self) -> Array:
        return np.concatenate([term.spread for term in self.terms])

    def at(self, coordinates: Array) -> Self:
        moved, start = [], 0
        for term in self.terms:
            stop = start + len(term.names)
            moved.append(term.at(coordinates[start:stop]))
            start = stop
        return type(self)(tuple(moved))

    def matrix(self, lags: Array) -> Array:
        return sum((term.matrix(lags) for term in self.terms), np.zeros((len(lags), len(lags))))

    def factor(self, lags: Array) -> Factor:
        parts = [term.factor(lags) for term in self.terms]
        return Factor(
            np.hstack([part.columns for part in parts]),
            np.concatenate([part.flat for part in parts]),
            np.sum([part.dropped for part in parts], axis=0),
        )

    def tangents(self, lags: Array, coefficients: Array) -> Array:
        parts, start = [], 0
        for term in self.terms:
            stop = start + term.factor(lags).columns.shape[1]
            parts.append(term.tangents(lags, coefficients[start:stop]))
            start = stop
        return np.hstack(parts)

    def gradient(self, lags: Array, slope: Slope) -> Array:
        gradients, start = [], 0
        for term in self.terms:
            stop = start + term.factor(lags).columns.shape[1]
            gradients.append(term.gradient(lags, _Columns(slope, slice(start, stop))))
            start = stop
        return np.concatenate(gradients)

    def __add__(self, other: Kernel) -> Kernel:
        return Sum((*self.terms, *(other.terms if isinstance(other, Sum) else (other,))))


@dataclass(frozen=True)
class Product(Kernel):
    """D(k, k') = first(k, k') second(k, k'): positive semidefinite by Schur's theorem."""

    first: Kernel
    second: Kernel

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(
            f"{i}.{name}" for i, k in enumerate((self.first, self.second)) for name in k.names
        )

    @property
    def coordinates(self) -> Array:
        return np.concatenate([self.first.coordinates, self.second.coordinates])

    @property
    def starts(self) -> list[Array]:
        return _one_at_a_time((self.first, self.second))

    @property
    def bounds(self) -> list[tuple[float, float]]:
        return self.first.bounds + self.second.bounds

    @property
    def spread(self) -> Array:
        return np.concatenate([self.first.spread, self.second.spread])

    def at(self, coordinates: Array) -> Self:
        n = len(self.first.names)
        return type(self)(self.first.at(coordinates[:n]), self.second.at(coordinates[n:]))

    def matrix(self, lags: Array) -> Array:
        return self.first.matrix(lags) * self.second.matrix(lags)

    def gradient(self, lags: Array, slope: Slope) -> Array:
        dense = slope.dense()
        one = _Weighted(dense * self.second.matrix(lags), self.first, lags)
        two = _Weighted(dense * self.first.matrix(lags), self.second, lags)
        return np.concatenate([self.first.gradient(lags, one), self.second.gradient(lags, two)])


def _one_at_a_time(parts: tuple[Kernel, ...]) -> list[Array]:
    """Starts of one part, the others held where they are."""
    present = [part.coordinates for part in parts]
    starts = [np.concatenate(present)]
    for i, part in enumerate(parts):
        for start in part.starts[1:]:
            starts.append(np.concatenate([*present[:i], start, *present[i + 1 :]]))
    return starts


@dataclass(frozen=True)
class Fixed(Kernel):
    """The same D with nothing left to learn."""

    kernel: Kernel

    @property
    def names(self) -> tuple[str, ...]:
        return ()

    @property
    def coordinates(self) -> Array:
        return np.zeros(0)

    @property
    def bounds(self) -> list[tuple[float, float]]:
        return []

    def at(self, coordinates: Array) -> Self:
        return self

    def matrix(self, lags: Array) -> Array:
        return self.kernel.matrix(lags)

    def factor(self, lags: Array) -> Factor:
        return self.kernel.factor(lags)

    def gradient(self, lags: Array, slope: Slope) -> Array:
        return np.zeros(0)

"""Direct terms: a few independent taps near zero, for the relative degree of the plant."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ffl.errors import InputError
from ffl.identify.kernels.base import SCALE_BOUNDS, Array, Factor, Kernel, Slope


@dataclass(frozen=True)
class Direct(Kernel):
    """D(k, k) = scale for first <= k <= last, zero elsewhere.

    A plant of relative degree 2 has an inverse with taps at k = -2, -1, 0 that are hundreds of
    times larger than the rest: no decaying kernel carries them. `scale` infinite leaves these taps
    unregularised, with a flat prior and no hyperparameter.
    """

    first: int
    last: int
    scale: float = np.inf

    def __post_init__(self) -> None:
        if self.first > self.last:
            raise InputError(f"direct terms from {self.first} to {self.last}: give first <= last")
        if not self.scale > 0:
            raise InputError(f"direct terms: scale = {self.scale} must be positive")

    @property
    def names(self) -> tuple[str, ...]:
        return ("scale",) if np.isfinite(self.scale) else ()

    @property
    def coordinates(self) -> Array:
        return np.array([np.log(self.scale)] if np.isfinite(self.scale) else [])

    @property
    def bounds(self) -> list[tuple[float, float]]:
        return [SCALE_BOUNDS for _ in self.names]

    def at(self, coordinates: Array) -> Self:
        if not len(coordinates):
            return self
        return replace(self, scale=float(np.exp(coordinates[0])))

    def _inside(self, lags: Array) -> NDArray[np.intp]:
        return np.flatnonzero((np.asarray(lags) >= self.first) & (np.asarray(lags) <= self.last))

    def matrix(self, lags: Array) -> Array:
        if not np.isfinite(self.scale):
            raise InputError("direct terms with an infinite scale have no covariance matrix")
        diagonal = np.zeros(len(lags))
        diagonal[self._inside(lags)] = self.scale
        return np.diag(diagonal)

    def factor(self, lags: Array) -> Factor:
        inside = self._inside(lags)
        finite = bool(np.isfinite(self.scale))
        columns = np.zeros((len(lags), len(inside)))
        columns[inside, np.arange(len(inside))] = np.sqrt(self.scale) if finite else 1.0
        return Factor(columns, np.full(len(inside), not finite), np.zeros(len(lags)))

    def gradient(self, lags: Array, slope: Slope) -> Array:
        if not self.names:
            return np.zeros(0)
        return np.array([np.vdot(slope.own(), self.factor(lags).columns)])

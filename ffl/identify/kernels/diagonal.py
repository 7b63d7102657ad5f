"""Diagonal kernel: independent taps with a decaying variance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffl.identify.kernels.base import Array, Decaying


@dataclass(frozen=True)
class Diagonal(Decaying):
    """D(k, k') = scale b(k) for k = k', zero elsewhere (Chen, Ohlsson and Ljung, 2012)."""

    def matrix(self, lags: Array) -> Array:
        b, _ = self._envelope(lags)
        return np.diag(self.scale * b)

    def _slopes(self, lags: Array) -> dict[str, Array]:
        _, slopes = self._envelope(lags)
        return {name: np.diag(self.scale * d) for name, d in slopes.items()}

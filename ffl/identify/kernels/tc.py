"""Tuned/correlated kernel (first-order stable spline)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffl.identify.kernels.base import Array, Decaying


@dataclass(frozen=True)
class TC(Decaying):
    """D(k, k') = scale min(b(k), b(k')): Brownian motion in the warped time b.

    On one side it is scale decay^max(k, k') as in Chen, Ohlsson and Ljung (2012); the two sides
    meet at the peak and share what is slow.
    """

    def matrix(self, lags: Array) -> Array:
        b, _ = self._envelope(lags)
        return self.scale * np.minimum.outer(b, b)

    def _slopes(self, lags: Array) -> dict[str, Array]:
        b, slopes = self._envelope(lags)
        row_smaller = b[:, None] < b[None, :]
        tie = b[:, None] == b[None, :]
        return {
            name: self.scale
            * np.where(
                tie,
                0.5 * (d[:, None] + d[None, :]),
                np.where(row_smaller, d[:, None], d[None, :]),
            )
            for name, d in slopes.items()
        }

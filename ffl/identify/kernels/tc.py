"""Tuned/correlated kernel (first-order stable spline), two-sided."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffl.identify.kernels.base import Array, Decaying


@dataclass(frozen=True)
class TC(Decaying):
    """D(k, k') = scale min(b(k), b(k')) on one side of the peak, scale b(k) b(k') across it.

    Brownian motion in the warped time b on either side (Chen, Ohlsson and Ljung, 2012: on one side
    scale decay^max(k, k')), the sides independent given the tap at the peak.
    """

    def matrix(self, lags: Array) -> Array:
        b, _ = self._envelope(lags)
        same = self._same_side(lags)
        return self.scale * np.where(same, np.minimum.outer(b, b), np.outer(b, b))

    def _slopes(self, lags: Array) -> dict[str, Array]:
        b, slopes = self._envelope(lags)
        same = self._same_side(lags)
        row_smaller = b[:, None] <= b[None, :]  # on one side a tie is the diagonal only
        result = {}
        for name, d in slopes.items():
            within = np.where(row_smaller, d[:, None], d[None, :])
            across = np.outer(d, b) + np.outer(b, d)
            result[name] = self.scale * np.where(same, within, across)
        return result

"""Second-order stable spline kernel, two-sided."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffl.identify.kernels.base import Array, Decaying


@dataclass(frozen=True)
class StableSpline(Decaying):
    """D(k, k') = scale s^2 (3 l - s) / 6 with s, l the smaller and larger of b(k), b(k').

    Integrated Brownian motion in the warped time b. Source: 2025 Bayesian paper, equations (9) and
    (10); on one side Pillonetto and De Nicolao (2010).
    """

    def matrix(self, lags: Array) -> Array:
        b, _ = self._envelope(lags)
        small, large = np.minimum.outer(b, b), np.maximum.outer(b, b)
        return self.scale * small**2 * (3.0 * large - small) / 6.0

    def _slopes(self, lags: Array) -> dict[str, Array]:
        b, slopes = self._envelope(lags)
        small, large = np.minimum.outer(b, b), np.maximum.outer(b, b)
        by_small = small * (2.0 * large - small) / 2.0
        by_large = small**2 / 2.0
        # on a tie both partial derivatives are b^2/2, so either branch is right
        row_smaller = b[:, None] <= b[None, :]
        result = {}
        for name, d in slopes.items():
            by_row = np.where(row_smaller, by_small, by_large) * d[:, None]
            result[name] = self.scale * (by_row + by_row.T)
        return result

"""Diagonal/correlated kernel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffl.errors import InputError
from ffl.identify.kernels.base import Array, Decaying


@dataclass(frozen=True)
class DC(Decaying):
    """D(k, k') = scale sqrt(b(k) b(k')) correlation^|k - k'|.

    The two sides are correlated across the peak. On one side it is the DC kernel of Chen, Ohlsson
    and Ljung (2012), and TC where correlation = sqrt(decay).
    """

    correlation: float = 0.9

    def __post_init__(self) -> None:
        super().__post_init__()
        if not -1.0 < self.correlation < 1.0:
            raise InputError(f"kernel correlation = {self.correlation} must lie in (-1, 1)")

    def _hyperparameters(self) -> tuple[str, ...]:
        return (*super()._hyperparameters(), "correlation")

    def _correlated(self, lags: Array) -> tuple[Array, Array]:
        """|k - k'| and correlation^|k - k'|; a negative correlation alternates (whole lags)."""
        gap = np.abs(np.subtract.outer(np.asarray(lags, float), np.asarray(lags, float)))
        sign = np.where(gap % 2 == 1, np.sign(self.correlation), 1.0)
        with np.errstate(divide="ignore"):
            power = np.where(gap == 0, 1.0, np.abs(self.correlation) ** gap)
        return gap, sign * power

    def matrix(self, lags: Array) -> Array:
        root = np.sqrt(self._envelope(lags)[0])
        return self.scale * np.outer(root, root) * self._correlated(lags)[1]

    def _slopes(self, lags: Array) -> dict[str, Array]:
        b, slopes = self._envelope(lags)
        gap, correlated = self._correlated(lags)
        root = np.sqrt(b)
        whole = self.scale * np.outer(root, root) * correlated
        result = {}
        for name, d in slopes.items():
            relative = np.divide(d, b, out=np.zeros_like(b), where=b > 0)
            result[name] = 0.5 * whole * (relative[:, None] + relative[None, :])
        rho = self.correlation
        # d rho / d atanh(rho) = 1 - rho^2; the power rule at rho = 0 leaves only |k - k'| = 1
        derivative = np.where(gap == 0, 0.0, gap * _power(rho, gap - 1.0)) * (1.0 - rho**2)
        result["correlation"] = self.scale * np.outer(root, root) * derivative
        return result


def _power(base: float, exponent: Array) -> Array:
    """base^exponent for whole exponents >= 0, elsewhere 0; 0^0 = 1."""
    safe = np.maximum(exponent, 0.0)
    sign = np.where(safe % 2 == 1, np.sign(base) if base else 1.0, 1.0)
    return np.where(exponent < 0, 0.0, sign * np.abs(base) ** safe)

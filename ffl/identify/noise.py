"""Coloured noise (2018, Remark 2): autoregressive models, from residuals or from P and H.

The paper assumes that P^-1 H = 1. Elsewhere v_r = -P^-1 H eps is coloured: a whitening filter on
both output and target makes (2) a regression with white noise again, with the same theta.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from ffl.errors import InputError
from ffl.identify.regression import Regression
from ffl.systems.two_sided import refuse_unit_circle
from ffl.systems.zpk import Zpk

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseModel:
    """v(t) + a_1 v(t-1) + .. + a_p v(t-p) = white noise of the given variance; `filter` = (1, a)."""

    filter: Array
    variance: float

    @property
    def order(self) -> int:
        return len(self.filter) - 1


def fit_noise(residual: Array, order: int | None = None, largest: int = 30) -> NoiseModel:
    """AR model of a residual by Burg's method; `order` None: by BIC up to `largest`. O(N order).

    Burg's lattice is stable by construction and loses nothing at the ends of a short residual.
    """
    n = len(residual)
    top = largest if order is None else order
    top = min(top, n // 4)
    forward, backward = residual.astype(float).copy(), residual.astype(float).copy()
    a, variance = np.ones(1), float(residual @ residual) / n
    best, best_score = NoiseModel(a, variance), n * np.log(max(variance, 1e-300))
    for p in range(1, top + 1):
        f, b = forward[1:], backward[:-1]
        energy = float(f @ f + b @ b)
        if energy <= 0.0:
            break
        k = -2.0 * float(f @ b) / energy
        forward, backward = f + k * b, b + k * f
        a = np.append(a, 0.0) + k * np.append(a, 0.0)[::-1]
        variance *= 1.0 - k * k
        score = n * np.log(max(variance, 1e-300)) + p * np.log(n)
        if order is not None or score < best_score:
            best, best_score = NoiseModel(a, variance), score
    return best


def noise_of(
    system: Zpk, variance: float = 1.0, order: int = 60, n_grid: int = 1 << 16
) -> NoiseModel:
    """AR model with the spectrum of `system` driven by white noise, causal or not.

    For Remark 2 give P^-1 H: `noise_of(plant.inverse() * shaping)`. Only |P^-1 H|^2 matters, so
    zeros of P outside the disc, and the advance of P^-1, do no harm (Levinson on the autocovariance).
    """
    if order < 1:
        raise InputError(f"noise_of: order = {order} must be 1 or more")
    refuse_unit_circle(system, "noise_of: the system")
    spectrum = np.abs(system.at(np.exp(2j * np.pi * np.arange(n_grid // 2 + 1) / n_grid))) ** 2
    covariance = variance * np.fft.irfft(spectrum, n_grid)
    a = scipy.linalg.solve_toeplitz(covariance[:order], -covariance[1 : order + 1])
    return NoiseModel(np.append(1.0, a), float(covariance[0] + a @ covariance[1 : order + 1]))


def whitened(regression: Regression, noise: NoiseModel) -> Regression:
    """The regression with output and target filtered by the noise model's inverse.

    An AR filter is short, so it costs `order` rows and no assumption about what came before.
    """
    p = noise.order
    if p == 0:
        return regression
    if regression.n_rows <= p:
        raise InputError(
            f"noise model of order {p} leaves no row of {regression.n_rows}; lower the order"
        )
    return replace(
        regression,
        output=np.convolve(regression.output, noise.filter, mode="valid"),
        target=np.convolve(regression.target, noise.filter, mode="valid"),
        first=regression.first + p,
    )

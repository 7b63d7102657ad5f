"""Standard errors of parameters learned in closed loop, where the residual is far from white."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from ffl.learn.coordinates import orthonormal
from ffl.systems import Loop
from ffl.systems.state_space import Array

BINS = 7  # on either side, for the local level of the whitened periodogram
ROUNDS = 5


def standard_errors(columns: Array, residual: Array, loop: Loop) -> Array:
    """Of theta in b = columns theta + residual, by ordinary least squares; shape (n,).

    Sensor noise reaches the error through S, force noise through SP, so below the bandwidth the
    residual's spectrum falls with the second to fourth power of frequency: windows over lags
    (Newey-West) overrate it up to 170 times there. Here the residual's periodogram is divided by
    v |S|^2 + w |SP|^2, with v, w >= 0 by Whittle's weights, smoothed over a few bins (which keeps
    what physics has left in the residual), and multiplied back; the covariance of theta is that of
    a stationary residual with this spectrum.
    """
    n = len(residual)
    found = orthonormal(columns)
    f = np.fft.rfftfreq(n, loop.system.sample_time)
    taper = np.hanning(n)  # without it the strong high frequencies leak into the weak low ones
    power = np.abs(np.fft.rfft(taper * residual)) ** 2 / np.sum(taper**2)
    seen = np.maximum(f, f[1])  # without a controller the plant may integrate: no answer at 0 Hz
    shapes = np.column_stack(
        [
            np.abs(system.response(seen)) ** 2
            for system in (loop.sensitivity, loop.process_sensitivity)
        ]
    )
    inside = slice(3, len(f))  # below lies the taper's main lobe, filled by its neighbours
    weight = np.ones(len(f))
    model = np.ones(len(f))
    scale = shapes[inside].max(axis=0)
    for _ in range(ROUNDS):
        rows = (shapes / scale / weight[:, None])[inside]
        levels, _ = nnls(rows, (power / weight)[inside])
        model = np.maximum(shapes / scale @ levels, 1e-12 * power.max() + 1e-300)
        weight = model
    ratio = np.pad((power / model)[inside], BINS, mode="reflect")
    kernel = np.full(2 * BINS + 1, 1.0 / (2 * BINS + 1))
    level = np.convolve(ratio, kernel, mode="valid")
    spectrum = model * np.concatenate([np.full(3, level[0]), level])
    spectra = np.fft.rfft(found.q, axis=0)
    share = np.full(len(f), 2.0)
    share[0] = 1.0
    if n % 2 == 0:
        share[-1] = 1.0
    scores = np.real(np.conj(spectra).T @ (spectra * (share * spectrum)[:, None])) / n
    covariance = found.back @ scores @ found.back.T
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))

"""xi(theta) and its derivative on the unit circle, by FFT: any order, and an independent road.

    xi = F^-1{1 / theta(e^jw)},     d xi(t) / d theta(tau) = -[xi * xi](t - tau),

both for t on either side of 0: the bounded inverse of theta need not be causal.

O(L log L) for a grid of L points; aliasing is r^L, r the root nearest to the circle. This is what
Gauss-Newton uses; the number of roots inside comes from the winding number, without roots.
"""

import numpy as np


def grid_size(n_taps: int, length: int) -> int:
    """Power of two at which responses of that length alias little: at least 8 times, 1024 up."""
    return 1 << max(10, int(np.ceil(np.log2(4 * (n_taps + length)))))


def _on_circle(theta: np.ndarray, n_ac: int, grid: int) -> np.ndarray:
    wrapped = np.zeros(grid)
    wrapped[np.arange(-n_ac, len(theta) - n_ac)] = theta
    return np.fft.rfft(wrapped)


def circle_response(
    theta: np.ndarray, n_ac: int, length: int, grid: int = 0, before: int = 0
) -> np.ndarray:
    """xi(-before..length-1) by inverse FFT of 1/theta on the unit circle."""
    grid = grid or grid_size(len(theta), length + before)
    return np.fft.irfft(1 / _on_circle(theta, n_ac, grid), grid)[np.arange(-before, length)]


def circle_jacobian(
    theta: np.ndarray, n_ac: int, length: int, before: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """xi(-before..length-1), and d xi / d theta, shape (before + length, n_taps)."""
    grid = grid_size(len(theta), length + before)
    response = 1 / _on_circle(theta, n_ac, grid)
    square = np.fft.irfft(response**2, grid)
    t = np.arange(-before, length)
    lags = t[:, None] - np.arange(-n_ac, len(theta) - n_ac)
    return np.fft.irfft(response, grid)[t], -square[lags]


def inside_count(theta: np.ndarray, n_ac: int) -> int:
    """Number of roots of theta(z) in the unit disc: winding number plus n_c - 1.

    It is a discrete label of the model: the forward system 1/theta has a delay of
    (number inside) - (n_c - 1) samples in the sense of its phase.
    """
    values = _on_circle(theta, n_ac, grid_size(len(theta), 0))
    turns = np.angle(values[1:] / values[:-1]).sum() / np.pi
    return round(turns) + len(theta) - n_ac - 1


def invert_response(xi: np.ndarray, n_ac: int, n_c: int) -> np.ndarray:
    """Taps -n_ac..n_c-1 of the bounded inverse of the FIR system `xi` (Theorem 1), by FFT."""
    grid = 8 * grid_size(n_ac + n_c, len(xi))
    return np.fft.ifft(1 / np.fft.fft(xi, grid)).real[np.arange(-n_ac, n_c)]

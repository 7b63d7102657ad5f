"""The simulation of section IV of the 2025 paper: system (21), its data sets, the fit (25).

The paper leaves out what makes its figures come out; what is fixed here, and what each costs when
done otherwise, stands in `reports/papers.md`: zero initial state, the input runs on past N so that
x is there for the non-causal taps, the noise variance is var(x) 10^(-SNR/10), and outliers are
those of the 1.5 IQR rule.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from ffl.errors import InputError

PAPER_GAIN = 0.004
PAPER_ZEROS = np.array([0.75, 0.6, 15.0 + 1j * np.sqrt(0.9), 15.0 - 1j * np.sqrt(0.9)])
PAPER_POLES = np.array([0.6 + 0.2j, 0.6 - 0.2j, 0.75 + 0.1j, 0.75 - 0.1j])
# (z - z0)(z - conj z0) in powers of z^-1, one row a section: (21) as printed
_NUMERATORS = np.array([[1.0, -1.35, 0.45], [1.0, -30.0, 225.9]])
_DENOMINATORS = np.array([[1.0, -1.2, 0.4], [1.0, -1.5, 0.5725]])


@dataclass(frozen=True)
class DataSet:
    """One realisation: `u`, `x` on 1..N+n_ac (the tail is for the fit only), `y` on 1..N.

    `noise_variance` is the true one: for plots and tests, no method reads it.
    """

    u: np.ndarray
    x: np.ndarray
    y: np.ndarray
    noise_variance: float
    seed: int

    @property
    def n_samples(self) -> int:
        return len(self.y)


def simulate_paper_system(u: np.ndarray) -> np.ndarray:
    """Output x = G u of (21), zero initial state, section by section; O(N)."""
    x = PAPER_GAIN * np.asarray(u, float)
    for numerator, denominator in zip(_NUMERATORS, _DENOMINATORS, strict=True):
        x = lfilter(numerator, denominator, x)
    return x


def paper_data(seed: int, n_samples: int = 60, snr_db: float = 14.0, n_ac: int = 4) -> DataSet:
    """Data set number `seed`: u and v white, normal, independent; 14 dB at the output.

    >>> data = paper_data(0)
    >>> data.u.shape, data.x.shape, data.y.shape
    ((64,), (64,), (60,))
    """
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(n_samples + n_ac)
    x = simulate_paper_system(u)
    variance = float(np.var(x[:n_samples])) * 10 ** (-snr_db / 10)
    y = x[:n_samples] + np.sqrt(variance) * rng.standard_normal(n_samples)
    return DataSet(u, x, y, variance, seed)


def true_forward_impulse(length: int) -> np.ndarray:
    """xi(0..length-1) of (21): left panel of Figure 3."""
    return simulate_paper_system(np.eye(1, length).ravel())


def true_inverse_impulse(before: int, after: int, grid: int = 4096) -> np.ndarray:
    """theta(-before..after) of 1/G, bounded and non-causal (Theorem 1): right panel of Figure 3.

    On the unit circle, by inverse FFT; aliasing is 0.81^grid.
    """
    z = np.exp(2j * np.pi * np.arange(grid) / grid)[:, None]
    inverse = np.prod(z - PAPER_POLES, 1) / np.prod(z - PAPER_ZEROS, 1) / PAPER_GAIN
    return np.fft.ifft(inverse).real[np.arange(-before, after + 1)]


def shifted(x: np.ndarray, n_ac: int, n_c: int, n_rows: int) -> np.ndarray:
    """Matrix with the columns x(t - tau), tau = -n_ac..n_c-1, rows t = 1..n_rows; zero outside x."""
    padded = np.concatenate([np.zeros(n_c - 1), x, np.zeros(n_ac + n_rows)])
    windows = np.lib.stride_tricks.sliding_window_view(padded, n_ac + n_c)
    return windows[:n_rows, ::-1]


def inverse_fit(theta: np.ndarray, n_ac: int, u: np.ndarray, x: np.ndarray, n_rows: int) -> float:
    """Fit (25) in per cent of an inverse FIR model: u-hat(t) = sum theta(tau) x(t - tau), (26).

    `u` and `x` start at t = 1 from rest; rows 1..n_rows count, x must reach n_rows + n_ac (with x
    cut at N even the true inverse reaches only 69).
    """
    if len(x) < n_rows + n_ac:
        raise InputError(
            f"x has {len(x)} samples, the fit over {n_rows} rows with {n_ac} non-causal taps needs "
            f"{n_rows + n_ac}: simulate on past the end"
        )
    error = u[:n_rows] - shifted(x, n_ac, len(theta) - n_ac, n_rows) @ theta
    spread = u[:n_rows] - u[:n_rows].mean()
    return float(100 * (1 - np.linalg.norm(error) / np.linalg.norm(spread)))


def forward_fit(xi: np.ndarray, u: np.ndarray, x: np.ndarray, n_rows: int) -> float:
    """Fit in per cent of a forward FIR model to the noise-free x: left box plot of Figure 4."""
    error = x[:n_rows] - np.convolve(xi, u[:n_rows])[:n_rows]
    spread = x[:n_rows] - x[:n_rows].mean()
    return float(100 * (1 - np.linalg.norm(error) / np.linalg.norm(spread)))


def inliers(fits: np.ndarray) -> np.ndarray:
    """True where a fit lies within 1.5 interquartile ranges of the quartiles (box-plot rule)."""
    low, high = np.percentile(fits, [25, 75])
    reach = 1.5 * (high - low)
    return (fits >= low - reach) & (fits <= high + reach)

"""The methods the paper compares with (section IV): naive, two-step, oracle."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import toeplitz

from ffl.identify.bayes.circle import invert_response
from ffl.identify.bayes.protocol import shifted
from ffl.identify.bayes.records import check_arrays
from ffl.identify.bayes.regularized import (
    RegularizedFit,
    forward_kernel,
    inverse_kernel,
    regularized_least_squares,
)


@dataclass(frozen=True)
class TwoStepFit:
    """Forward FIR model by (23) and its inverse, cut to the taps asked for."""

    theta: np.ndarray
    forward: RegularizedFit


def naive(
    u: np.ndarray, y: np.ndarray, n_ac: int, n_c: int, drop_edge: bool = False, refine: bool = False
) -> RegularizedFit:
    """(22): u regressed on the noisy y as if y were exact; biased towards small taps.

    (22) sums over t = 1..N, where the last n_ac rows need y beyond the record: zeros there give the
    paper's figure. `drop_edge` leaves those rows out, which is worth 3 points of fit. Before the
    record y is zero (rest).
    """
    u, y = check_arrays(u, y, n_ac + n_c)
    rows = len(y) - n_ac if drop_edge else len(y)
    regressors = shifted(y, n_ac, n_c, rows)
    return regularized_least_squares(regressors, u[:rows], inverse_kernel(n_ac, n_c), 2, refine)


def two_step(
    u: np.ndarray, y: np.ndarray, n_ac: int, n_c: int, n_f: int = 25, refine: bool = False
) -> TwoStepFit:
    """(23), then Theorem 1: forward FIR of n_f taps, inverted on the unit circle and cut."""
    u, y = check_arrays(u, y, n_f)
    regressors = toeplitz(u, np.zeros(n_f))
    forward = regularized_least_squares(regressors, y, forward_kernel(n_f), 1, refine)
    return TwoStepFit(invert_response(forward.theta, n_ac, n_c), forward)


def oracle(
    u: np.ndarray,
    x: np.ndarray,
    n_ac: int,
    n_c: int,
    rng: np.random.Generator,
    snr_db: float = 14.0,
) -> RegularizedFit:
    """The regression of `naive` where it is right: exact x, white noise on u instead.

    x must reach len(u) + n_ac. An upper mark for the table, not a method: nobody measures x.
    """
    rows = len(u)
    noisy = u + np.sqrt(np.var(u) * 10 ** (-snr_db / 10)) * rng.standard_normal(rows)
    regressors = shifted(x, n_ac, n_c, rows)
    return regularized_least_squares(regressors, noisy, inverse_kernel(n_ac, n_c), 2)

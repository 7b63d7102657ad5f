"""A record (u, y), checked, and reduced to a triangle so that nothing later costs N."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ffl.errors import InputError
from ffl.identify.bayes.circle import circle_jacobian, circle_response
from ffl.identify.regression import upper_triangle

_BLOCK = 2048


@dataclass(frozen=True)
class Record:
    """||y - U xi||^2 = ||target - factor xi||^2 + floor for every forward response xi.

    U, shape (n_samples, before + length), holds u(t - tau), tau = -before..length-1; factor is its
    triangular QR factor. The data enter every likelihood through this alone: O(N length^2) once,
    O(length^2) afterwards.

    With `before` = 0 this is (6) to (8) of the 2025 paper, which look at xi(t) for t >= 0 alone. The
    bounded inverse of theta has a part at t < 0 as well, which a causal machine has not, and which (8)
    leaves free: on 0.8 (z - 1.25)(z - 0.4) / ((z - 0.7)(z - 0.5)) with 20 + 20 taps its answer had
    xi(-1) = -0.5 beside xi(0) = 0.8, and 60 % error of 1/xi, at the right noise variance. With
    `before` = n_ac that part predicts y like the rest, and the data say that it is not there. More is
    not needed: at t < 0 xi obeys a recurrence over the roots outside the circle, n_ac at most.
    """

    u: np.ndarray
    y: np.ndarray
    factor: np.ndarray
    target: np.ndarray
    floor: float
    n_samples: int
    before: int = 0

    @property
    def length(self) -> int:
        """Samples of xi from t = 0 on."""
        return len(self.target) - self.before

    def response(self, theta: np.ndarray, n_ac: int) -> np.ndarray:
        """xi(-before..length-1) of the taps -n_ac.. of the inverse."""
        return circle_response(theta, n_ac, self.length, before=self.before)

    def jacobian(self, theta: np.ndarray, n_ac: int) -> tuple[np.ndarray, np.ndarray]:
        """`response`, and its derivative, shape (before + length, n_taps)."""
        return circle_jacobian(theta, n_ac, self.length, self.before)

    def misfit(self, xi: np.ndarray) -> float:
        return float(np.sum((self.target - self.factor @ xi) ** 2) + self.floor)


def check_arrays(u: ArrayLike, y: ArrayLike, n_parameters: int) -> tuple[np.ndarray, np.ndarray]:
    """u and y as float vectors, or an `InputError` that says what is wrong with them."""
    u, y = np.asarray(u, float), np.asarray(y, float)
    if u.ndim != 1 or y.ndim != 1:
        raise InputError(f"u and y must be vectors; their shapes are {u.shape} and {y.shape}")
    if len(u) != len(y):
        raise InputError(
            f"u has {len(u)} samples and y has {len(y)}: give both on the same instants"
        )
    for name, signal in (("u", u), ("y", y)):
        bad = np.flatnonzero(~np.isfinite(signal))
        if len(bad):
            raise InputError(
                f"{name}[{bad[0]}] is {signal[bad[0]]} ({len(bad)} such samples): cut or mend them"
            )
    if len(y) <= 2 * n_parameters:
        raise InputError(
            f"{len(y)} samples cannot carry a model of {n_parameters} taps: record at least "
            f"{2 * n_parameters + 1}, or take fewer taps"
        )
    for name, signal in (("u", u), ("y", y)):
        if np.ptp(signal) <= 1e-12 * np.abs(signal).max():
            raise InputError(f"{name} is constant over all {len(u)} samples: it says nothing")
    return u, y


def reduce_record(
    u: np.ndarray, y: np.ndarray, length: int, at_rest: bool = True, before: int = 0
) -> Record:
    """QR of the convolution matrix in blocks of rows: memory O(length^2), never N x N.

    `at_rest`: u was zero and the system at rest before the first sample, every row counts. If not,
    the first `length` rows, which the unknown past reaches, are dropped. After the record u is taken
    as zero, which concerns the last `before` rows and what should not be there.
    """
    first, width = (0 if at_rest else length - 1), before + length
    padded = np.concatenate([np.zeros(length - 1), u, np.zeros(before)])
    rows = np.lib.stride_tricks.sliding_window_view(padded, width)[first:, ::-1]
    y_used = y[first:]
    if len(y_used) <= length and not at_rest:
        raise InputError(
            f"{len(u)} samples with an unknown start leave {len(y_used)} rows for a forward "
            f"response of {length} samples: record more, or start at rest"
        )
    scratch = np.zeros((0, width + 1))
    for begin in range(0, len(y_used), _BLOCK):
        block = np.column_stack([rows[begin : begin + _BLOCK], y_used[begin : begin + _BLOCK]])
        scratch = upper_triangle(np.vstack([scratch, block]))
    top = np.zeros((width + 1, width + 1))
    top[: len(scratch)] = scratch
    factor = np.ascontiguousarray(top[:width, :width])
    floor = float(top[width, -1] ** 2)
    return Record(u, y, factor, top[:width, -1].copy(), floor, len(y_used), before)

"""A record (u, y), checked, and reduced to a triangle so that nothing later costs N."""

from dataclasses import dataclass

import numpy as np

from ffl.errors import InputError

_BLOCK = 2048


@dataclass(frozen=True)
class Record:
    """||y - U xi||^2 = ||target - factor xi||^2 + floor for every forward response xi.

    U, shape (n_samples, length), holds u(t - tau); factor is its triangular QR factor. The data
    enter every likelihood through this alone: O(N length^2) once, O(length^2) afterwards.
    """

    u: np.ndarray
    y: np.ndarray
    factor: np.ndarray
    target: np.ndarray
    floor: float
    n_samples: int

    @property
    def length(self) -> int:
        return len(self.target)

    def misfit(self, xi: np.ndarray) -> float:
        return float(np.sum((self.target - self.factor @ xi) ** 2) + self.floor)


def check_arrays(u: np.ndarray, y: np.ndarray, n_parameters: int) -> tuple[np.ndarray, np.ndarray]:
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


def reduce_record(u: np.ndarray, y: np.ndarray, length: int, at_rest: bool = True) -> Record:
    """QR of the convolution matrix in blocks of rows: memory O(length^2), never N x N.

    `at_rest`: u was zero and the system at rest before the first sample, every row counts. If not,
    the first `length` rows, which the unknown past reaches, are dropped.
    """
    first = 0 if at_rest else length - 1
    padded = np.concatenate([np.zeros(length - 1), u])
    rows = np.lib.stride_tricks.sliding_window_view(padded, length)[first:, ::-1]
    y_used = y[first:]
    if len(y_used) <= length and not at_rest:
        raise InputError(
            f"{len(u)} samples with an unknown start leave {len(y_used)} rows for a forward "
            f"response of {length} samples: record more, or start at rest"
        )
    scratch = np.zeros((0, length + 1))
    for begin in range(0, len(y_used), _BLOCK):
        block = np.column_stack([rows[begin : begin + _BLOCK], y_used[begin : begin + _BLOCK]])
        scratch = np.linalg.qr(np.vstack([scratch, block]), mode="r")
    top = np.zeros((length + 1, length + 1))
    top[: len(scratch)] = scratch
    factor = np.ascontiguousarray(top[:length, :length])
    return Record(u, y, factor, top[:length, -1].copy(), float(top[length, -1] ** 2), len(y_used))

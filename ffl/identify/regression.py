"""Backward regression: target(t) = sum_{k=-n_ac..n_c} theta_k output(t - k) + v(t), equation (2).

The regressor is Toeplitz, so it is never stored: products run through the FFT in O(N log N), and a
blockwise QR reduces any record to a triangle of the model's size.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy.fft
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from ffl.errors import InputError
from ffl.systems.checked import checked

Array = NDArray[np.float64]

PROTOCOLS = ("drop", "zero", "hold", "known")
BLOCK_ROWS = 2048
RANK_TOLERANCE = 1e-12


@dataclass(frozen=True)
class Edges:
    """What is assumed of the output beyond its first and last recorded sample.

    "drop": nothing; rows that would need unknown samples are left out. "zero": it is zero there (a
    machine at rest at the origin). "hold": it keeps its first or last value (at rest elsewhere).
    "known": the recording must reach far enough (give more output than target, and `lead`).
    `skip_before` and `skip_after` drop that many rows more: with "zero" at an end that is not at
    rest, dropping as many rows as the inverse has large anti-causal taps removes nearly all harm.
    """

    before: str = "drop"
    after: str = "drop"
    skip_before: int = 0
    skip_after: int = 0

    def __post_init__(self) -> None:
        for name in ("before", "after"):
            if getattr(self, name) not in PROTOCOLS:
                raise InputError(f"edges.{name} = {getattr(self, name)!r} is none of {PROTOCOLS}")
        if min(self.skip_before, self.skip_after) < 0:
            raise InputError("edges: skip_before and skip_after must be 0 or more rows")


class Rows(Protocol):
    """Rows of a regression, whole or reduced: what estimation needs of the data."""

    @property
    def target(self) -> Array:
        """Right-hand side, one value a row."""

    @property
    def n_rows(self) -> int:
        """Rows of the record, also those that a reduction has folded into `rest`."""

    @property
    def rest(self) -> float:
        """Squares of the target that no parameter can explain and that `target` no longer holds."""

    def apply(self, columns: Array) -> Array:
        """Phi columns."""

    def transpose(self, columns: Array) -> Array:
        """Phi^T columns."""


@dataclass(frozen=True)
class Triangle:
    """QR of the regression: Phi = Q r, target = Q z + what lies outside, of squared norm `rest`.

    Keeps everything that least squares, kernels and evidence ask of the data, in O(n^2).
    """

    r: Array
    target: Array
    rest: float
    n_rows: int

    def apply(self, columns: Array) -> Array:
        return self.r @ columns

    def transpose(self, columns: Array) -> Array:
        return self.r.T @ columns


@dataclass(frozen=True)
class Regression:
    """Rows of equation (2) that the edge protocol keeps.

    `output` holds the samples t = first - n_c .. last + n_ac of the regressor, `target` the rows
    first .. last (indices into the recording).
    """

    output: Array
    target: Array
    n_ac: int
    n_c: int
    first: int
    n_samples: int
    edges: Edges
    rest: float = 0.0

    @property
    def n_rows(self) -> int:
        return len(self.target)

    @property
    def n_taps(self) -> int:
        return self.n_ac + self.n_c + 1

    @property
    def lags(self) -> Array:
        """k = -n_ac .. n_c."""
        return np.arange(-self.n_ac, self.n_c + 1, dtype=float)

    @property
    def says(self) -> str:
        """The edge protocol and what it cost, in words."""
        words = {
            "drop": "unknown, rows dropped",
            "zero": "taken as zero",
            "hold": "held at the outermost sample",
            "known": "recorded",
        }
        return (
            f"rows {self.first}..{self.first + self.n_rows - 1} of {self.n_samples} used; output "
            f"before: {words[self.edges.before]}; after: {words[self.edges.after]}"
        )

    def matrix(self, start: int = 0, stop: int | None = None) -> Array:
        """Rows start .. stop of Phi, dense: for blocks and for test oracles."""
        stop = self.n_rows if stop is None else stop
        part = self.output[start : stop + self.n_taps - 1]
        return np.lib.stride_tricks.sliding_window_view(part, self.n_taps)[:, ::-1]

    @cached_property
    def _spectrum(self) -> tuple[int, NDArray[np.complex128]]:
        length = scipy.fft.next_fast_len(len(self.output), real=True)
        return length, scipy.fft.rfft(self.output, length)

    def apply(self, columns: Array) -> Array:
        """Phi columns in O(p N log N): the valid part of a convolution with the output."""
        length, spectrum = self._spectrum
        flat = np.ascontiguousarray(np.atleast_2d(columns.T))
        product = scipy.fft.irfft(scipy.fft.rfft(flat, length) * spectrum, length)
        rows = product[:, self.n_taps - 1 : self.n_taps - 1 + self.n_rows].T
        return rows[:, 0] if columns.ndim == 1 else rows

    def transpose(self, columns: Array) -> Array:
        """Phi^T columns in O(p N log N): a correlation with the output."""
        length, spectrum = self._spectrum
        flat = np.ascontiguousarray(np.atleast_2d(columns.T))
        product = scipy.fft.irfft(scipy.fft.rfft(flat, length).conj() * spectrum, length)
        taps = product[:, self.n_taps - 1 :: -1].T
        return taps[:, 0] if columns.ndim == 1 else taps

    @cached_property
    def triangle(self) -> Triangle:
        """The same rows reduced by QR, block after block: O(N n^2) time, O(n^2) memory."""
        stack = np.zeros((0, self.n_taps + 1))
        for start in range(0, self.n_rows, BLOCK_ROWS):
            stop = min(start + BLOCK_ROWS, self.n_rows)
            block = np.column_stack([self.matrix(start, stop), self.target[start:stop]])
            stack = upper_triangle(np.vstack([stack, block]))
        n = min(self.n_rows, self.n_taps)
        corner = stack[n, -1] if len(stack) > n else 0.0
        return Triangle(
            np.ascontiguousarray(stack[:n, :-1]), stack[:n, -1], float(corner**2), self.n_rows
        )


def upper_triangle(matrix: Array) -> Array:
    """R of a QR, Q never formed."""
    return np.asarray(np.linalg.qr(matrix, mode="r"))


def backward_regression(
    output: ArrayLike,
    target: ArrayLike,
    n_ac: int,
    n_c: int,
    edges: Edges = Edges(),
    lead: int | None = None,
) -> Regression:
    """Rows of equation (2) from a record of `target` (N samples) and `output`.

    `lead` output samples come before the first target sample (None: both have N samples); output
    may also run on beyond the last. Raises `InputError` for unequal lengths, NaN, a constant output,
    and a record shorter than the model.
    """
    y, r = checked(output, "output"), checked(target, "target")
    n = len(r)
    if n_ac < 0 or n_c < 0:
        raise InputError(f"n_ac = {n_ac} and n_c = {n_c} must be 0 or more taps")
    if lead is None:
        if len(y) != n:
            raise InputError(
                f"output has {len(y)} samples and target {n}: give equal lengths, or say with `lead` "
                "how many output samples come before the first target sample"
            )
        lead = 0
    trail = len(y) - lead - n
    if lead < 0 or trail < 0:
        raise InputError(f"output has {len(y)} samples, lead = {lead}, target {n}: output is short")
    if n < n_ac + n_c + 1:
        raise InputError(
            f"{n} samples are fewer than the model's {n_ac + n_c + 1} taps; record longer or lower "
            "n_ac and n_c"
        )
    if not np.ptp(y) > 0:
        raise InputError("output is constant: it excites nothing; record a machine that moves")
    if not np.any(r):
        raise InputError("target is zero throughout: there is nothing to identify")
    front, first = _edge(y[0], edges.before, n_c - lead, "before")
    back, dropped = _edge(y[-1], edges.after, n_ac - trail, "after")
    first += edges.skip_before
    last = n - dropped - edges.skip_after
    if last - first < 1:
        raise InputError(
            f"edges: {n} samples leave no row for n_ac = {n_ac}, n_c = {n_c}; shorten the model or "
            "let the edges be zero, hold or known"
        )
    whole = np.concatenate([front, y, back])
    offset = lead + len(front)  # index in `whole` of target sample 0
    return Regression(
        whole[offset + first - n_c : offset + last + n_ac],
        r[first:last],
        n_ac,
        n_c,
        first,
        n,
        edges,
    )


def _edge(value: float, protocol: str, missing: int, side: str) -> tuple[Array, int]:
    """Samples to pad with, and rows to drop, where `missing` samples are not recorded."""
    if missing <= 0:
        return np.zeros(0), 0
    if protocol == "known":
        raise InputError(
            f'edges.{side} = "known", but {missing} output samples are missing; record longer or '
            'choose "drop", "zero" or "hold"'
        )
    if protocol == "drop":
        return np.zeros(0), missing
    return np.full(missing, value if protocol == "hold" else 0.0), 0


def least_squares(regression: Regression) -> Array:
    """theta of equation (3) by QR, shape (n_ac + n_c + 1,).

    Raises `InputError` where the output does not excite all taps, with the rank in words.
    """
    triangle = regression.triangle
    n = regression.n_taps
    if triangle.r.shape[0] < n:
        raise InputError(
            f"the edges leave {regression.n_rows} rows for {n} taps; record longer, shorten the "
            "model, or use a kernel"
        )
    reciprocal, _ = scipy.linalg.lapack.dtrcon(triangle.r, norm="1", uplo="U")
    if reciprocal < RANK_TOLERANCE:
        refuse_rank(triangle.r)
    return scipy.linalg.solve_triangular(triangle.r, triangle.target)


def refuse_rank(r: Array) -> None:
    """Raises `InputError` where the triangle is singular to `RANK_TOLERANCE`."""
    singular = np.linalg.svd(r, compute_uv=False)
    rank = int(np.sum(singular > RANK_TOLERANCE * singular[0]))
    if rank < r.shape[1]:
        raise InputError(
            f"the output excites only {rank} of {r.shape[1]} directions of the model (relative "
            f"singular values below {RANK_TOLERANCE:g}); excite more frequencies, shorten the model, "
            "or use a kernel"
        )

"""One known two-sided filter as a basis: an identified inverse, whose gain the trials learn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ffl.bases.base import Basis
from ffl.errors import InputError
from ffl.systems.state_space import Array, ComplexArray


class Filter(Basis):
    """psi(r)(t) = sum_k taps[k] r(t - first - k): one parameter, the gain, 1 where F is P^-1.

    `first` is the lag of the first tap, negative where the filter looks ahead; `ffl identify` writes
    both into basis.toml (2018 kernel paper, (1)). Cost O(N log n) for n taps.
    """

    in_samples = True

    def __init__(self, taps: Sequence[float], first: int = 0, sample_time: float = 1.0) -> None:
        self.taps = np.asarray(taps, float)
        if self.taps.ndim != 1 or not self.taps.size or not np.all(np.isfinite(self.taps)):
            raise InputError("filter: taps must be a list of finite numbers, at least one")
        if isinstance(first, bool) or int(first) != first:
            raise InputError(f"filter: first = {first} must be a whole number of samples")
        self.first = int(first)
        self.sample_time = float(sample_time)

    @property
    def names(self) -> list[str]:
        return ["gain"]

    @property
    def preview(self) -> int:
        return max(0, -self.first)

    def regressors(self, reference: ArrayLike) -> Array:
        from scipy.signal import oaconvolve  # half of a command's start-up time: only where needed

        r = np.asarray(reference, float)
        reach = len(self.taps) + abs(self.first)
        held = np.pad(r, reach, mode="edge")
        whole = oaconvolve(held, self.taps)  # whole[m] belongs to lag m - reach + first of r
        start = reach - self.first
        return whole[start : start + len(r), None]

    def response(self, frequencies_hz: ArrayLike) -> ComplexArray:
        lags = self.first + np.arange(len(self.taps))
        f = np.atleast_1d(np.asarray(frequencies_hz, float))
        return (np.exp(-2j * np.pi * np.outer(f, lags) * self.sample_time) @ self.taps)[:, None]

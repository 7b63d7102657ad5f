"""Finite impulse response with preview: psi_k = z^-k."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ffl.bases.arguments import check_arguments, check_size
from ffl.bases.base import Basis
from ffl.errors import InputError
from ffl.systems.state_space import Array, ComplexArray


class FIR(Basis):
    """psi_k = z^-k for k = -preview .. lag (2018 printer paper, section IV: k in [-3, 6]).

    `delays` places the taps freely instead: any whole numbers of samples, negative ones ahead.
    """

    in_samples = True

    def __init__(
        self,
        preview: int = 0,
        lag: int = 0,
        delays: list[int] | None = None,
        sample_time: float = 1.0,
    ) -> None:
        check_arguments(type(self), {"preview": preview, "lag": lag}, "fir")
        if delays is None:
            if preview < 0 or lag < 0:
                raise InputError(f"fir: preview = {preview}, lag = {lag} must not be negative")
            check_size(preview + lag + 1, f"fir: preview = {preview}, lag = {lag}")
            delays = list(range(-preview, lag + 1))
        elif preview or lag:
            raise InputError("fir: give either 'delays' or 'preview' and 'lag', not both")
        if not delays or len(set(delays)) != len(delays) or any(int(k) != k for k in delays):
            raise InputError(
                f"fir: delays = {delays} must be different whole numbers, at least one"
            )
        self.delays = sorted(int(k) for k in delays)
        self.sample_time = float(sample_time)

    @property
    def names(self) -> list[str]:
        return [f"q^{-k}" for k in self.delays]

    @property
    def preview(self) -> int:
        return max(0, -self.delays[0])

    def regressors(self, reference: ArrayLike) -> Array:
        r = np.asarray(reference, float)
        reach = max(abs(self.delays[0]), abs(self.delays[-1]))
        if len(r) <= reach:
            raise InputError(
                f"fir: the reference has {len(r)} samples, the taps reach {reach}; "
                "lengthen the reference or shorten preview and lag"
            )
        padded = np.pad(r, reach, mode="edge")
        return np.column_stack([padded[reach - k : reach - k + len(r)] for k in self.delays])

    def response(self, frequencies_hz: ArrayLike) -> ComplexArray:
        f = np.atleast_1d(np.asarray(frequencies_hz, float))
        return np.exp(-2j * np.pi * np.outer(f, self.delays) * self.sample_time)

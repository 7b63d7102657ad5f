"""What a feedforward parametrization is: f = F(theta) r = sum_k theta_k psi_k(r)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ffl.systems.state_space import Array, ComplexArray

UNSTATED = 1.0  # sample time of a basis that was given none: its seconds are samples


class Basis(ABC):
    """A parametrization that is linear in theta (2018 printer paper, Definition 1, equation (4)).

    The reference is at rest before its first and after its last sample: it stays at those values.
    """

    sample_time: float
    in_samples: ClassVar[bool] = False  # it needs no sample time but for its frequency response

    @property
    @abstractmethod
    def names(self) -> list[str]:
        """One name per parameter."""

    @property
    def n_parameters(self) -> int:
        return len(self.names)

    @abstractmethod
    def regressors(self, reference: ArrayLike) -> Array:
        """psi_k(r), shape (N, n_parameters), for the reference of N samples."""

    @property
    def stated(self) -> Array:
        """(n_parameters,) what the parameters are known to be before any trial; NaN: not known."""
        return np.full(self.n_parameters, np.nan)

    def response(self, frequencies_hz: ArrayLike) -> ComplexArray | None:
        """Psi(exp(i 2 pi f T)), shape (F, n_parameters); None where the basis is not LTI."""
        return None

    @property
    def preview(self) -> int:
        """Samples of the future that a finite basis looks ahead (0 for causal, -1 for infinite)."""
        return 0


class SumBasis(Basis):
    """Several bases side by side."""

    def __init__(self, parts: Sequence[Basis]) -> None:
        self.parts = tuple(parts)
        self.sample_time = self.parts[0].sample_time

    @property
    def names(self) -> list[str]:
        return [name for part in self.parts for name in part.names]

    @property
    def preview(self) -> int:
        previews = [part.preview for part in self.parts]
        return -1 if -1 in previews else max(previews)

    @property
    def stated(self) -> Array:
        return np.concatenate([part.stated for part in self.parts])

    def regressors(self, reference: ArrayLike) -> Array:
        return np.hstack([part.regressors(reference) for part in self.parts])

    def response(self, frequencies_hz: ArrayLike) -> ComplexArray | None:
        responses = [part.response(frequencies_hz) for part in self.parts]
        known = [response for response in responses if response is not None]
        return np.hstack(known) if len(known) == len(responses) else None

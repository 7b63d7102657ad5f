"""A basis with known parameters as one function: a learned or identified filter carried over."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ffl.bases.base import Basis
from ffl.errors import InputError
from ffl.systems.state_space import Array, ComplexArray


class Combination(Basis):
    """psi(r) = `basis`(r) theta: one parameter, the gain, that the trials learn."""

    in_samples = True  # its own basis is asked

    def __init__(self, basis: Basis, theta: Sequence[float], sample_time: float = 1.0) -> None:
        self.basis, self.theta = basis, np.asarray(theta, float)
        if self.theta.shape != (basis.n_parameters,) or not np.all(np.isfinite(self.theta)):
            raise InputError(
                f"combination: theta has shape {self.theta.shape}; its basis wants "
                f"{basis.n_parameters} finite numbers"
            )
        self.sample_time = float(sample_time)

    @property
    def names(self) -> list[str]:
        return ["gain"]

    @property
    def preview(self) -> int:
        return self.basis.preview

    def regressors(self, reference: ArrayLike) -> Array:
        return (self.basis.regressors(reference) @ self.theta)[:, None]

    def response(self, frequencies_hz: ArrayLike) -> ComplexArray | None:
        psi = self.basis.response(frequencies_hz)
        return None if psi is None else (psi @ self.theta)[:, None]

"""The feedforward signal itself: one parameter per sample, learned without an N x N matrix."""

from __future__ import annotations

from numpy.typing import ArrayLike

from ffl.bases.base import Basis
from ffl.errors import InputError
from ffl.systems.state_space import Array


class FreeSignal(Basis):
    """f(t) = theta_t: classical norm-optimal iterative learning control.

    It has no regressor matrix (that would be N x N); `ffl.learn` solves it by a Riccati recursion.
    What it learns belongs to one reference and does not carry over to another.
    """

    in_samples = True

    def __init__(self, sample_time: float = 1.0) -> None:
        self.sample_time = float(sample_time)

    @property
    def names(self) -> list[str]:
        return ["f"]

    @property
    def preview(self) -> int:
        return -1

    def regressors(self, reference: ArrayLike) -> Array:
        raise InputError(
            "free: the signal itself has no regressor matrix; use update = 'auto' or 'riccati'"
        )

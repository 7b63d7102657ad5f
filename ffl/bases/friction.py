"""Dry-friction feedforward: the sign of the reference's velocity."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ffl.bases.base import Basis
from ffl.bases.derivatives import derivative
from ffl.errors import InputError
from ffl.systems.state_space import Array

STANDS = 1e-9  # of the fastest |v|: what rounding leaves where the reference stands


class Friction(Basis):
    """f = level sign(v), with v the velocity of the reference; where it stands, f = 0: |v| within
    `STANDS` of its largest value, which rounding alone leaves.

    `asymmetric` gives each direction a level of its own (both positive where friction opposes the
    motion). `velocity`, in reference units per second, is the speed below which the step is
    replaced by a line through zero, sat(v / velocity), where a jump in f is not wanted; 0: a step.
    Not linear and time-invariant: `response` is None.
    """

    def __init__(
        self, asymmetric: bool = False, velocity: float = 0.0, sample_time: float = 1.0
    ) -> None:
        if not (np.isfinite(velocity) and velocity >= 0):
            raise InputError(f"friction: velocity = {velocity} must not be negative")
        self.asymmetric = bool(asymmetric)
        self.velocity = float(velocity)
        self.sample_time = float(sample_time)

    @property
    def names(self) -> list[str]:
        return ["sign_positive", "sign_negative"] if self.asymmetric else ["sign"]

    @property
    def preview(self) -> int:
        return 1

    def regressors(self, reference: ArrayLike) -> Array:
        v = derivative(reference, 1, self.sample_time)
        fastest = float(np.abs(v).max(initial=0.0))
        if self.velocity > 0:
            sign = np.clip(v / self.velocity, -1.0, 1.0)
        else:
            sign = np.where(np.abs(v) > STANDS * fastest, np.sign(v), 0.0)
        if self.asymmetric:
            return np.column_stack([np.maximum(sign, 0.0), np.minimum(sign, 0.0)])
        return sign[:, None]

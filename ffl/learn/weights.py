"""Weights of criterion (3): scalars, one value per sample, or frequency-shaping filters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ffl.errors import InputError
from ffl.systems.state_space import Array, StateSpace
from ffl.systems.zpk import Zpk

Weight = float | NDArray[np.float64] | Zpk


def apply_weight(weight: Weight, signals: ArrayLike) -> Array:
    """W^(1/2) times the columns of `signals` (N,) or (N, n); a filter G means W = G^T G."""
    s = np.asarray(signals, float)
    if isinstance(weight, Zpk):
        ss = weight.state_space()
        return ss.filter(s) if s.ndim == 1 else ss.filter_columns(s)
    root = np.sqrt(np.asarray(weight, float))
    return root * s if root.ndim == 0 or s.ndim == 1 else root[:, None] * s


def is_zero(weight: Weight) -> bool:
    return not isinstance(weight, Zpk) and not np.any(weight)


def as_filter(weight: Weight, sample_time: float) -> tuple[StateSpace, Array | None]:
    """The weight as a filter with per-sample squared factors (None: one): for the recursion."""
    if isinstance(weight, Zpk):
        return weight.state_space(), None
    value = np.asarray(weight, float)
    none = np.zeros((0, 0))
    scale = float(np.sqrt(value)) if value.ndim == 0 else 1.0
    gain = StateSpace(none, none.reshape(0, 1), none.reshape(1, 0), scale, sample_time)
    return gain, value if value.ndim else None


@dataclass(frozen=True)
class Weights:
    """W_e, W_f and W_df of V = |e|^2_We + |f|^2_Wf + |f - f_j|^2_Wdf (2018 printer paper, (3)).

    The norms are read as weighted squared 2-norms, |x|^2_W = x^T W x. Each weight is a scalar (times
    the identity), a vector with one value per sample (a diagonal), or a stable `Zpk` filter G
    (W = G^T G, with G's lower-triangular Toeplitz matrix). W_e must be positive somewhere: where it is
    zero the error does not count. W_f and W_df may be zero. The criterion is convex and bounded below
    with any of them; what it leaves open, a basis leaves at zero, and the free signal refuses.
    """

    error: Weight = 1.0
    feedforward: Weight = 0.0
    feedforward_change: Weight = 0.0

    def __post_init__(self) -> None:
        for name in ("error", "feedforward", "feedforward_change"):
            weight = getattr(self, name)
            if isinstance(weight, Zpk):
                if not weight.is_stable or weight.relative_degree < 0:
                    raise InputError(f"weights.{name}: the filter must be causal and stable")
                continue
            value = np.asarray(weight, float)
            if value.ndim > 1 or value.size == 0 or not np.all(np.isfinite(value)):
                raise InputError(f"weights.{name}: give a number, a list of numbers or a filter")
            lowest = float(value.min(initial=np.inf))
            if lowest < 0:
                raise InputError(f"weights.{name} = {lowest:g} must not be negative")
            if name == "error" and not np.any(value > 0):
                kind = "must be positive" if value.ndim == 0 else "must be positive at some sample"
                raise InputError(f"weights.error = 0 {kind}")
            object.__setattr__(self, name, float(value) if value.ndim == 0 else value)

    def check_length(self, n: int) -> None:
        """Raises `InputError` where a vector does not have one value per sample."""
        for name in ("error", "feedforward", "feedforward_change"):
            weight = getattr(self, name)
            if isinstance(weight, np.ndarray) and weight.size != n:
                raise InputError(
                    f"weights.{name} has {weight.size} values, the reference {n} samples; "
                    "give one value per sample or a single number"
                )

    def cost(self, error: ArrayLike, feedforward: ArrayLike, change: ArrayLike) -> float:
        """Criterion (3) in squared output and input units."""
        terms = (
            (self.error, error),
            (self.feedforward, feedforward),
            (self.feedforward_change, change),
        )
        return float(sum(np.sum(apply_weight(w, s) ** 2) for w, s in terms if not is_zero(w)))

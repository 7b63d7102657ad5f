"""Signals as callers give them, checked at the border."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ffl.errors import InputError
from ffl.systems.state_space import Array


def checked(values: ArrayLike, name: str, n: int | None = None) -> Array:
    """`values` as a finite one-dimensional signal, of `n` samples where that is given; raises `InputError`
    that names it otherwise."""
    try:
        signal = np.asarray(values, float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is not a numeric array: {error}") from error
    if signal.ndim != 1:
        raise InputError(f"{name} has shape {signal.shape}; give one column, shape (N,)")
    if n is not None and len(signal) != n:
        raise InputError(f"{name} has {len(signal)} numbers; give {n}")
    bad = np.flatnonzero(~np.isfinite(signal))
    if bad.size:
        raise InputError(
            f"{name}: {bad.size} samples are NaN or infinite, the first at index {bad[0]}; "
            "repair or cut the recording"
        )
    return signal

"""What every estimator shares: the constructor stores, `fit` learns, learned names end in `_`."""

from __future__ import annotations

import inspect
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ffl.errors import InputError
from ffl.systems.checked import checked

Array = NDArray[np.float64]


class Estimator:
    """Constructor arguments as parameters, so that `sklearn.base.clone` and grid searches work."""

    @classmethod
    def _names(cls) -> list[str]:
        return [name for name in inspect.signature(cls.__init__).parameters if name != "self"]

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Constructor arguments by name."""
        return {name: getattr(self, name) for name in self._names()}

    def set_params(self, **params: Any) -> Self:
        """Replaces constructor arguments; nothing is learned until `fit`."""
        for name, value in params.items():
            if name not in self._names():
                raise InputError(
                    f"{type(self).__name__} has no parameter {name!r}; it has {self._names()}"
                )
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        inner = ", ".join(f"{name}={value!r}" for name, value in self.get_params().items())
        return f"{type(self).__name__}({inner})"

    def _learned(self, name: str) -> Any:
        if not hasattr(self, name):
            raise InputError(f"{type(self).__name__} has learned nothing yet; call fit first")
        return getattr(self, name)


def signals(data: Any, target: ArrayLike | None) -> tuple[Array, Array, float]:
    """Output, target and sample time of a recording (y and u) or of two arrays."""
    if target is None:
        if not (hasattr(data, "y") and hasattr(data, "u")):
            raise InputError("fit: give a recording with u and y, or two arrays (output, target)")
        output, target, sample_time = data.y, force(data), float(data.sample_time)
    else:
        output, sample_time = data, 1.0
    return checked(output, "output"), checked(target, "target"), sample_time


def force(recording: Any) -> Any:
    """What drives the plant, u + d with the known load where there is one, or an `InputError` where
    the file had no u and nothing in it gives it."""
    if "u" in getattr(recording, "missing", ()) and not np.all(np.isfinite(recording.u)):
        source = getattr(recording, "source", "") or "recording"
        raise InputError(
            f"{source}: the command u is not recorded, and an inverse is learned from it; record u "
            "too, or name its column in a mapping"
        )
    load = getattr(recording, "d", None)
    total = recording.u if load is None else recording.u + load
    if np.ptp(total) == 0:
        raise InputError(
            "the command u is constant, so nothing can be identified; record one that moves"
        )
    return total

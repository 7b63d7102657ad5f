"""Bounds of the update: on f, its rate, the predicted command and the parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ffl.errors import InputError

Bound = float | tuple[float, float] | list[float] | NDArray[np.float64] | None
Limits = tuple[NDArray[np.float64], NDArray[np.float64]]


def known_command(command: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """u_j (N,), from which the next command is predicted; raises `InputError` where it is not known,
    since a value that is not a number would lie within every bound."""
    if command is None or not np.all(np.isfinite(command)):
        raise InputError(
            "constraints.command bounds the next command, predicted from the trial's command u, which "
            "is not known; record u, or leave the bound out"
        )
    return command


@dataclass(frozen=True)
class Constraints:
    """Bounds that hold at every sample of the next trial.

    feedforward: on f, input units. feedforward_rate: on (f(t) - f(t-1))/T, input units per s, for t
    from 1 on: the first sample is free.
    command: on u = u_j + S (f - f_j), predicted from the model, input units. parameters: on theta.
    Each is a number b (-b .. b), a pair [low, high], or an array (2, N): lows and highs.
    """

    feedforward: Bound = None
    feedforward_rate: Bound = None
    command: Bound = None
    parameters: Bound = None

    NAMES = ("feedforward", "feedforward_rate", "command", "parameters")

    @property
    def any(self) -> bool:
        return any(getattr(self, name) is not None for name in self.NAMES)

    def limits(self, name: str, n: int) -> Limits:
        """Lower and upper bound of `name`, shape (n,) each; raises `InputError` where they cross."""
        bound = np.asarray(getattr(self, name), float)
        if bound.ndim == 0:
            if not bound > 0:
                raise InputError(
                    f"constraints.{name} = {float(bound):g} must be positive; "
                    "give [low, high] for bounds that are not symmetric"
                )
            low, high = np.full(n, -bound), np.full(n, bound)
        elif bound.shape == (2,):
            low, high = np.full(n, bound[0]), np.full(n, bound[1])
        elif bound.shape == (2, n):
            low, high = bound[0].copy(), bound[1].copy()
        else:
            raise InputError(
                f"constraints.{name} has shape {bound.shape}; give a number, [low, high], "
                f"or lows and highs of {n} values each"
            )
        if np.isnan(low).any() or np.isnan(high).any():
            raise InputError(f"constraints.{name} holds NaN; give numbers")
        if np.any(low > high):
            at = int(np.argmax(low > high))
            raise InputError(
                f"constraints.{name}: lower bound {low[at]:g} lies above upper bound {high[at]:g} "
                f"(entry {at}); exchange them"
            )
        return low, high

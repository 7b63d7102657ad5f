"""Harmonics of a cogging: tried once the cogging stands, each kept as long as it pays.

A magnet track's force is no pure sine. What its harmonics leave repeats along the position too, and
would otherwise be said a second time, as a ripple of the scale or another cogging of half the period.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ffl.diagnose.fit import Scene
from ffl.diagnose.judging import Judged, judge, levelled
from ffl.diagnose.model import Model
from ffl.diagnose.screen import orthonormal
from ffl.effects.periods import harmonics

NAME = "cogging"
MOST = 4  # the fundamental counted
GLIMPSE = 0.1  # of the fundamental's amplitude: what is simulated to see where a harmonic would act
LEAST = 3.0  # score that a harmonic must bring, its two numbers charged


def with_harmonics(
    quiet: Scene, held: Scene | None, judged: Judged, say: Callable[[str], None]
) -> Judged:
    """`judged` with the harmonics of its cogging that pay in the fitted and the held-out recordings
    together, up to the fourth; one that brings nothing ends the search."""
    current = judged
    while NAME in current.model.names:
        order = len(harmonics(_values(current.model))) + 1
        if order > MOST:
            break
        start = _started(quiet, current, order)
        if start is None:
            break
        other = judge(quiet, held, start, 6, current.fit)
        a, b = levelled([other, current])
        say(
            f"  harmonic {order} of {NAME}: {a.fitted - b.fitted:+.1f} fitted, "
            f"{a.held_out - b.held_out:+.1f} held out"
        )
        if a.score < b.score + LEAST or not _values(other.model)[f"amplitude_{order}"]:
            break
        current = other
    return current


def _started(scene: Scene, judged: Judged, order: int) -> Model | None:
    """The model with the harmonic that first order asks for beside the numbers that are free."""
    base = scene.residuals(judged.model)
    if base is None:
        return None
    size = GLIMPSE * _values(judged.model)["amplitude"]
    columns = []
    for phase in (0.0, 0.5 * np.pi):
        moved = scene.residuals(_with(judged.model, order, size, phase))
        if moved is None:
            return None
        columns.append(scene.whiten([b - m for b, m in zip(base, moved, strict=True)]))
    free = orthonormal(scene.whiten_stacked(judged.fit.columns))
    table, white = np.column_stack(columns), scene.whiten(base)
    table, white = table - free @ (free.T @ table), white - free @ (free.T @ white)
    sine, cosine = np.linalg.lstsq(table, white, rcond=1e-12)[0]
    return _with(
        judged.model, order, size * float(np.hypot(sine, cosine)), float(np.arctan2(cosine, sine))
    )


def _values(model: Model) -> dict[str, float]:
    return dict(model.effects[model.names.index(NAME)].parameters)


def _with(model: Model, order: int, amplitude: float, phase: float) -> Model:
    index = model.names.index(NAME)
    values = {**_values(model), f"amplitude_{order}": amplitude, f"phase_{order}": phase}
    return model.with_parameters(index, values)

"""Harmonics of what repeats along the position: tried once it stands, each kept as long as it pays.

A magnet track's force is no pure sine, nor is what an encoder's tracks add. What the harmonics leave
repeats along the position too, and would otherwise be said a second time, as a ripple of the scale
beside a cogging, or as a cogging of half the period beside a ripple.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ffl.diagnose.contest.judging import Judged, judge, levelled, raw_error
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.span import orthonormal
from ffl.diagnose.noise.spread import error_of
from ffl.effects import EFFECTS
from ffl.effects.periods import Repeating, harmonics

MOST = 4  # the fundamental counted
GLIMPSE = 0.1  # of the fundamental's amplitude: what is simulated to see where a harmonic would act
SURE = 2.0  # standard errors that a harmonic must be in the end
LEAST = 3.0  # score that a harmonic must bring, its numbers charged, with and without what judges


def with_harmonics(
    quiet: Scene, held: Scene | None, judged: Judged, say: Callable[[str], None]
) -> Judged:
    """`judged` with the harmonics of what repeats along the position in it that pay in the fitted
    recordings and with the held-out ones, up to the fourth; one that does not ends the search. (Where
    free runs go their own way the held-out ones gain by chance: 232 nats for 3 in those fitted.)"""
    current = judged
    for name in judged.model.names:
        if isinstance(EFFECTS[name], Repeating):
            current = _with_harmonics_of(name, quiet, held, current, say)
    return current


def _with_harmonics_of(
    name: str, quiet: Scene, held: Scene | None, current: Judged, say: Callable[[str], None]
) -> Judged:
    index = current.model.names.index(name)
    while (order := len(harmonics(_values(current.model, index))) + 1) <= MOST:
        start = _started(quiet, current, index, order)
        if start is None:
            break
        other = judge(quiet, held, start, 6, current.fit)
        a, b = levelled([other, current])
        say(
            f"  harmonic {order} of {name}: {a.fitted - b.fitted:+.1f} fitted, "
            f"{a.held_out - b.held_out:+.1f} held out"
        )
        told = a.score - a.held_out - b.score + b.held_out  # by the fitted recordings alone
        pays = min(told, a.score - b.score) >= LEAST
        if not pays or not _values(other.model, index)[f"amplitude_{order}"]:
            break
        current = other
    return current


def without_faint(held: Scene | None, judged: Judged) -> Judged:
    """`judged` without last harmonics less than two standard errors large, where nothing misses them: what
    came in beside another company may be nothing by now. (15 +- 13 millionths of a degree, of a ripple.)"""
    current = judged
    for name in judged.model.names:
        if isinstance(EFFECTS[name], Repeating):
            current = _without_faint_of(name, held, current)
    return current


def _without_faint_of(name: str, held: Scene | None, current: Judged) -> Judged:
    index = current.model.names.index(name)
    while (order := len(harmonics(_values(current.model, index)))) > 1:
        last = f"amplitude_{order}"
        error = error_of(current, index, last)
        if error is None or _values(current.model, index)[last] > SURE * error:
            break
        values = {
            k: v
            for k, v in _values(current.model, index).items()
            if k not in (last, f"phase_{order}")
        }
        other = judge(current.scene, held, current.model.with_parameters(index, values), 6)
        a, b = levelled([other, current])
        no_worse = a.score > b.score - LEAST
        if not no_worse and held is not None:  # around a play no two fits end at the same numbers
            no_worse = raw_error(held, a.model) <= raw_error(held, b.model)
        if not no_worse:
            break
        current = other
    return current


def _started(scene: Scene, judged: Judged, index: int, order: int) -> Model | None:
    """The model with the harmonic that first order asks for beside the numbers that are free."""
    base = scene.residuals(judged.model)
    if base is None:
        return None
    size = GLIMPSE * _values(judged.model, index)["amplitude"]
    columns = []
    for phase in (0.0, 0.5 * np.pi):
        moved = scene.residuals(_with(judged.model, index, order, size, phase))
        if moved is None:
            return None
        columns.append(scene.whiten([b - m for b, m in zip(base, moved, strict=True)]))
    free = orthonormal(scene.whiten_stacked(judged.fit.columns))
    table, white = np.column_stack(columns), scene.whiten(base)
    table, white = table - free @ (free.T @ table), white - free @ (free.T @ white)
    sine, cosine = np.linalg.lstsq(table, white, rcond=1e-12)[0]
    amplitude, phase = float(np.hypot(sine, cosine)), float(np.arctan2(cosine, sine))
    return _with(judged.model, index, order, size * amplitude, phase)


def _values(model: Model, index: int) -> dict[str, float]:
    return dict(model.effects[index].parameters)


def _with(model: Model, index: int, order: int, amplitude: float, phase: float) -> Model:
    values = {
        **_values(model, index),
        f"amplitude_{order}": amplitude,
        f"phase_{order}": phase,
    }
    return model.with_parameters(index, values)

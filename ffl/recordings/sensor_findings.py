"""Faults of the measured output: constant, clipped, frozen; and the encoder's step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffl.recordings.finding import Array, Finding, Severity, equal_runs, spans
from ffl.recordings.recording import Recording

_CONSTANT: tuple[tuple[str, Severity, str], ...] = (
    ("y", "fault", "the sensor measured nothing"),
    ("u", "warning", "nothing excites the machine"),
    ("r", "note", "the machine holds one place"),
    ("f", "note", "it tells nothing about the machine"),
    ("d", "note", "it tells nothing about the machine"),
    ("y_load", "warning", "the second encoder measured nothing"),
)
_SHORTEST = 3
_FROZEN = 8
_LAGS = (1, 3, 10)
_BREAK, _BOTH = 5.0, 2.5
"""How many times the usual bend of a moving output a stop must be to be no motion; and a stop and
the start that ends it, together. Sticking starts gently however hard it stopped."""


def constant_findings(recording: Recording) -> list[Finding]:
    """Columns that never change: nothing can be learned from them."""
    found = []
    for name, severity, says in _CONSTANT:
        x = getattr(recording, name)
        if x is None or name in recording.missing or np.ptp(x) > 0:
            continue
        if x[0] == 0.0 and name in ("r", "f", "d"):
            continue
        found.append(Finding("constant", name, f"{name} is constant at {x[0]:g}: {says}", severity))
    return found


def sensor_findings(recording: Recording) -> list[Finding]:
    y = recording.y
    if len(y) < 20 or np.ptp(y) == 0:
        return []
    step = quantisation_step(y)
    found = []
    if step is not None:
        text = f"y moves in steps of {step:.4g}, the sensor's resolution or the digits written"
        found.append(Finding("quantisation", "y", text, "note", value=step))
    first, stop = equal_runs(y, _SHORTEST)
    if len(first) == 0:
        return found
    demanded = _demanded(recording, first, stop, step or 0.0)
    signs = _signs(y, first, stop, step or 0.0)
    clipped = _clipped(y, first, stop, signs, demanded, step)
    if clipped.any():
        levels = np.unique(y[first[clipped]])
        share = float((stop - first)[clipped].sum() / len(y))
        said = " and ".join(f"{level:.6g}" for level in levels)
        found.append(
            Finding(
                "clipped",
                "y",
                f"y stops dead at its extreme {said} for {100 * share:.2g} % of the samples: a "
                "clipped sensor, or a hard stop",
                "warning" if share < 0.5 else "fault",
                spans(recording.t, first[clipped], stop[clipped]),
                share,
            )
        )
    long = stop - first >= _FROZEN
    frozen = long & demanded & ~clipped & (signs.entry | signs.exit | signs.too_still)
    # A clipped stretch may be left by a jump, so it is the extreme that tells the two apart.
    if frozen.any():
        share = float((stop - first)[frozen].sum() / len(y))
        found.append(
            Finding(
                "frozen",
                "y",
                f"y does not change at all for {int((stop - first)[frozen].max())} samples while "
                "the machine is driven: a frozen sensor, or samples held by the recorder",
                "fault",
                spans(recording.t, first[frozen], stop[frozen]),
                share,
            )
        )
    return found


@dataclass(frozen=True)
class _Signs:
    """For each stretch: it begins, ends, lasts in a way that motion does not."""

    entry: Array
    exit: Array
    too_still: Array


def _signs(y: Array, first: Array, stop: Array, step: float) -> _Signs:
    """Entry: the output runs on at speed and stands the next sample. Exit: it reappears elsewhere.

    The bend |y[k+m] - 2 y[k] + y[k-m]| at the last moving sample k (and at the first one after) is
    compared with the 98 % quantile of the bends of the moving output, for m = 1, 3, 10; sticking
    bends no more than braking does. The jump at the end is compared with the fastest motion.
    """
    n = len(y)
    edges = np.zeros(n + 1, int)
    edges[first] += 1
    edges[stop] -= 1
    inside = np.cumsum(edges[:n]) > 0
    near = np.zeros(n + 1, bool)
    for beside in (np.maximum(first - 1, 0), first, stop - 1, stop):
        near[beside] = True
    near = near[:n]
    entry = np.zeros(len(first), bool)
    for m in _LAGS:
        bend = np.zeros(n)
        bend[m:-m] = np.abs(y[2 * m :] - 2 * y[m:-m] + y[: -2 * m])
        moving = np.zeros(n, bool)
        moving[m:-m] = np.abs(y[2 * m :] - y[: -2 * m]) > 3 * step
        usual = bend[moving & ~inside & ~near]
        if len(usual) < 20:
            continue
        limit = float(np.quantile(usual, 0.98))
        fits = (first > m) & (stop - first >= m)
        stopping, starting = np.zeros(len(first)), np.zeros(len(first))
        stopping[fits] = bend[first[fits] - 1]
        fits &= stop < n
        starting[fits] = bend[stop[fits]]
        entry |= stopping > max(_BREAK * limit, 5 * step)
        entry |= np.minimum(stopping, starting) > max(_BOTH * limit, 5 * step)
    steps = np.abs(np.diff(y))
    ordinary = steps[~(near[1:] & near[:-1])]
    fastest = float(ordinary.max()) if len(ordinary) else np.inf
    leaving = np.zeros(len(first), bool)
    ends = stop < n
    leaving[ends] = steps[stop[ends] - 1] > max(3 * fastest, 5 * step)
    return _Signs(entry, leaving, (stop - first >= 12) & _noise_is_seen(y, inside))


def _noise_is_seen(y: Array, inside: Array) -> bool:
    """True where the output trembles by more than its step wherever it is slow.

    Looked at: the fifth of all windows of 16 samples with the least net motion, outside the
    stretches; there fewer than 5 % of neighbours are equal and at least 30 % of moves turn back.
    """
    windows = len(y) // 16
    if windows < 10:
        return False
    cut = y[: windows * 16].reshape(windows, 16)
    free = ~inside[: windows * 16].reshape(windows, 16).any(axis=1)
    if free.sum() < 10:
        return False
    moves = np.diff(cut[free], axis=1)
    slow = np.argsort(np.abs(moves.sum(axis=1)), kind="stable")[: max(int(free.sum()) // 5, 2)]
    moves = moves[slow]
    turns = np.mean(moves[:, 1:] * moves[:, :-1] < 0)
    return bool(np.mean(moves == 0) < 0.05 and turns >= 0.3)


def _demanded(recording: Recording, first: Array, stop: Array, step: float) -> Array:
    """True for each stretch in which something asked the machine to move."""
    if recording.is_open_loop:
        drive, least = recording.u, float(np.std(recording.u))
    else:
        drive, least = recording.r, max(3 * step, 1e-6 * float(np.ptp(recording.r)))
    # reduceat takes [first, stop) at every other place; the end of the array needs one more value.
    padded = np.append(drive, drive[-1])
    places = np.column_stack([first, stop]).ravel()
    highest = np.maximum.reduceat(padded, places)[::2]
    lowest = np.minimum.reduceat(padded, places)[::2]
    return highest - lowest > least


def _clipped(
    y: Array, first: Array, stop: Array, signs: _Signs, demanded: Array, step: float | None
) -> Array:
    """Stretches at an extreme that most often begin abruptly, or that recur to the last digit."""
    clipped = np.zeros(len(first), bool)
    for level in (y.min(), y.max()):
        at = y[first] == level
        if not at.any() or (stop - first)[at].sum() < 5:
            continue
        abrupt = at & signs.entry & demanded
        # A fine sensor that repeats one extreme exactly, and no other value anywhere.
        elsewhere = np.mean(np.diff(y[y != level]) == 0)
        fine = step is None or np.ptp(y) > 1000 * step
        recurs = fine and elsewhere < 0.02 and (at & demanded).sum() >= 2
        if abrupt.sum() * 2 >= at.sum() or recurs:
            clipped |= at
    return clipped


def quantisation_step(x: Array) -> float | None:
    """The step of which all differences between values are multiples; None where there is none.

    Neighbouring distinct values (of at most 200,000 samples) are compared with their smallest
    distance; nineteen in twenty of those below 50 steps must be multiples of it within 5 %.
    """
    values = np.unique(x[:200_000])
    spread = values[-1] - values[0]
    gaps = np.diff(values)
    gaps = gaps[gaps > max(1e-9 * spread, 8 * np.spacing(np.abs(values).max()))]
    if len(gaps) < 3:
        return None
    smallest = float(np.quantile(gaps, 0.002, method="lower"))
    ratio = gaps[gaps < 50 * smallest] / smallest
    near = np.abs(ratio - np.round(ratio)) < 0.05
    if len(ratio) < 3 or np.mean(near) < 0.95:
        return None
    return float(smallest * ratio[near].sum() / np.round(ratio[near]).sum())

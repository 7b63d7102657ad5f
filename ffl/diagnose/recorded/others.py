"""What else was recorded and may drive the machine: columns of the files that nothing is mapped from.

A column made of the machine's own signals (a speed, a current, an error, counts) knows what the machine
did, whatever made it do so: fed to a simulation it would explain anything. One that counts samples says
nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.signal

from ffl.recordings import Recording
from ffl.systems.state_space import Array

MOST = 4  # columns that are asked
OWN = 0.95  # of a column's variance: so much of it is made of the machine's own signals, and
MOVES = 0.9  # of that of its rate: what is slow looks like a sum of anything
ALL = 0.9999  # of the variance of what is nothing else, or counts samples
SMOOTH = (15, 61)  # samples over which noise is left out
SPAN, ORDER = 15, 3  # samples and order of the polynomial that rates are read by
RATES = ("rate of ", "acceleration of ")
TAKEN = ("x", "v", "a", "u", "t", "step")  # what maps call the machine's own signals


def with_others(
    recordings: Sequence[Recording],
) -> tuple[list[Recording], tuple[str, ...]]:
    """The recordings with those of their other columns that may say something, and the rates of these;
    their names. Without any that a recording lacks, that stands still in all, or follows from y, u and r,
    or from the time."""
    first = recordings[0]
    able = [n for n in first.others if all(n in r.others for r in recordings)]
    able = [n for n in able if any(np.ptp(r.others[n]) > 0.0 for r in recordings)]
    able = [n for n in able if not all(_counts(r.others[n]) for r in recordings)]
    able = [n for n in able if not any(_own(r, r.others[n]) for r in recordings)][:MOST]
    return [replace(r, others=_with_rates(r, able)) for r in recordings], tuple(map(_called, able))


def _with_rates(recording: Recording, names: Sequence[str]) -> dict[str, Array]:
    out: dict[str, Array] = {}
    for name in names:
        called, x = _called(name), recording.others[name]
        out[called] = x
        if len(x) <= SPAN or len(np.unique(x)) <= 2:  # a switch has no rate
            continue
        for k, rate in enumerate(RATES, 1):
            out[rate + called] = scipy.signal.savgol_filter(
                x, SPAN, ORDER, deriv=k, delta=recording.sample_time
            )
    return out


def _called(name: str) -> str:
    """The name of a column, which is none of the machine's own signals."""
    return f"{name} column" if name in TAKEN else name


def _counts(column: Array) -> bool:
    """Whether the `column` only goes with the time."""
    return _share(column, [np.arange(len(column), dtype=float)]) > ALL


def _own(recording: Recording, column: Array) -> bool:
    """Whether the `column` is made of the motion (y, r, their slopes, squares and signs), of the command,
    or of the power, and moves as they do, or of sums of these. Each by itself: all together they make the
    force that is missing, and so whatever makes it."""
    if not np.ptp(column) > 0.0:
        return False
    y, r = recording.y, recording.r
    u = recording.u if np.all(np.isfinite(recording.u)) else recording.f
    speed, late = _rate(y, 1), np.append(y[:1], y[:-1])
    motion = [y, late, speed, _rate(y, 2), np.abs(speed), np.sign(speed), y**2]
    motion += [r, _rate(r, 1), _rate(r, 2), np.cumsum(y)]
    motion += [] if recording.y_load is None else [recording.y_load]
    command = [u, recording.f, np.abs(u), u**2, np.append(u[:1], u[:-1]), np.cumsum(u)]
    command += [] if recording.d is None else [recording.d]
    return any(_made_of(column, known) for known in (motion, command, [u * speed]))


def _made_of(column: Array, known: Sequence[Array]) -> bool:
    if _share(column, known) > ALL:
        return True
    for span in SMOOTH:
        level = _share(_rate(column, 0, span), [_rate(x, 0, span) for x in known])
        rate = _share(_rate(column, 1, span), [_rate(x, 1, span) for x in known])
        if level > OWN and rate > MOVES:
            return True
    return False


def _share(column: Array, known: Sequence[Array]) -> float:
    """Of the variance of `column`, what the `known` signals make of it."""
    table = np.column_stack([np.ones(len(column)), *known])
    size = np.linalg.norm(table, axis=0)
    table = table / np.where(size > 0.0, size, 1.0)
    x = column - np.mean(column)
    left = x - table @ np.linalg.lstsq(table, x, rcond=1e-10)[0]
    return 1.0 - float(left @ left) / max(float(x @ x), 1e-300)


def _rate(x: Array, order: int, span: int = SPAN) -> Array:
    """d^order x, per sample, smoothed over `span` samples."""
    if len(x) <= span:
        return x if order == 0 else np.zeros_like(x)
    return scipy.signal.savgol_filter(x, span, ORDER, deriv=order)

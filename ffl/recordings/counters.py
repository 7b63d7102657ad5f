"""A position that starts again where its counter is full: after 2^16 steps, say.

A counter of n bits shows y modulo 2^n steps. Where it is full y goes back by all of them, less what the
machine moved in that sample, and stays within them all the while:

    |y_{k+1} - y_k| = 2^n q - |motion of a sample|,    max y - min y <= (2^n - 1) q.

A sensor that lost counts jumps by any number of them, and one that stood still goes the way of the motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffl.recordings.finding import Array
from ffl.recordings.sensor_findings import quantisation_step

LEAST, MOST = 8, 40  # bits
SMOOTH = 1.5  # times the sharpest bend elsewhere: what is left of one where y starts again
BENT = 0.02  # of the range: the same at most
WAY = 0.1  # of the range: what y, carried on, moves at least
FEWEST = 2  # equal jumps, where no step says how wide a counter is


@dataclass(frozen=True)
class Counter:
    """y starts again after 2^`bits` steps of `step` [unit of y]."""

    step: float
    bits: int

    @property
    def range(self) -> float:
        """All steps together [unit of y]."""
        return float(2**self.bits * self.step)


def counter_of(y: Array, resolution: float = 0.0) -> Counter | None:
    """The counter whose range y (N,) starts again after, of steps as the sensor's `resolution` [unit of y;
    0: not known] or as y shows them; None where y jumps otherwise anywhere, or does not at all."""
    largest = _largest(y)
    if largest == 0.0:
        return None
    for step in (resolution, quantisation_step(y)):
        if not step:
            continue
        bits = round(np.log2(largest / step))
        found = Counter(step, bits)
        within = LEAST <= bits <= MOST and np.ptp(y) < found.range - 0.5 * step
        if within and _goes_on(y, found.range, 2.0 * step):
            return found
    return None


def equal_jumps(y: Array) -> float | None:
    """What y (N,) goes back by, against its motion, each time that it jumps [unit of y], never leaving a
    window of that size: perhaps a counter's range, or a turn. None where it jumps otherwise, or less than
    twice. (Moves that were cut out go with the motion, or leave none to see.)"""
    largest = _largest(y)
    if largest == 0.0:
        return None
    step = np.diff(y)
    at = np.flatnonzero(np.abs(step) > 0.5 * largest)
    at = at[(at > 0) & (at < len(step) - 1)]
    if len(at) < FEWEST:
        return None
    moving = 0.5 * (step[at - 1] + step[at + 1])
    size = float(np.median(np.abs(step[at] - moving)))
    if np.any(step[at] * moving >= 0.0) or np.ptp(y) > (1.0 + BENT) * size:
        return None
    return size if _goes_on(y, size, 0.0) else None


def _largest(y: Array) -> float:
    """The largest step, where all y are numbers and it is far beyond what y does otherwise; else 0."""
    size = np.abs(np.diff(y))
    if len(size) < 3 or not np.all(np.isfinite(size)):
        return 0.0
    largest = float(size.max())
    return largest if largest > 0.5 * np.ptp(y) else 0.0


def _goes_on(y: Array, size: float, rounding: float) -> bool:
    """Whether y, carried on by `size` where it goes back by it, bends there no more than elsewhere, and
    goes some way: what toggles between two levels would only tremble about the range's end."""
    step = np.diff(y)
    back = np.abs(step) > 0.5 * size
    if not back.any():
        return False
    step -= size * np.sign(step) * back
    if np.ptp(np.cumsum(step)) < WAY * size:
        return False
    bend = np.abs(np.diff(step))
    near = back[1:] | back[:-1]
    usual = float(np.max(bend, initial=0.0, where=~near))
    return bool(bend[near].max() <= min(SMOOTH * usual + rounding, BENT * size + rounding))

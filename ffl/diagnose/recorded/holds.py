"""Where dry friction holds a machine whose controller goes on integrating.

At rest within an encoder's count or two a controller with integral action pushes now this way, now that,
until the machine lets go: its command is what noise and rounding have made of it since it stopped. No
simulation without that noise comes to the same command, none of what it says of the time the machine
stood is physics, and what it does next begins from the wrong force. A recording with long holds is
therefore compared move by move: each piece begins at rest with the controller in the state in which it
was (known, as the controller is), and the holds between them say nothing.
"""

from __future__ import annotations

import numpy as np
import scipy.ndimage

from ffl.recordings import Recording
from ffl.recordings.finding import equal_runs
from ffl.recordings.sensor_findings import quantisation_step
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

LEAST = 0.1  # s, and so many samples, that a hold lasts at least
SAMPLES = 100
STANDS = 4.0  # standard deviations of y's noise, beside a count, within which a machine stands
WANDERS = 0.002  # of the RMS command: what it goes by while the machine stands, at least
CLEARLY = 8.0  # RMS steps of its means over BLOCK: noise goes by 3 of them, a ramp by as many as there are
BLOCK = 0.05  # s, and so many samples
FEWEST = 5
KEPT, REST = 0.03, 48  # s of a hold, and samples, that stay with the moves at either end of it
SHORT = 200  # samples of a piece, at least

HELD = (
    "where nothing moves for long and only the command wanders, nothing was compared: each move "
    "is by itself"
)


def moves(model: Plant, recording: Recording) -> list[Recording]:
    """The recording itself, or its pieces between long holds."""
    if model.controller is None or recording.is_open_loop or not np.all(np.isfinite(recording.u)):
        return [recording]
    margin = max(REST, round(KEPT / recording.sample_time))
    out, begin = [], 0
    for first, last in holds(recording):
        end = min(first + margin, len(recording))
        if end - begin >= SHORT:
            out.append(recording[begin:end])
        begin = max(last - margin, end)
    if len(recording) - begin >= SHORT:
        out.append(recording[begin:])
    return out or [recording]


def holds(recording: Recording) -> list[tuple[int, int]]:
    """(first, last + 1) of the stretches in which neither reference nor machine moves, and the command
    goes its own way."""
    length = max(SAMPLES, round(LEAST / recording.sample_time))
    if len(recording) < 2 * length:
        return []
    y, u = recording.y, recording.u
    still = scipy.ndimage.maximum_filter1d(stands(y, length).astype(np.uint8), length).astype(bool)
    for drive in (recording.r, recording.f):
        range_ = scipy.ndimage.maximum_filter1d(drive, 3) - scipy.ndimage.minimum_filter1d(drive, 3)
        still &= range_ <= 1e-9 * max(float(np.ptp(drive)), 1e-300)
    size = float(np.sqrt(np.mean(u**2)))
    block = max(FEWEST, round(BLOCK / recording.sample_time))
    runs = zip(*equal_runs(still.astype(float), length), strict=True)
    return [
        (int(first), int(last))
        for first, last in runs
        if still[first] and _wanders(u[first:last], size, block)
    ]


def stands(y: Array, length: int) -> Array:
    """Where y stays within its noise and its rounding over `length` samples about."""
    count = quantisation_step(y) or 0.0
    noise = (
        1.4826 * float(np.median(np.abs(np.diff(y, 2)))) / np.sqrt(6.0)
    )  # but for where it moves
    span = scipy.ndimage.maximum_filter1d(y, length) - scipy.ndimage.minimum_filter1d(y, length)
    return span <= 2.0 * STANDS * noise + 1.5 * count


def _wanders(u: Array, size: float, block: int) -> bool:
    """Whether the command goes somewhere slowly, not to and fro as noise has it."""
    means = u[: len(u) // block * block].reshape(-1, block).mean(axis=1)
    if len(means) < 4:
        return False
    step = float(np.sqrt(np.mean(np.diff(means) ** 2)))
    return float(np.ptp(means)) > max(WANDERS * size, CLEARLY * step)

"""Single steps of y that no mass makes: where samples are missing, and where an angle turns over.

Between two samples a mass goes on as before. Where samples were lost and their time was counted on, y goes
the way of all of them in one step, and so does r: the controller had led it there. Where an encoder starts
again at the end of a turn, y goes back by a turn less what it moved, and nothing else does.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ffl.recordings.finding import Array, Finding
from ffl.recordings.recording import Recording

ABOUT = 12  # samples either side that a step is compared with
FAR = 8.0  # times the largest of their deviations from their mean
CLEAR = 30.0  # robust standard deviations of all steps' changes
ALIKE = 0.3  # of a step, between r's and y's
TURN = 0.02  # of a turn, beside twice a fast step: what a step back may leave of one
MOST = 0.01  # of all samples: more of them are no accidents


def jumps(x: Array) -> Array:
    """(k,) samples before which x (N,) makes a step far beyond those about it."""
    step = np.diff(x)
    if len(step) < 4 * ABOUT or not np.all(np.isfinite(step)):
        return np.zeros(0, dtype=int)
    change = np.abs(np.diff(step))
    usual = 1.4826 * float(np.median(change))
    count = float(np.min(np.abs(step), initial=np.inf, where=step != 0.0))
    least = max(CLEAR * usual, 4.0 * count if np.isfinite(count) else 0.0)
    at = []
    for k in np.flatnonzero(change > 0.5 * least) + 1:
        if ABOUT <= k < len(step) - ABOUT:
            about = np.concatenate([step[k - ABOUT : k], step[k + 1 : k + ABOUT + 1]])
            middle = float(np.median(about))
            if abs(step[k] - middle) > max(least, FAR * float(np.abs(about - middle).max())):
                at.append(int(k) + 1)
    return np.array(at, dtype=int) if len(at) <= MOST * len(x) else np.zeros(0, dtype=int)


def missing(recording: Recording) -> list[tuple[int, float]]:
    """(sample, what y jumps by before it) where y and r make one step together."""
    if {"r", "y"} & set(recording.missing) or recording.is_open_loop:
        return []
    y, r = recording.y, recording.r
    return [
        (int(k), float(y[k] - y[k - 1]))
        for k in np.intersect1d(jumps(y), jumps(r))
        if abs((y[k] - y[k - 1]) - (r[k] - r[k - 1])) < ALIKE * abs(y[k] - y[k - 1])
    ]


def missing_findings(recording: Recording) -> list[Finding]:
    """One fault for all places where samples are missing."""
    found = missing(recording)
    if not found:
        return []
    t = recording.t
    (first, by), more = found[0], len(found) - 1
    times = tuple((float(t[k - 1]), float(t[k])) for k, _ in found)
    return [
        Finding(
            "samples_missing",
            "recording",
            f"r and y jump together between two samples, by {by:.4g} at {t[first]:.6g} s"
            f"{f' and {more} more times' if more else ''}: samples are missing there, and perhaps where r "
            "hardly moves, and the time was counted on; give the time stamps as they were taken, or cut "
            "the recording there",
            "fault",
            times,
            float(len(found)),
        )
    ]


def turns(x: Array, turn: float) -> Array:
    """(k,) samples before which the angle x (N,) starts again, a `turn` away; none where what is left of
    one of those steps is no step of this motion."""
    step = np.diff(x)
    back = np.abs(step) > 0.5 * turn
    at = np.flatnonzero(back) + 1
    if not len(at) or not np.all(np.isfinite(step)) or len(at) > len(step) // 2:
        return np.zeros(0, dtype=int)
    left = step[back] - turn * np.round(step[back] / turn)
    largest = float(np.quantile(np.abs(step[~back]), 0.99))
    return at if np.all(np.abs(left) < TURN * turn + 2.0 * largest) else at[:0]


def unwrapped(recording: Recording, turn: float) -> tuple[Recording, int]:
    """(the recording with r, y and y_load going on where they start again, how often one of them does); y
    begins within half a turn of r, where there is one, and y_load of y."""
    out: dict[str, Array] = {}
    often = 0
    for name in ("r", "y", "y_load"):
        if name in recording.missing or getattr(recording, name) is None:
            continue
        x = np.asarray(getattr(recording, name))
        at = turns(x, turn)
        if len(at):
            back = np.zeros(len(x))
            back[at] = turn * np.round((x[at] - x[at - 1]) / turn)
            out[name] = x - np.cumsum(back)
            often += len(at)
    if not often:
        return recording, 0
    mended = replace(
        recording,
        r=out.get("r", recording.r),
        y=out.get("y", recording.y),
        y_load=out.get("y_load", recording.y_load),
    )
    if not mended.is_open_loop and "r" not in mended.missing:
        apart = turn * np.round((mended.r[0] - mended.y[0]) / turn)
        mended = replace(mended, y=mended.y + apart)
    if mended.y_load is not None:
        apart = turn * np.round((mended.y[0] - mended.y_load[0]) / turn)
        mended = replace(mended, y_load=mended.y_load + apart)
    return mended, often

"""Single samples of y that no machine moved to: a glitch of the sensor or of its line.

A mass cannot leave its path for one sample and be back on it in the next. What a cubic through the four
samples about one makes of it (Newton's interpolation, error of fourth order in the sample time),

    s_t = y_t - (4 (y_{t-1} + y_{t+1}) - y_{t-2} - y_{t+2})/6,

is noise and curvature everywhere else. A spike stands far out of both, in the shape of `SPIKE`; where the
speed jumps, at a stop or as a sensor freezes, it is that of `KINK`.
"""

from __future__ import annotations

import numpy as np

from ffl.recordings.finding import Array, Finding
from ffl.recordings.recording import Recording

FAR, COUNTS = (
    20.0,
    8.0,
)  # robust standard deviations, and steps of the encoder, that a spike stands out
FURTHER = 0.4  # of that, for others where there is one
MENDED = (
    0.25  # of a spike: more left beside it once it is mended, and the motion itself is fast there
)
NEAR = 4  # samples either side that are asked
SHORTEST = 50  # samples of a recording
NAMED = 3  # times that are told
SPIKE = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6.0  # s about it, of one of height 1
KINK = np.array([0.0, -0.5, 1.0, -0.5, 0.0])
LIKER = 0.25  # of the sum of squares that the other shape leaves
MOST = 0.02  # of all samples: more of them are no accidents but the signal


def spikes(y: Array) -> Array:
    """(k,) indices of samples of y (N,) that stand alone off its path, the first and last four not asked;
    none where they are many."""
    none = np.zeros(0, dtype=int)
    if len(y) < SHORTEST or not np.all(np.isfinite(y)):
        return none
    off = _off(y)
    steps = np.abs(np.diff(y))
    count = float(steps.min(initial=np.inf, where=steps > 0.0))
    least = max(FAR * 1.4826 * float(np.median(np.abs(off))), COUNTS * count)
    if not _standing_out(y, off, least):
        return none
    found = _standing_out(y, off, FURTHER * least)
    return np.sort(found).astype(int) if len(found) <= MOST * len(y) else none


def _standing_out(y: Array, off: Array, least: float) -> list[int]:
    """Samples that are off by more than `least`, each the middle of a spike, the highest first."""
    at = np.flatnonzero(np.abs(off) > least)
    at = at[(at >= NEAR) & (at < len(y) - NEAR)]
    found: list[int] = []
    mended = y.copy()
    for t in at[np.argsort(-np.abs(off[at]), kind="stable")]:
        about = mended[t - NEAR : t + NEAR + 1]
        shape = _off(about)[NEAR - 2 : NEAR + 3]
        height = float(shape[2])
        if not abs(height) > least:
            continue  # a spike is seen from its neighbours as well
        if not _left(shape, height * SPIKE) < LIKER * _left(shape, height * KINK):
            continue
        trial = about.copy()
        trial[NEAR] -= height
        if np.abs(_off(trial)).max() < MENDED * abs(height):
            found.append(int(t))
            mended[t] -= height
    return found


def without_spikes(y: Array, at: Array) -> Array:
    """y with the samples `at` on the cubic through the four about each."""
    mended = y.copy()
    for t in at:
        mended[t] = (4.0 * (mended[t - 1] + mended[t + 1]) - mended[t - 2] - mended[t + 2]) / 6.0
    return mended


def spike_findings(recording: Recording) -> list[Finding]:
    """A sensor, or its line, that glitches."""
    at = spikes(recording.y)
    if len(at) == 0:
        return []
    t = recording.t[at]
    text = (
        f"y leaves its path for one sample and is back on it in the next, {told(recording, at)}: no mass "
        "moves so; see to the sensor and its line"
    )
    return [Finding("spikes", "y", text, "warning", tuple((x, x) for x in t.tolist()), len(at))]


def told(recording: Recording, at: Array) -> str:
    """'17 times, at 0.569 s, 0.98 s, 1.592 s and later'."""
    times = [f"{t:.6g} s" for t in recording.t[at[:NAMED]]]
    once = "once" if len(at) == 1 else f"{len(at)} times"
    return f"{once}, at {', '.join(times)}{' and later' if len(at) > NAMED else ''}"


def _left(shape: Array, by: Array) -> float:
    return float(np.sum((shape - by) ** 2))


def _off(y: Array) -> Array:
    """s (N,), zero at the ends."""
    off = np.zeros(len(y))
    off[2:-2] = y[2:-2] - (4.0 * (y[1:-3] + y[3:-1]) - (y[:-4] + y[4:])) / 6.0
    return off

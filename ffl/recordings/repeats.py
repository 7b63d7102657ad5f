"""Blocks of samples that were written twice: a buffer that was not emptied, files joined with an overlap.

A file without a column of time hides it: the machine seems to go back to where it was and to do, digit for
digit, what it had just done. Noise never does; a machine at rest may, and is not asked.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffl.recordings.finding import Array, Finding, equal_runs
from ffl.recordings.recording import Recording

SHORTEST, LONGEST = 8, 1000  # samples of a block
PART = 4  # of a recording a block is at most this part
MOVING = 5  # different values of two columns that a block holds: what stands still repeats itself
ALONE, NEW = (
    64,
    20,
)  # of one, where it is the only one that moves: so many, or all of at least so many
MOST = 3e8  # comparisons


def repeated(columns: Sequence[Array]) -> list[tuple[int, int]]:
    """(first sample of the copy, samples) of every block that follows itself at once in all `columns`
    (N,), in which several take several values, or one takes many or is never the same. What goes on
    repeating itself, or does to the end of the recording, is periodic, and none."""
    n = len(columns[0])
    out: list[tuple[int, int]] = []
    for length in range(SHORTEST, min(LONGEST, n // PART, int(MOST / max(n, 1))) + 1):
        same = columns[0][length:] == columns[0][:-length]
        if np.count_nonzero(same) < length:
            continue
        for other in columns[1:]:
            same &= other[length:] == other[:-length]
        if np.count_nonzero(same) < length:
            continue
        first, stop = equal_runs(same.astype(float), length)
        for begin, end in zip(first[same[first]], stop[same[first]], strict=True):
            block = slice(begin, begin + length)
            if end - begin >= 2 * length or end == len(same):
                continue
            values = [len(np.unique(column[block])) for column in columns]
            enough = ALONE if length > ALONE else max(length, NEW)
            if max(values) >= enough or sum(v >= MOVING for v in values) > 1:
                out.append((int(begin) + length, length))
    return out


def repeat_findings(recording: Recording) -> list[Finding]:
    """One fault for all blocks that were written twice."""
    names = [name for name in ("y", "u") if name not in recording.missing]
    columns = [np.asarray(getattr(recording, name)) for name in names]
    found = repeated(columns) if "y" in names and all(np.isfinite(c).all() for c in columns) else []
    if not found:
        return []
    t = recording.t
    times = tuple((float(t[first]), float(t[first + length - 1])) for first, length in found)
    (first, length), more = found[0], len(found) - 1
    return [
        Finding(
            "repeated_block",
            "recording",
            f"the {length} samples from {t[first]:.6g} s on are those just before, digit for digit, in "
            f"{' and '.join(names)}{f', and {more} more blocks' if more else ''}: written twice; cut one "
            "of the two out and give the file a column of time",
            "fault",
            times,
            float(length),
        )
    ]

"""The checks that a recording passes before anything is computed from it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ffl.errors import InputError
from ffl.recordings.recording import COLUMNS, Array, Recording
from ffl.recordings.sampling import Sampling, accepts, examine_time
from ffl.recordings.table import sample

SHORTEST = 10
"""Samples below which no sample time, no start and no mismatch can be told."""


def check_recording(
    recording: Recording,
    sample_time: float | None = None,
    where: Callable[[int], str] = sample,
) -> None:
    """Raises `InputError` (file, column, row, mend) for samples that are not to be computed with.

    Too short; NaN or infinite values; time that runs backwards, repeats, leaves samples out or
    jitters by more than 0.1 %; a sample time that is not `sample_time` within 0.1 %. `where` turns
    a sample index into a place in the file.
    """
    source = recording.source
    check_length(len(recording), source)
    for name in COLUMNS:
        values = getattr(recording, name)
        if values is not None and not (name == "u" and "u" in recording.missing):
            check_finite(values, name, source, where)
    sampling = check_time(recording.t, source, where)
    found = sampling.sample_time if "t" not in recording.missing else recording.sample_time
    if sample_time is not None and not accepts(found, sample_time):
        for unit, scale in (("ms", 1e-3), ("µs", 1e-6), ("ns", 1e-9)):
            if accepts(found * scale, sample_time):
                raise InputError(
                    f"{source}: the sample time is {found:.6g} s, not {sample_time:.6g} s: t is in "
                    f"{unit}; give t a scale = {scale:g} in a mapping"
                )
        raise InputError(
            f"{source}: the sample time is {found:.6g} s, not {sample_time:.6g} s (accepted within "
            "0.1 %); resample the recording or correct its time column"
        )


def check_length(samples: int, source: str) -> None:
    if samples < SHORTEST:
        raise InputError(
            f"{source}: {samples} samples are too few; give at least {SHORTEST} (a diagnosis wants "
            "hundreds)"
        )


def check_finite(values: Array, name: str, source: str, where: Callable[[int], str]) -> None:
    # One sum finds whether there is anything to look for, at a third of the cost of isfinite.
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(values.sum()):
            return
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        more = f" ({len(bad)} such values in all)" if len(bad) > 1 else ""
        raise InputError(
            f"{source}: {where(int(bad[0]))}, column {name}: {values[bad[0]]} is not a number that "
            f"can be used{more}; correct it or cut the recording there"
        )


def check_time(t: Array, source: str, where: Callable[[int], str] = sample) -> Sampling:
    """The sampling of a time column, or an `InputError` for the first fault in it."""
    sampling = examine_time(t)
    if sampling.faults:
        fault = sampling.faults[0]
        raise InputError(f"{source}: {where(fault.row)}, column t: {fault.text}; {fault.mend}")
    return sampling

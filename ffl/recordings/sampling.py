"""What a column of time stamps says: the sample time, and where the sampling is broken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Array = np.ndarray

SAMPLE_TIME_TOLERANCE = 1e-3
"""Sample times are accepted, and intervals may differ from one another, by this fraction."""


@dataclass(frozen=True)
class TimeFault:
    """kind: backwards, repeated, gap, jitter; `row` is the first sample it shows at."""

    kind: str
    row: int
    text: str
    mend: str


@dataclass(frozen=True)
class Sampling:
    sample_time: float
    faults: tuple[TimeFault, ...]
    gaps: tuple[tuple[int, int], ...] = ()
    """(row after the gap, samples lost), for each gap."""


@np.errstate(over="ignore", invalid="ignore")
def examine_time(t: Array) -> Sampling:
    """Sample time of at least two stamps, and every kind of fault in them once.

    The sample time is the mean interval between gaps, written with the fewest digits that the
    stamps allow: 0.004 for single-precision stamps whose mean is 0.0039999999. Stamps may be
    rounded (to print, to single precision) by up to a tenth of the sample time.
    """
    dt = np.diff(t)
    median = float(np.median(dt))
    faults = []
    for kind, wrong, text, mend in (
        ("backwards", dt < 0, "time runs backwards", "sort the rows or split there"),
        (
            "repeated",
            dt == 0,
            "time stands still",
            "leave out repeated samples, or write time with more digits",
        ),
    ):
        rows = np.flatnonzero(wrong)
        if len(rows):
            k = int(rows[0])
            more = f", {len(rows)} times in all" if len(rows) > 1 else ""
            text = f"{text} ({t[k]:.10g} s to {t[k + 1]:.10g} s{more})"
            faults.append(TimeFault(kind, k + 1, text, mend))
    if median <= 0:
        return Sampling(abs(median) or 1.0, tuple(faults))
    rounding = _rounding(t, median)
    lost_at = np.flatnonzero(dt > 1.5 * median)
    gaps = tuple((int(k) + 1, round(min(float(dt[k]) / median, 1e15)) - 1) for k in lost_at)
    regular = (dt > 0.5 * median) & (dt < 1.5 * median)
    mean = float(dt[regular].mean()) if gaps or faults else float(t[-1] - t[0]) / len(dt)
    sample_time = _plain(mean, rounding / max(int(regular.sum()), 1))
    if gaps:
        row, lost = gaps[0]
        total = sum(n for _, n in gaps)
        more = f", {len(gaps)} gaps with {total} samples in all" if len(gaps) > 1 else ""
        faults.append(
            TimeFault(
                "gap",
                row,
                f"{lost} sample{'s' * (lost > 1)} missing between {t[row - 1]:.10g} s and "
                f"{t[row]:.10g} s{more}",
                "split the recording there (rows in a mapping)",
            )
        )
    deviation = np.where((dt > 0) & (dt < 1.5 * median), np.abs(dt - mean), 0.0)
    allowed = SAMPLE_TIME_TOLERANCE * mean + 1.01 * rounding
    if deviation.max() > allowed:
        k = int(np.argmax(deviation > allowed))
        faults.append(
            TimeFault(
                "jitter",
                k + 1,
                f"intervals differ from the sample time {sample_time:.6g} s by up to "
                f"{100 * deviation.max() / mean:.2g} % (first {dt[k]:.6g} s after {t[k]:.10g} s)",
                "write time with more digits, resample, or leave t out and give sample_time in a "
                "mapping where the sampling itself was even",
            )
        )
    return Sampling(sample_time, tuple(faults), gaps)


def _rounding(t: Array, interval: float) -> float:
    """By how much an interval may be off because stamps are stored with finite precision."""
    largest = float(np.abs(t).max())
    floor = 4 * np.spacing(largest)
    candidates = [floor]
    if np.array_equal(t, t.astype(np.float32)):
        candidates.append(2 * float(np.spacing(np.float32(largest))))
    for digits in range(10):
        step = 10.0**-digits
        if step <= 0.1 * interval and np.abs(t - np.round(t, digits)).max() <= floor:
            candidates.append(step)
            break
    candidates.append(_by_digits(t, floor))
    return max(c for c in candidates if c <= 0.1 * interval or c == floor)


def _by_digits(t: Array, floor: float) -> float:
    """Step of the last stamps where all hold so many significant digits of an even grid, as %.7g
    writes them: fewer decimals later on than at first. `floor` where they do not."""
    share = np.arange(len(t)) / (len(t) - 1)
    grid = t[0] + share * (t[-1] - t[0])
    size = np.floor(np.log10(np.maximum(np.abs(t), np.finfo(float).tiny)))
    for digits in range(4, 13):
        unit = 10.0 ** (size - digits + 1)
        step = float(unit.max())
        rounded = np.all(np.abs(t - np.round(t / unit) * unit) <= floor)
        if rounded and np.all(np.abs(t - grid) <= 0.51 * (unit + share * step) + floor):
            return step
    return floor


def _plain(value: float, uncertainty: float) -> float:
    """The number with the fewest digits (at most 12) within `uncertainty` of `value`."""
    for digits in range(1, 12):
        short = float(f"{value:.{digits}g}")
        if abs(short - value) <= max(uncertainty, 1e-12 * value):
            return short
    return float(f"{value:.12g}")


def accepts(sample_time: float, expected: float) -> bool:
    """True where the two sample times agree within 0.1 %."""
    return abs(sample_time / expected - 1.0) <= SAMPLE_TIME_TOLERANCE


def other_than_mapped(found: float, given: float) -> str:
    """What is wrong where t has the sample time `found` [s] and the mapping gives another; empty where
    the two agree."""
    if accepts(found, given):
        return ""
    return (
        f"column t has a sample time of {found:.6g} s, the mapping says {given:.6g} s; correct one, or "
        "leave t out of the mapping"
    )

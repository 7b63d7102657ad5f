"""Dates and clock times, as text the way loggers write them and as numpy keeps them, in seconds."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

Array = np.ndarray

DAY = 86400.0

_CLOCK = r"(?P<h>\d{1,2}):(?P<m>\d{2})(?::(?P<s>\d{2}(?:[.,]\d+)?))?"
_DATE = r"(?:(?P<a>\d{1,4})(?P<mark>[-./])(?P<b>\d{1,2})(?P=mark)(?P<c>\d{2,4})[T ,]\s*)?"
_STAMP = re.compile(rf"^{_DATE}{_CLOCK}\s*(?P<half>[AP]M)?\s*(?:Z|[+-]\d{{2}}:?\d{{2}})?$", re.I)


def is_stamp(cell: str) -> bool:
    """A clock time with or without a date before it: `2024-05-06 08:00:10`, `6.5.2024 08:00`,
    `05/06/2024 8:00:10 AM`, `08:00:10.250`."""
    return _STAMP.match(cell) is not None


def seconds(cells: Sequence[str]) -> Array | int:
    """Seconds since midnight of the first stamp's day, (n,); or the index of the first cell that is
    no stamp. A clock without dates that falls back by half a day or more has passed midnight.

    Dates are year first, or with dots day first; with slashes month first, unless the days that this
    makes leap further than day first.
    """
    found = []
    for k, cell in enumerate(cells):
        match = _STAMP.match(cell)
        if match is None:
            return k
        found.append(match)
    clock = np.array([_clock(m) for m in found])
    if found[0]["a"] is None:
        return clock + DAY * np.cumsum(np.diff(clock, prepend=clock[0]) < -0.5 * DAY)
    dates = {m.group("a", "mark", "b", "c") for m in found}
    tried = [days for order in ("mdc", "dmc") if (days := _days(dates, order)) is not None]
    if not tried:
        return 0
    days = min(tried, key=lambda days: max(days.values()) - min(days.values()))
    at = np.array([days[m.group("a", "mark", "b", "c")] for m in found])
    return clock + DAY * (at - at[0])


def since_midnight(stamps: Array) -> Array:
    """numpy's dates as seconds since midnight of the first, its durations as seconds; NaN where one
    is not a time.

    >>> since_midnight(np.array(["2024-02-28T23:59:50", "2024-02-29T00:00:00"], "M8[ms]"))
    array([86390., 86400.])
    """
    if stamps.dtype.kind == "M" and stamps.size:
        stamps = stamps - stamps.ravel()[0].astype("M8[D]")
    return stamps.astype(f"m8[{np.datetime_data(stamps.dtype)[0]}]") / np.timedelta64(1, "s")


def _clock(match: re.Match[str]) -> float:
    hour = int(match["h"])
    if match["half"]:
        hour = hour % 12 + (12 if match["half"].lower() == "pm" else 0)
    second = float((match["s"] or "0").replace(",", "."))
    return 3600.0 * hour + 60.0 * int(match["m"]) + second


def _days(dates: set[tuple[str, ...]], order: str) -> dict[tuple[str, ...], int] | None:
    """Days since 1970 of every date; None where one does not exist."""
    out: dict[tuple[str, ...], int] = {}
    for a, mark, b, c in dates:
        if len(a) > 2:
            year, month, day = a, b, c
        elif mark == "." or order == "dmc":
            year, month, day = c, b, a
        else:
            year, month, day = c, a, b
        year = f"20{year}" if len(year) == 2 else year
        try:
            stamp = np.datetime64(f"{int(year):04d}-{int(month):02d}-{int(day):02d}", "D")
        except ValueError:
            return None
        out[a, mark, b, c] = int(stamp.astype(int))
    return out

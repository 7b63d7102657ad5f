"""Where a table begins in a text file: lines above the header, the header, a line of units below it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ffl.recordings.csv_text import find_separator, is_number, split_line
from ffl.recordings.stamps import is_stamp

MARKS = "#% "  # before a header that numpy.savetxt wrote
LINES = 200  # lines among which the header is looked for


@dataclass(frozen=True)
class Head:
    """`skip` lines stand above the header; `units` is what a line below it says, if there is one."""

    skip: int
    separator: str
    units: tuple[str, ...] = ()


def find_head(lines: Sequence[str]) -> Head | None:
    """The header above the first row of numbers: the line before it, or the one before that where the
    line between names units; lines above the header are passed over, and so is a # or % before it. None
    where no row of numbers stands below a line of as many words.

    >>> find_head(["bench 3;", "t;u", "s;V", "0,0;1,5", "0,1;1,5"])
    Head(skip=1, separator=';', units=('s', 'V'))
    """
    for k in range(1, min(len(lines), LINES)):
        if not lines[k].strip():
            continue
        separator = find_separator([lines[k].lstrip(MARKS), lines[k - 1].lstrip(MARKS)])
        row = split_line(lines[k], separator)
        if not _is_row(row):
            continue
        above, over = (
            split_line(at.lstrip(MARKS), separator) for at in (lines[k - 1], lines[k - 2])
        )
        if len(row) != len(above) or not _is_text(above):
            return None
        if k > 1 and len(over) == len(row) and all(over) and _is_text(over) and _are_units(above):
            units = tuple(cell.strip("[]() ") for cell in above)
            return Head(k - 2, separator, units)
        return Head(k - 1, separator)
    return None


def _is_value(cell: str) -> bool:
    return is_number(cell.replace(",", ".")) or is_stamp(cell)


def _is_row(cells: Sequence[str]) -> bool:
    """Numbers or dates; cells may be empty."""
    filled = [cell for cell in cells if cell]
    return bool(filled) and all(_is_value(cell) for cell in filled)


def _is_text(cells: Sequence[str]) -> bool:
    return not any(_is_value(cell) for cell in cells if cell)


def _are_units(cells: Sequence[str]) -> bool:
    """Short words, or nothing: `ms`, `[V]`, `1/min`."""
    return all(len(cell.strip("[]() ")) <= 12 for cell in cells)

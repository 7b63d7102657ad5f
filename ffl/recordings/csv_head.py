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
        above = [split_line(at.lstrip(MARKS), separator) for at in lines[max(k - 2, 0) : k]]
        found = header_above(row, above)
        return None if found is None else Head(k - found[0], separator, found[1])
    return None


def header_above(
    row: Sequence[str], above: Sequence[Sequence[str]]
) -> tuple[int, tuple[str, ...]] | None:
    """How many rows of cells above a row of numbers the header stands, 1 or 2, and the units between
    them where it is 2; `above` are the rows before it, the last one nearest. None where the nearest is
    no header.

    >>> header_above(["0", "1"], [["t", "u"], ["[s]", "[V]"]])
    (2, ('s', 'V'))
    """
    near = above[-1]
    if len(row) != len(near) or not _is_text(near):
        return None
    over = above[-2] if len(above) > 1 else ()
    if len(over) == len(row) and all(over) and _is_text(over) and _are_units(near):
        return 2, tuple(cell.strip("[]() ") for cell in near)
    return 1, ()


def is_value(cell: str) -> bool:
    return is_number(cell.replace(",", ".")) or is_stamp(cell)


def _is_row(cells: Sequence[str]) -> bool:
    """Numbers or dates; cells may be empty, but not all."""
    filled = [cell for cell in cells if cell]
    return bool(filled) and all(is_value(cell) for cell in filled)


def _is_text(cells: Sequence[str]) -> bool:
    return not any(is_value(cell) for cell in cells if cell)


def _are_units(cells: Sequence[str]) -> bool:
    """Short words, or nothing: `ms`, `[V]`, `1/min`."""
    return all(len(cell.strip("[]() ")) <= 12 for cell in cells)

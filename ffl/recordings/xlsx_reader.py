"""Excel workbooks, by the optional extra `xlsx`: tables of numbers under a row of names."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import date, datetime, time, timedelta
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ffl.errors import InputError
from ffl.recordings.csv_head import LINES, header_above, is_value
from ffl.recordings.csv_text import is_number
from ffl.recordings.stamps import is_stamp, seconds
from ffl.recordings.table import Array, Table, sample, shortest, unreadable


@dataclass(frozen=True)
class Sheet:
    """The table in one sheet: names and units by column, and its first row of samples, from 1."""

    title: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    first: int


def read_xlsx(path: Path) -> Table:
    """Columns of every sheet that holds a table by the cells of its header, by `sheet.column` where
    several have that name.

    Rows above the header are passed over, and a row of units may follow it, as in text. Dates and clock
    times, in cells of Excel's own kind (to a millisecond) or as text, are seconds since midnight of the
    first day; durations are seconds. Of a formula, the value that Excel saved.

    Raises `InputError`: openpyxl is not installed; no workbook; no table in it; a cell that is no number.
    """
    try:
        import openpyxl
    except ImportError:
        raise InputError(
            f"{path}: reading Excel needs openpyxl; install it with pip install 'ffl[xlsx]'"
        ) from None

    @contextmanager
    def opened() -> Iterator[Any]:
        with warnings.catch_warnings(), path.open("rb") as file:
            warnings.simplefilter("ignore")  # of styles and extensions that say nothing of numbers
            try:
                book = openpyxl.load_workbook(file, read_only=True, data_only=True)
                yield book
                book.close()
            except InputError:
                raise
            except Exception as error:  # zip, XML, key and value errors of a damaged file
                raise unreadable(path, "an Excel workbook", error) from None

    with opened() as book:
        sheets = [found for sheet in book.worksheets if (found := _find_table(sheet)) is not None]
    if not sheets:
        raise InputError(
            f"{path}: no sheet holds numbers below a row of names; write the names of the columns, "
            "t, u, y or your own, above them"
        )
    places = [(s, k) for s in sheets for k, name in enumerate(s.names) if name]
    names, aliases = shortest([(s.title, s.names[k]) for s, k in places])
    at = dict(zip(names, places, strict=True))

    def load(wanted: Sequence[str]) -> dict[str, Array]:
        out = {}
        with opened() as book:
            for title in dict.fromkeys(at[name][0].title for name in wanted):
                own = {name: at[name] for name in wanted if at[name][0].title == title}
                cells = _columns(book[title], own)
                for name, (sheet, _) in own.items():
                    place = f"{path}: {f'sheet {title}, ' * (len(sheets) > 1)}"
                    out[name] = _numbers(cells[name], _rows(place, sheet.first), name)
        return out

    one_first = len({sheet.first for sheet in sheets}) == 1
    return Table(
        source=str(path),
        names=names,
        load=load,
        units={n: s.units[k] for n, (s, k) in at.items() if k < len(s.units) and s.units[k]},
        where=(lambda k: f"row {sheets[0].first + k}") if one_first else sample,
        aliases=aliases,
    )


def _find_table(sheet: Any) -> Sheet | None:
    """The table with most numbers among the first rows: names, perhaps units, above rows that hold
    numbers in the same columns. Words may stand in other columns, and anything above."""
    sheet.reset_dimensions()  # some programs write wrong ones
    top = islice(sheet.iter_rows(values_only=True), LINES)
    rows = [(k, [_text(cell) for cell in row]) for k, row in enumerate(top, 1)]
    rows = [(k, row) for k, row in rows if any(row)]
    best, most = None, 0
    for at in range(1, len(rows)):
        first, row = rows[at]
        used = [k for k, cell in enumerate(row) if is_value(cell)]
        above = [[_at(over, k) for k in used] for _, over in rows[max(at - 2, 0) : at]]
        found = header_above([row[k] for k in used], above) if used else None
        if found is None:
            continue
        size = sum(bool(name) for name in above[-found[0]]) * _height(rows[at:], used)
        if size > most:
            header, units = rows[at - found[0]][1], dict(zip(used, found[1], strict=False))
            spread = tuple(units.get(k, "") for k in range(len(header)))
            best, most = Sheet(sheet.title, tuple(header), spread, first), size
    return best


def _height(rows: Sequence[tuple[int, Sequence[str]]], columns: Sequence[int]) -> int:
    """How many rows from the first on hold a value in each of the columns."""
    whole = [all(is_value(_at(row, k)) for k in columns) for _, row in rows]
    return whole.index(False) if not all(whole) else len(whole)


def _at(row: Sequence[Any], column: int) -> Any:
    return row[column] if column < len(row) else ""


def _text(cell: Any) -> str:
    """A cell as a text file would have it, for the header to be found."""
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return str(int(cell))
    if isinstance(cell, datetime):
        return cell.isoformat(" ")
    if isinstance(cell, date):
        return f"{cell.isoformat()} 00:00"
    if isinstance(cell, timedelta):
        return repr(cell.total_seconds())
    return " ".join(str(cell).split())


def _columns(sheet: Any, places: dict[str, tuple[Sheet, int]]) -> dict[str, list[Any]]:
    """The cells below the header, without empty ones at the end."""
    sheet.reset_dimensions()
    first = next(iter(places.values()))[0].first
    columns: dict[str, list[Any]] = {name: [] for name in places}
    for row in sheet.iter_rows(min_row=first, values_only=True):
        for name, (_, k) in places.items():
            columns[name].append(_at(row, k))
    for cells in columns.values():
        while cells and _text(cells[-1]) == "":
            cells.pop()
    return columns


def _rows(place: str, first: int) -> Callable[[int], str]:
    return lambda k: f"{place}row {first + k}"


def _kind(cell: Any) -> str:
    kinds = {bool: "number", int: "number", float: "number", time: "clock time"}
    kinds |= {datetime: "date", date: "date", timedelta: "duration"}
    return kinds.get(type(cell), "text")


def _numbers(cells: Sequence[Any], place: Callable[[int], str], name: str) -> Array:
    """Numbers or seconds; cells of one kind, text only where there is nothing else."""
    kinds = [_kind(cell) for cell in cells]
    wanted = "number" if "number" in kinds else next(iter(kinds), "number")
    texts = [_text(cell) for cell in cells]
    if wanted == "text":
        texts = [
            text.replace(",", ".") if is_number(text.replace(",", ".")) else text for text in texts
        ]
        wanted = "time" if is_stamp(texts[0]) else "number"
        right = [is_stamp(text) if wanted == "time" else is_number(text) for text in texts]
    else:
        right = [kind == wanted for kind in kinds]
    found: Array | int
    if not all(right):
        found = right.index(False)
    elif wanted in ("number", "duration"):
        found = np.array(texts, dtype=float)
    else:
        found = seconds(texts)
    if isinstance(found, int):
        said = texts[found][:30]
        is_a = "is not" if kinds[found] == "text" else f"is a {kinds[found]}, not"
        what = f"{said!r} {is_a} a {wanted}" if said else "there is no value"
        raise InputError(f"{place(found)}, column {name}: {what}; correct it or leave the row out")
    return found

"""CSV: comma, semicolon, tab or blank separated text with a header line."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ffl.errors import InputError
from ffl.recordings.csv_head import LINES, MARKS, find_head
from ffl.recordings.csv_text import (
    Text,
    bad_cell,
    find_separator,
    is_number,
    ragged_line,
    read_text,
    split_line,
)
from ffl.recordings.stamps import is_stamp, seconds
from ffl.recordings.table import Array, Table


@dataclass(frozen=True)
class Rows:
    """What stands below the header: `body` after `skipped` lines of the file, in columns `names`."""

    path: Path
    text: Text
    body: bytes
    skipped: int
    names: list[str]
    separator: str

    def decoded(self, decimal_comma: bool = False) -> str:
        body = self.body.replace(b",", b".") if decimal_comma else self.body
        return body.decode(self.text.encoding, "replace")


def read_csv(path: Path, header: Sequence[str] = (), skip_lines: int = 0) -> Table:
    """Names from the header line (or `header`, where the file has none); numbers by numpy's C reader.

    Separator, decimal comma, encoding and line ends are found out, and so is where the header stands:
    lines above it are passed over, `skip_lines` of them unseen; a line of units may follow it.
    """
    text = read_text(path)
    body, skipped = _after_lines(text.raw, skip_lines)
    names = [name.strip() for name in header]
    top = body.split(b"\n", LINES)[:LINES]
    head = None if names else find_head([line.decode(text.encoding, "replace") for line in top])
    if head is not None:
        body, more = _after_lines(body, head.skip)
        skipped += more
        body = body.lstrip(MARKS.encode())
    while body[:1] in (b"#", b"%", b"\n"):
        body, more = _after_lines(body, 1)
        skipped += more
    first = [line.decode(text.encoding, "replace") for line in body.split(b"\n", 2)[:2]]
    separator = find_separator([line for line in first if line.strip()])
    units: dict[str, str] = {}
    if head is not None:
        separator = head.separator
        names = split_line(first[0], separator)
        units = {name: unit for name, unit in zip(names, head.units, strict=False) if unit}
        below = 2 if head.units else 1
        body, more = _after_lines(body, below)
        skipped += more
    elif not names:
        names = split_line(first[0], separator)
        if any(name and is_number(name.replace(",", ".")) for name in names):
            raise InputError(
                f"{path}: line {skipped + 1} holds numbers where the header should stand; begin "
                "the file with t,r,f,u,y, or give header = [...] in a mapping"
            )
        body, more = _after_lines(body, 1)
        skipped += more
    # Lines are counted from `skipped`; blank ones at the very end say nothing.
    trimmed = body.rstrip(b"\n \t" if separator != "\t" else b"\n ")
    if not trimmed:
        raise InputError(f"{path}: there is no sample below the header; export it again")
    row = trimmed[: trimmed.find(b"\n") if b"\n" in trimmed else None].decode(
        text.encoding, "replace"
    )
    cells = split_line(row, separator)
    if len(cells) != len(names) and not (len(cells) == len(names) + 1 and not cells[-1]):
        raise InputError(
            f"{path}: the rows have {len(cells)} columns, the header names {len(names)}; give "
            "every column one name"
        )
    return Table(
        source=str(path),
        names=tuple(name for name in names if name),
        load=partial(_load, rows=Rows(path, text, trimmed, skipped, names, separator)),
        units=units,
        where=lambda index: f"line {skipped + index + 1}",
    )


def _after_lines(raw: bytes, count: int) -> tuple[bytes, int]:
    """`raw` without its first `count` lines, and how many lines those were."""
    for done in range(count):
        end = raw.find(b"\n")
        if end < 0:
            return b"", done + 1
        raw = raw[end + 1 :]
    return raw, count


def _load(wanted: Sequence[str], *, rows: Rows) -> dict[str, Array]:
    path, body, skipped, names = rows.path, rows.body, rows.skipped, rows.names
    text, separator = rows.text, rows.separator
    columns = [names.index(name) for name in wanted]
    first = body[: body.find(b"\n") if b"\n" in body else len(body)]
    quoted = b'"' in first
    if not quoted and separator != " ":
        ragged = ragged_line(body, separator, first.count(separator.encode()))
        expected = first.count(separator.encode()) + 1
        if ragged is not None:
            line, there = ragged
            last = line == body.count(b"\n")
            mend = "the file is cut off; export it again" if last else "give every row as many"
            raise InputError(
                f"{path}: line {skipped + line + 1} has {there} columns, the lines before have "
                f"{expected}; {mend}"
            )
    # Anywhere in the body: a machine at rest may write its first rows without decimals.
    decimal_comma = separator != "," and b"," in body
    untouched = text.as_on_disk and not decimal_comma
    # numpy reads a file by its own buffer 2.5 times faster than lines out of memory.
    cells = split_line(first.decode(text.encoding, "replace"), separator)
    dated = [c for c in columns if c < len(cells) and is_stamp(cells[c])]
    times = {c: _stamps(c, rows) for c in dated}
    columns = [c for c in columns if c not in times]
    if not columns:
        return {name: times[names.index(name)] for name in wanted}
    stream = path if untouched else io.StringIO(rows.decoded(decimal_comma))
    try:
        numbers = np.loadtxt(
            stream,
            delimiter=None if separator == " " else separator,
            comments=None,
            quotechar='"' if quoted else None,
            usecols=columns,
            skiprows=skipped if untouched else 0,
            encoding=text.encoding,
            ndmin=2,
        )
    except ValueError as error:
        raise _named(error, rows, columns) from None
    found = times | {c: numbers[:, k] for k, c in enumerate(columns)}
    return {name: found[names.index(name)] for name in wanted}


def _stamps(column: int, rows: Rows) -> Array:
    """A column of dates or clock times in seconds since midnight of its first day."""
    cells = [split_line(line, rows.separator)[column] for line in rows.decoded().split("\n")]
    found = seconds(cells)
    if isinstance(found, int):
        raise InputError(
            f"{rows.path}: line {rows.skipped + found + 1}, column {rows.names[column]}: "
            f"{cells[found][:30]!r} is not a time like the ones before; correct it or leave the row out"
        )
    return found


def _named(error: ValueError, rows: Rows, columns: list[int]) -> InputError:
    """Which cell numpy's reader could not take."""
    names, separator = rows.names, rows.separator
    lines = rows.decoded(separator != ",").split("\n")
    # numpy says the row, give or take one by its version; the rest is searched only if it errs.
    hint = re.search(r"at row (\d+)", str(error))
    near = max(int(hint[1]) - 1, 0) if hint else 0
    bad = bad_cell(lines[near : near + 3], separator, columns) if hint else None
    bad = (bad[0] + near, *bad[1:]) if bad else bad_cell(lines, separator, columns)
    if bad is None:
        said = " ".join(str(error).split())[:120]
        return InputError(f"{rows.path}: cannot be read as a table of numbers ({said})")
    row, column, cell = bad
    name = names[column] if column < len(names) else str(column)
    what = f"{cell[:30]!r} is not a number" if cell else "there is no value"
    return InputError(
        f"{rows.path}: line {rows.skipped + row + 1}, column {name}: {what}; correct it or leave the row "
        "out"
    )

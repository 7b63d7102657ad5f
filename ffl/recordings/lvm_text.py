"""The text of a LabVIEW measurement file: its header, and segments of samples with headers of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ffl.errors import InputError
from ffl.recordings.csv_text import is_number, split_line

FIRST = "LabVIEW Measurement"
END = "***End_of_Header***"
SPECIAL = ("***Start_Special***", "***End_Special***")


@dataclass(frozen=True)
class Segment:
    """Samples under one header.

    `names` and the cells of every tag (`Delta_X`, `Y_Unit_Label`, ...) stand by column, the first being
    the one of x; `rows` are lines of the file and `lines` their numbers, from 1.
    """

    names: tuple[str, ...]
    tags: Mapping[str, Sequence[str]]
    rows: Sequence[str]
    lines: Sequence[int]

    def tag(self, name: str, column: int) -> str:
        """What the header says of a column; empty where it says nothing."""
        cells = self.tags.get(name, ())
        return cells[column] if column < len(cells) else ""

    def number(self, name: str, column: int) -> float | None:
        """The same as a number, whatever its decimal separator."""
        cell = self.tag(name, column).replace(",", ".")
        return float(cell) if is_number(cell) else None


@dataclass(frozen=True)
class Measurement:
    """A file: its separator, the tags of its header (`X_Columns`, `Decimal_Separator`), its segments."""

    separator: str
    tags: Mapping[str, str]
    segments: tuple[Segment, ...]


def parse_lvm(text: str, path: Path) -> Measurement:
    """Headers and rows; special blocks and blank lines are passed over.

    Raises `InputError` with the line where the file ends within a header or holds no sample.
    """
    lines = text.split("\n")
    _blank_specials(lines)
    ends = [k for k, line in enumerate(lines) if line.startswith(END)]
    if not ends:
        raise _cut_off(path, len(lines), "header")
    # The keyword is followed by the very character that separates.
    given = [line for line in lines[: ends[0]] if line.startswith("Separator")]
    separator = (given[0][len("Separator") :] if given else "")[:1] or "\t"
    head = [split_line(line, separator) for line in lines[1 : ends[0]] if line.strip()]
    tags = {cells[0]: cells[1] if len(cells) > 1 else "" for cells in head}
    if len(ends) == 1:
        raise InputError(
            f"{path}: there is no segment of samples below the header (line {ends[0] + 1}); export it "
            "again"
        )
    tops = [ends[0] + 1] + [_top(lines, end, separator) for end in ends[2:]] + [len(lines)]
    segments = tuple(
        _segment(lines, top, end, stop, separator, path)
        for top, end, stop in zip(tops, ends[1:], tops[1:], strict=False)
    )
    return Measurement(separator, tags, segments)


def _cut_off(path: Path, line: int, what: str) -> InputError:
    return InputError(f"{path}: the file is cut off in the {what} (line {line}); export it again")


def _blank_specials(lines: list[str]) -> None:
    """Blocks that other programs put there say nothing of samples; their lines stay, to be counted."""
    within = False
    for k, line in enumerate(lines):
        if line.startswith("***"):
            starts, ends = (line.startswith(mark) for mark in SPECIAL)
            within = (within or starts) and not ends
            if starts or ends:
                lines[k] = ""
        if within:
            lines[k] = ""


def _is_tag(line: str, separator: str) -> bool:
    first = line.split(separator, 1)[0].strip()
    return bool(first) and not is_number(first.replace(",", "."))


def _top(lines: list[str], end: int, separator: str) -> int:
    """Where the header that ends at `end` begins: after the last row of numbers before it."""
    k = end
    while k > 0 and (not lines[k - 1].strip() or _is_tag(lines[k - 1], separator)):
        k -= 1
    return k


def _segment(
    lines: list[str], top: int, end: int, stop: int, separator: str, path: Path
) -> Segment:
    head = [split_line(line, separator) for line in lines[top:end] if line.strip()]
    if end + 1 >= stop or not lines[end + 1].strip():
        raise _cut_off(path, end + 1, "header, before the names of the columns")
    at = [k for k in range(end + 2, stop) if lines[k].strip()]
    last = next((k for k in at if lines[k].startswith(("Channels" + separator, "Notes"))), None)
    if last is not None:
        raise _cut_off(path, last + 1, "header of a segment")
    if not at:
        raise InputError(
            f"{path}: there is no sample below the names of line {end + 2}; export it again"
        )
    names = split_line(lines[end + 1], separator)
    if names[-1] == "Comment":  # text, and rows without one end before it
        names.pop()
    if len(at) > 1:
        cells = [min(lines[k].count(separator) + 1, len(names)) for k in at[-2:]]
        if cells[1] < cells[0]:
            raise InputError(
                f"{path}: line {at[-1] + 1} has {cells[1]} columns, the line before {cells[0]}; the "
                "file is cut off; export it again"
            )
    tags = {cells[0]: cells for cells in head}
    return Segment(tuple(names), tags, [lines[k] for k in at], [k + 1 for k in at])

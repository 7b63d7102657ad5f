"""LVM: LabVIEW measurement text, one or several segments of samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ffl.errors import InputError
from ffl.recordings.csv_reader import read_csv
from ffl.recordings.csv_text import is_number, read_text
from ffl.recordings.lvm_text import FIRST, Measurement, Segment, parse_lvm
from ffl.recordings.stamps import seconds
from ffl.recordings.table import Array, Table, sample

TIME = "t"
X = "X_Value"


def read_lvm(path: Path, header: Sequence[str] = (), skip_lines: int = 0) -> Table:
    """Channels by name with their `Y_Unit_Label`, and `t` [s]: the column X_Value, or where none is
    saved X0 + k Delta_X.

    Several segments are joined where they hold the same channels and each begins one sample time after
    the end of the one before, by its x or by its Date and Time; otherwise their channels are
    `segment_1.NAME`, `segment_2.NAME`. Without a LabVIEW header the file is read as `read_csv` does.

    Raises `InputError`: cut off; channels on different clocks; a cell that is no number.
    """
    text = read_text(path)
    if not text.raw.startswith(FIRST.encode()):
        return read_csv(path, header, skip_lines)
    if header or skip_lines:
        raise InputError(
            f"{path}: has LabVIEW's own header; leave header and skip_lines out of the mapping"
        )
    file = parse_lvm(text.raw.decode(text.encoding, "replace"), path)
    blocks = [Block(path, file, segment) for segment in file.segments]
    starts = _starts(blocks)
    sets: dict[str, tuple[int, ...]] = {"": tuple(range(len(blocks)))}
    if starts is None:
        sets = {f"segment_{k + 1}.": (k,) for k in range(len(blocks))}
    # By name: which blocks, and the column in them, None for time.
    places: dict[str, tuple[tuple[int, ...], int | None]] = {}
    names: list[str] = []
    aliases: dict[str, str] = {}
    units: dict[str, str] = {}
    for prefix, members in sets.items():
        block = blocks[members[0]]
        for column, name in block.channels():
            names.append(prefix + name)  # twice where the file has it twice, which `find` refuses
            places.setdefault(prefix + name, (members, column))
            if label := block.segment.tag("Y_Unit_Label", column):
                units[prefix + name] = label
        if block.has_time and prefix + TIME not in places:
            names.append(prefix + TIME)
            places[prefix + TIME] = (members, None)
            units[prefix + TIME] = block.time_unit
            if block.shares_x:
                aliases[prefix + X] = prefix + TIME
    lines = [line for segment in file.segments for line in segment.lines]
    return Table(
        source=str(path),
        names=tuple(names),
        load=partial(_load, blocks=blocks, starts=starts or [0.0] * len(blocks), places=places),
        units=units,
        where=sample if starts is None else (lambda k: f"line {lines[k]}"),
        aliases=aliases,
    )


@dataclass(frozen=True)
class Block:
    """One segment's numbers on demand."""

    path: Path
    file: Measurement
    segment: Segment

    @property
    def saves_x(self) -> bool:
        return self.file.tags.get("X_Columns", "One") != "No"

    @property
    def shares_x(self) -> bool:
        return self.saves_x and self.segment.names.count(X) == 1

    @property
    def time_unit(self) -> str:
        return self.segment.tag("X_Unit_Label", self.first) or "s"

    @property
    def first(self) -> int:
        """The column of the first channel with the most samples: the one that X_Value belongs to."""
        channels = [column for column, _ in self.channels()]
        return max(channels, key=lambda k: self.segment.number("Samples", k) or 0.0, default=0)

    @property
    def has_time(self) -> bool:
        dimension = self.segment.tag("X_Dimension", self.first) or "Time"
        known = self.clock_of(self.first) is not None or self.segment.number("Delta_X", self.first)
        return dimension == "Time" and bool(known)

    def channels(self) -> list[tuple[int, str]]:
        return [(k, name) for k, name in enumerate(self.segment.names) if name and name != X]

    def clock_of(self, column: int) -> int | None:
        """The column of X values that belongs to a channel: the nearest one on its left."""
        left = [k for k in range(column) if self.segment.names[k] == X]
        return left[-1] if left and self.saves_x else None

    def columns(self, wanted: Sequence[int]) -> dict[int, Array]:
        """Columns of numbers, without the empty cells that a shorter channel ends in."""
        rows, separator = self.segment.rows, self.file.separator
        if self.file.tags.get("Decimal_Separator", ",") == "," and separator != ",":
            rows = [row.replace(",", ".") for row in rows]
        try:
            table = np.loadtxt(
                rows, delimiter=separator, usecols=list(wanted), comments=None, ndmin=2
            )
            found = {column: table[:, k] for k, column in enumerate(wanted)}
        except ValueError:
            found = {column: self._cells(rows, column) for column in wanted}
        for column, values in found.items():
            stated = self.segment.number("Samples", column)
            if stated is not None and len(values) < stated:
                raise InputError(
                    f"{self.path}: '{self.segment.names[column]}' has {len(values)} samples from line "
                    f"{self.segment.lines[0]} on, its header says {stated:.0f}; the file is cut off, "
                    "export it again"
                )
        return found

    def _cells(self, rows: Sequence[str], column: int) -> Array:
        """The slow way: rows of unequal length, empty cells, or one that is no number."""
        split = (row.split(self.file.separator) for row in rows)
        cells = [row[column].strip() if column < len(row) else "" for row in split]
        while cells and not cells[-1]:
            cells.pop()
        bad = next((k for k, cell in enumerate(cells) if not is_number(cell)), None)
        if bad is not None:
            what = f"{cells[bad][:30]!r} is not a number" if cells[bad] else "there is no value"
            raise InputError(
                f"{self.path}: line {self.segment.lines[bad]}, column {self.segment.names[column]}: "
                f"{what}; correct it or leave the row out"
            )
        return np.array([float(cell) for cell in cells])

    def load(self, wanted: Sequence[int], timed: bool) -> tuple[dict[int, Array], Array]:
        """Channels by column, and where asked for the time that they share; else an empty array."""
        asked = list(wanted) or [self.first]
        clocks = [x for column in asked if (x := self.clock_of(column)) is not None]
        found = self.columns(list(dict.fromkeys([*asked, *(clocks if timed else ())])))
        if not timed:
            return found, np.zeros(0)
        clock = self._clock(asked[0], found)
        for column in asked[1:]:
            # With one column of x for all, only the header tells that it is not a channel's own.
            pairs = (
                (clock, self._clock(column, found)),
                (self._grid(asked[0]), self._grid(column)),
            )
            if not all(_same(one, other) for one, other in pairs):
                first, second = (self.segment.names[k] for k in (asked[0], column))
                raise InputError(
                    f"{self.path}: channels '{first}' and '{second}' are sampled on different clocks; "
                    "resample them to one raster and save again"
                )
        return found, clock

    def _clock(self, column: int, found: dict[int, Array]) -> Array:
        x, n = self.clock_of(column), len(found[column])
        return self._grid(column, n) if x is None else found[x][:n]

    def _grid(self, column: int, n: int = 2) -> Array:
        start, step = (self.segment.number(tag, column) or 0.0 for tag in ("X0", "Delta_X"))
        return start + step * np.arange(n)


def _same(one: Array, other: Array) -> bool:
    """Whether two clocks tell the same time, as far as both run, within a thousandth of an interval."""
    n = min(len(one), len(other))
    return n < 2 or bool(np.abs(one[:n] - other[:n]).max() <= 1e-3 * abs(one[1] - one[0]))


def _starts(blocks: Sequence[Block]) -> list[float] | None:
    """What to add to the x of each block [s] so that they follow one another; None where they do not."""
    if len(blocks) == 1:
        return [0.0]
    if len({block.segment.names for block in blocks}) > 1 or not all(b.has_time for b in blocks):
        return None
    first = blocks[0].first
    dated = seconds(
        [f"{b.segment.tag('Date', first)} {b.segment.tag('Time', first)}" for b in blocks]
    )
    starts = [0.0]
    spans = [_span(block) for block in blocks]
    for k in range(1, len(blocks)):
        (_, end, step), (begin, _, _) = spans[k - 1], spans[k]
        due = starts[-1] + end + step
        tried = [starts[-1]]
        if not isinstance(dated, int):
            tried.append(round(float(dated[k] - dated[0]), 9))  # a day's seconds are exact to 1e-11
        fits = [start for start in tried if abs(start + begin - due) < 0.5 * step]
        if not fits:
            return None
        starts.append(fits[0])
    return starts


def _span(block: Block) -> tuple[float, float, float]:
    """First and last x of a block, and the sample time; 0 where it has no sample."""
    _, clock = block.load([block.first], timed=True)
    if not len(clock):
        return 0.0, 0.0, 0.0
    if len(clock) > 1:
        return clock[0], clock[-1], (clock[-1] - clock[0]) / (len(clock) - 1)
    return clock[0], clock[0], block.segment.number("Delta_X", block.first) or 0.0


def _load(
    wanted: Sequence[str],
    *,
    blocks: Sequence[Block],
    starts: Sequence[float],
    places: dict[str, tuple[tuple[int, ...], int | None]],
) -> dict[str, Array]:
    out: dict[str, Array] = {}
    for members in dict.fromkeys(places[name][0] for name in wanted):
        own = {name: places[name][1] for name in wanted if places[name][0] == members}
        columns = [column for column in own.values() if column is not None]
        parts = [blocks[k].load(columns, timed=None in own.values()) for k in members]
        for name, column in own.items():
            out[name] = np.concatenate(
                [
                    found[column] if column is not None else clock + starts[k] * (len(members) > 1)
                    for k, (found, clock) in zip(members, parts, strict=True)
                ]
            )
    return out

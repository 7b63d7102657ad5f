"""From a file and its mapping to recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from ffl.errors import InputError
from ffl.recordings.check import check_finite, check_length, check_recording, check_time
from ffl.recordings.mapping import (
    Column,
    Columns,
    Mapping,
    Part,
    Term,
    load_mapping,
    mapping_beside,
    mapping_file_beside,
)
from ffl.recordings.readers import open_table
from ffl.recordings.recording import Array, Recording
from ffl.recordings.sampling import examine_time, other_than_mapped
from ffl.recordings.table import Table, as_numbers, split_unit
from ffl.systems.plant_file import suggest

NO_Y = "no column y in the mapping"
MOST = 12  # columns beside the mapped ones that are kept
LONG = 100_000  # samples


def read_recording(
    path: str | Path,
    mapping: Mapping | str | Path | None = None,
    *,
    name: str | None = None,
    sample_time: float | None = None,
    check: bool = True,
) -> Recording:
    """One recording from a file.

    Parameters
    ----------
    path : the file; `file.csv::test` picks the recording `test` where the mapping names several
    mapping : a `Mapping`, a mapping file or the name of a shipped one; without it NAME.map.toml
        beside the file, and without that the file's own names t, r, f, u, y, d, in a struct or group
        `rec` as `rec.t` and so on
    name : which of several recordings; otherwise the mapping's `default`
    sample_time : the model's [s]; used where the file has no time, else agreed with within 0.1 %
    check : whether faults of the time column are refused too; without it `soundness` tells them

    Raises
    ------
    InputError
        one line with file, column, row and mend.
    """
    path, name = _split_name(path, name)
    rules = _rules(path, mapping)
    known = [part.name for part in rules.recordings]
    name = name or rules.default
    if name is None and len(known) > 1:
        raise InputError(
            f"{path}: holds several recordings ({', '.join(known)}); pick one, e.g. "
            f"{path}::{known[0]}"
        )
    if name is not None and name not in known:
        said = suggest(name, known) if known else "its mapping names none"
        raise InputError(f"{path}: no recording '{name}'; {said}")
    part = rules.part(name or (known[0] if known else None))
    try:
        table = open_table(path, rules.header, rules.skip_lines)
        return _build(table, rules, part, bool(known), sample_time, check)
    except InputError as error:
        if mapping is None and (used := mapping_file_beside(path)) is not None:
            raise InputError(f"{error} (the mapping is {used}, which lies beside it)") from None
        if isinstance(mapping, str | Path) and NO_Y in str(error):
            raise InputError(f"{error} (the mapping is {mapping})") from None
        raise


def read_recordings(
    path: str | Path,
    mapping: Mapping | str | Path | None = None,
    *,
    sample_time: float | None = None,
    check: bool = True,
) -> tuple[Recording, ...]:
    """Every recording in a file, in the order of its mapping; see `read_recording`."""
    path, name = _split_name(path, None)
    rules = _rules(path, mapping)
    names: Sequence[str | None] = [name]
    if not name:
        names = [part.name for part in rules.recordings] or [None]
    return tuple(
        read_recording(path, rules, name=n, sample_time=sample_time, check=check) for n in names
    )


def _split_name(path: str | Path, name: str | None) -> tuple[Path, str | None]:
    text = str(path)
    if "::" in text and name is None and not Path(text).exists():
        text, _, name = text.rpartition("::")
    return Path(text), name


def _rules(path: Path, mapping: Mapping | str | Path | None) -> Mapping:
    if isinstance(mapping, Mapping):
        return mapping
    if mapping is not None:
        return load_mapping(mapping)
    return mapping_beside(path) or Mapping()


def _build(
    table: Table,
    rules: Mapping,
    part: Part,
    several: bool,
    sample_time: float | None,
    check: bool,
) -> Recording:
    source = f"{table.source}::{part.name}" if several else table.source
    columns, notes = _columns(table, part.columns)
    wanted = {c: getattr(columns, c) for c in Columns.model_fields if getattr(columns, c)}
    names = [n for column in wanted.values() for term in column.terms for n in _names(term)]
    arrays = table.numbers(list(dict.fromkeys(names)))
    values = {c: _evaluate(column, arrays, c, source) for c, column in wanted.items()}
    lengths = {c: len(x) for c, x in values.items() if isinstance(x, np.ndarray)}
    if len(set(lengths.values())) > 1:
        said = ", ".join(f"{c} {n}" for c, n in lengths.items())
        raise InputError(
            f"{source}: columns have unequal lengths ({said}); map columns of one recording"
        )
    n = next(iter(lengths.values()))
    whole = {c: x if isinstance(x, np.ndarray) else np.full(n, x) for c, x in values.items()}
    first, stop = _rows(part.rows, n, source)
    signals = {c: x[first:stop] for c, x in whole.items()}
    place = _placed(table.where, first)
    check_length(stop - first, source)
    for c, x in signals.items():
        check_finite(x, c, source, place)
    given = part.sample_time or (sample_time if "t" not in signals else None)
    there = ', or map t = "t": the file has such a column' if table.find("t") else ""
    interval = _sample_time(signals.get("t"), given, source, place, check, there)
    units = {c: unit for c, column in wanted.items() if (unit := _unit(column, table))}
    recording = Recording.from_signals(
        interval,
        **signals,
        start=rules.start + first * interval,
        units=units,
        source=source,
        notes=notes,
    )
    if check and sample_time is not None:
        check_recording(recording, sample_time, place)
    if any(part.columns != Columns() for part in rules.recordings):
        return recording  # the file's other columns are those of other recordings
    used = {table.find(n) for n in names}
    others = _others(table, [n for n in table.names if n not in used][: 2 * MOST], n)
    return replace(recording, others={name: x[first:stop] for name, x in others.items()})


def _others(table: Table, names: Sequence[str], samples: int) -> dict[str, Array]:
    """Of the columns that nothing is mapped from, those that are numbers, one to a sample, `MOST` of
    them. One that is no number costs a reading of every other: long recordings go without."""
    try:
        loaded = dict(table.load(names)) if names else {}
    except InputError:
        loaded = {}
        for name in names if samples <= LONG else ():
            with suppress(InputError):
                loaded |= table.load([name])
    out: dict[str, Array] = {}
    for name, values in loaded.items():
        with suppress(InputError):  # nobody asked for it
            column = as_numbers(values, name, table.source)
            if column.shape == (samples,) and np.all(np.isfinite(column)) and len(out) < MOST:
                out[split_unit(name)[0]] = column
    return out


def _columns(table: Table, mapped: Columns) -> tuple[Columns, tuple[str, ...]]:
    """The mapped columns, or where nothing is mapped the file's own t, r, f, u, y, d, y_load, those of the
    one group or struct that has them where none stands by itself."""
    notes: tuple[str, ...] = ()
    by_mapping = any(getattr(mapped, c) for c in Columns.model_fields)
    if not by_mapping:
        group = "" if table.find("y") else _group(table)
        own = {c: Column(name=group + c) for c in Columns.model_fields if table.find(group + c)}
        used = {table.find(group + c) for c in own}
        others = [name for name in table.names if name not in used]
        if others:
            notes = (f"columns not used: {', '.join(others[:10])}",)
        mapped = Columns(**own)
    absent = [c for c in Columns.model_fields if _absent(table, getattr(mapped, c))]
    if absent:
        mapped = mapped.model_copy(update=dict.fromkeys(absent))
        notes = (*notes, f"optional columns not in this file: {', '.join(absent)}")
    if mapped.y is None and by_mapping:
        raise InputError(
            f"{table.source}: {NO_Y}, the measured output; add it to its [columns] "
            f"(the file has {', '.join(table.names[:12])})"
        )
    if mapped.y is None:
        there = ", ".join(table.names[:12])
        raise InputError(
            f"{table.source}: no column y, the measured output (there is {there}); rename one or "
            f"give a mapping {Path(table.source).stem}.map.toml"
        )
    if mapped.y.constant is not None:
        raise InputError(f"{table.source}: column y cannot be a constant; map what was measured")
    return mapped, notes


def _group(table: Table) -> str:
    """`rec.` where the one struct or group `rec` has a y, with u or t beside it; nothing where none or
    several have."""
    groups = {name.rpartition(".")[0] + "." for name in table.names if "." in name}
    able = [
        g for g in groups if table.find(g + "y") and (table.find(g + "u") or table.find(g + "t"))
    ]
    return able[0] if len(able) == 1 else ""


def _absent(table: Table, column: Column | None) -> bool:
    """An optional column that names something the file does not have."""
    if column is None or not column.optional:
        return False
    return not all(table.find(name) for term in column.terms for name in _names(term))


def _names(term: Term) -> list[str]:
    return [term.name, *(name for factor in term.times for name in _names(factor))]


def _evaluate(column: Column, arrays: dict[str, Array], name: str, source: str) -> Array | float:
    if column.constant is not None:
        return column.constant
    parts = [_term(term, arrays, f"{source}: column {name}") for term in column.terms]
    # One term is passed on untouched, so that -0.0 + 0.0 changes no bit of a plain column.
    total = parts[0] if len(parts) == 1 else sum(parts[1:], start=parts[0])
    return np.atleast_1d(total)


def _term(term: Term, arrays: dict[str, Array], where: str) -> Array:
    values = arrays[term.name]
    if values.ndim == 2:
        values = _one_of(values, term, where)
    elif term.index is not None:
        raise InputError(f"{where}: '{term.name}' is one column; leave index out")
    if term.scale != 1.0:
        values = values * term.scale
    if term.offset != 0.0:
        values = values + term.offset
    for factor in term.times:
        other = _term(factor, arrays, where)
        if other.ndim and values.ndim and other.shape != values.shape:
            raise InputError(
                f"{where}: '{factor.name}' has {other.size} values, '{term.name}' {values.size}; "
                "multiply columns of one length, or by a single number"
            )
        values = values * other
    return values


def _one_of(values: Array, term: Term, where: str) -> Array:
    """Signal `index` of a table that lies either way: samples run along its longer side."""
    signals = values.T if values.shape[0] > values.shape[1] else values
    if term.index is None or term.index >= len(signals):
        said = "give" if term.index is None else f"index = {term.index} is too large; give"
        raise InputError(
            f"{where}: '{term.name}' holds {len(signals)} signals of {signals.shape[1]} samples; "
            f"{said} index = 0 to {len(signals) - 1}"
        )
    return signals[term.index]


def _rows(rows: tuple[int, ...] | None, n: int, source: str) -> tuple[int, int]:
    first, stop, _ = slice(*rows, None).indices(n) if rows and len(rows) == 2 else (0, n, 1)
    if rows and len(rows) == 1:
        first = rows[0]
    if rows and (first >= n or (len(rows) == 2 and rows[1] > n)):
        raise InputError(
            f"{source}: rows = {list(rows)} reach beyond its {n} samples; correct rows"
        )
    return first, stop


def _placed(where: Callable[[int], str], first: int) -> Callable[[int], str]:
    return lambda index: where(index + first)


def _sample_time(
    t: Array | None,
    given: float | None,
    source: str,
    place: Callable[[int], str],
    check: bool,
    there: str = "",
) -> float:
    if t is None:
        if given is None:
            raise InputError(
                f"{source}: there is no time column t; add it, or give sample_time in a mapping{there}"
            )
        return given
    found = (check_time(t, source, place) if check else examine_time(t)).sample_time
    if given is None:
        return found
    if check and (wrong := other_than_mapped(found, given)):
        raise InputError(f"{source}: {wrong}")
    return given


def _unit(column: Column, table: Table) -> str | None:
    """The mapping's unit, else the file's own where no scale has changed it."""
    plain = column.name and column.scale == 1.0 and not column.times
    return column.unit or (table.unit(column.name) if plain else None)

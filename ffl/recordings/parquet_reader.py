"""Parquet, by the optional extra `parquet`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ffl.errors import InputError
from ffl.recordings.table import Array, Table, sample, unreadable


def read_parquet(path: Path) -> Table:
    """Columns by name; a null becomes NaN and is then refused by the check."""
    try:
        from pyarrow import parquet
    except ImportError:
        raise InputError(
            f"{path}: reading Parquet needs pyarrow; install it with pip install 'ffl[parquet]'"
        ) from None
    try:
        names = tuple(parquet.read_schema(path).names)
    except Exception as error:  # pyarrow's own hierarchy of errors
        raise unreadable(path, "a Parquet file", error) from None

    def load(wanted: Sequence[str]) -> dict[str, Array]:
        try:
            table = parquet.read_table(path, columns=list(wanted))
            return {name: np.asarray(table.column(name).to_numpy()) for name in wanted}
        except Exception as error:
            raise unreadable(path, "a Parquet file", error) from None

    return Table(source=str(path), names=names, load=load, units={}, where=sample)

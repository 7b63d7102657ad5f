"""Arrow and Feather (columns as pandas, Polars and R save them), by the optional extra `parquet`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ffl.errors import InputError
from ffl.recordings.table import Array, Table, sample, unreadable


def read_arrow(path: Path) -> Table:
    """Columns by name, of a file or a stream; a null becomes NaN and is then refused by the check.

    Raises `InputError`: pyarrow is not installed; no Arrow file; cut off.
    """
    try:
        from pyarrow import ipc
    except ImportError:
        raise InputError(
            f"{path}: reading Arrow needs pyarrow; install it with pip install 'ffl[parquet]'"
        ) from None

    def opened(
        options: ipc.IpcReadOptions | None = None,
    ) -> ipc.RecordBatchFileReader | ipc.RecordBatchStreamReader:
        with path.open("rb") as file:
            whole = file.read(6) == b"ARROW1"  # otherwise a stream, which has no mark
        return (ipc.open_file if whole else ipc.open_stream)(path, options=options)

    try:
        names = tuple(opened().schema.names)
    except Exception as error:  # pyarrow's own hierarchy of errors
        raise unreadable(path, "an Arrow file", error) from None

    def load(wanted: Sequence[str]) -> dict[str, Array]:
        try:
            columns = sorted(names.index(name) for name in wanted)
            table = opened(ipc.IpcReadOptions(included_fields=columns)).read_all()
            return {name: np.asarray(table.column(name).to_numpy()) for name in wanted}
        except Exception as error:
            raise unreadable(path, "an Arrow file", error) from None

    return Table(source=str(path), names=names, load=load, units={}, where=sample)

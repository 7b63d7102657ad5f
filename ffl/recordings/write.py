"""The CSV of the contract, t,r,f,u,y[,d][,y_load], written whole or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ffl.errors import InputError
from ffl.recordings.recording import COLUMNS, Recording
from ffl.systems.atomic import write_bytes

_ROWS = 10_000


def write_recording(recording: Recording, path: str | Path) -> None:
    """Writes t and every measured column with the digits that give back the same bits.

    Columns in `missing` are left out, so that reading finds them missing again; t is always there.
    The file is written aside, synced and renamed.
    """
    path = Path(path)
    if path.suffix.lower() != ".csv":
        raise InputError(f"{path}: recordings are written as CSV; give a name ending in .csv")
    names = [
        name
        for name in COLUMNS
        if getattr(recording, name) is not None and (name == "t" or name not in recording.missing)
    ]
    table = np.column_stack([getattr(recording, name) for name in names])
    line = ",".join(["%r"] * len(names)) + "\n"
    pieces = [",".join(names) + "\n"]
    for start in range(0, len(table), _ROWS):
        block = table[start : start + _ROWS]
        pieces.append(line * len(block) % tuple(block.ravel().tolist()))
    write_bytes(path, "".join(pieces).encode())

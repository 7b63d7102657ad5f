"""NPZ: numpy's own archive of named arrays."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ffl.errors import InputError
from ffl.recordings.table import Array, Table, sample, unreadable


def read_npz(path: Path) -> Table:
    """Arrays by name; nothing pickled is opened."""
    try:
        # Opened here, since numpy leaves a damaged archive open.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            names = tuple(archive.files)
    except Exception as error:  # zip, pickle and numpy errors of a damaged file
        raise unreadable(path, "an NPZ file", error) from None
    if not names:
        raise InputError(f"{path}: there is no array in this NPZ file; write it again")

    def load(wanted: Sequence[str]) -> dict[str, Array]:
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
                return {name: archive[name] for name in wanted}
        except Exception as error:
            raise unreadable(path, "an NPZ file", error) from None

    return Table(source=str(path), names=names, load=load, units={}, where=sample)

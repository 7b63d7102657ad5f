"""NPZ: numpy's own archive of named arrays; of a structured array each field, `axis.position`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.lib.npyio import NpzFile

from ffl.errors import InputError
from ffl.recordings.table import Array, Table, sample, unreadable


def read_npz(path: Path) -> Table:
    """Arrays by name; nothing pickled is opened."""
    try:
        # Opened here, since numpy leaves a damaged archive open.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            places = {
                ".".join(place): place for key in archive.files for place in _fields(archive, key)
            }
    except Exception as error:  # zip, pickle and numpy errors of a damaged file
        raise unreadable(path, "an NPZ file", error) from None
    if not places:
        raise InputError(f"{path}: there is no array in this NPZ file; write it again")

    def load(wanted: Sequence[str]) -> dict[str, Array]:
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
                kept = {key: archive[key] for key in {places[name][0] for name in wanted}}
                return {name: _part(kept, *places[name]) for name in wanted}
        except Exception as error:
            raise unreadable(path, "an NPZ file", error) from None

    return Table(source=str(path), names=tuple(places), load=load, units={}, where=sample)


def _fields(archive: NpzFile, key: str) -> list[tuple[str, ...]]:
    """Where the columns of one array lie: itself, or each of its fields; by its header alone."""
    assert archive.zip is not None  # only once it is closed
    with archive.zip.open(f"{key}.npy" if f"{key}.npy" in archive.zip.namelist() else key) as file:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0
        kind = (read if version == (1, 0) else np.lib.format.read_array_header_2_0)(file)[2]
    return [(key, name) for name in kind.names] if kind.names else [(key,)]


def _part(kept: Mapping[str, Array], key: str, field: str | None = None) -> Array:
    return kept[key] if field is None else kept[key][field]

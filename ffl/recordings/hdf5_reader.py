"""HDF5: data sets in groups, `rec/position` or `rec.position`, and the fields of compound ones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from ffl.errors import InputError
from ffl.recordings.table import Array, Table, sample, unreadable


def read_hdf5(path: Path) -> Table:
    """Every numeric data set by its path, with dots for slashes; an attribute `unit` is taken."""
    paths: dict[str, str] = {}
    units: dict[str, str] = {}
    fields: dict[str, tuple[str, str]] = {}

    def visit(place: str, item: object) -> None:
        # MATLAB keeps the contents of cells and objects in groups that begin with #.
        if isinstance(item, h5py.Dataset) and not place.startswith("#"):
            name = place.replace("/", ".")
            for part in item.dtype.names or ():
                paths[f"{name}.{part}"] = f"{place}/{part}"
                fields[f"{place}/{part}"] = (place, part)
            if item.dtype.names:
                return
            paths[name] = place
            unit = item.attrs.get("unit", item.attrs.get("units"))
            if isinstance(unit, str | bytes):
                units[name] = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except Exception as error:  # h5py raises OSError, RuntimeError, KeyError on damaged files
        raise unreadable(path, "an HDF5 file", error) from None
    if not paths:
        raise InputError(f"{path}: there is no data set in this HDF5 file; write it again")

    def load(names: Sequence[str]) -> dict[str, Array]:
        try:
            with h5py.File(path, "r") as file:
                return {name: _numbers(file, *fields.get(p := paths[name], (p,))) for name in names}
        except Exception as error:
            raise unreadable(path, "an HDF5 file", error) from None

    slashed = {place: name for name, place in paths.items() if place != name}
    return Table(str(path), tuple(paths), load, units, sample, slashed)


def _numbers(file: h5py.File, place: str, part: str | None = None) -> Array:
    data = file[place]
    if part is not None:
        return np.asarray(data[part])
    # MATLAB writes an empty array as its dimensions, with this attribute.
    return np.zeros(0) if data.attrs.get("MATLAB_empty", 0) else np.asarray(data[()])

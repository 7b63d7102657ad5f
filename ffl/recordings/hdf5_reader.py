"""HDF5: data sets in groups, `rec/position` or `rec.position`."""

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

    def visit(place: str, item: object) -> None:
        # MATLAB keeps the contents of cells and objects in groups that begin with #.
        if isinstance(item, h5py.Dataset) and not place.startswith("#"):
            name = place.replace("/", ".")
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
                return {name: _numbers(file[paths[name]]) for name in names}
        except Exception as error:
            raise unreadable(path, "an HDF5 file", error) from None

    return Table(source=str(path), names=tuple(paths), load=load, units=units, where=sample)


def _numbers(data: h5py.Dataset) -> Array:
    # MATLAB writes an empty array as its dimensions, with this attribute.
    return np.zeros(0) if data.attrs.get("MATLAB_empty", 0) else np.asarray(data[()])

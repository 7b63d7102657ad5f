"""MAT files: level 4 and 5 by scipy, 7.3 (an HDF5 file) by h5py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io

from ffl.errors import InputError
from ffl.recordings.hdf5_reader import read_hdf5
from ffl.recordings.table import Table, sample, unreadable


def read_mat(path: Path) -> Table:
    """Variables and the fields of structs, as `rec.act_pos_mot_deg`."""
    if h5py.is_hdf5(path):
        return read_hdf5(path)
    try:
        content = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False)
    except Exception as error:  # scipy raises a dozen types on damaged files
        raise unreadable(path, "a MAT file", error) from None
    arrays: dict[str, Any] = {}
    for name, value in content.items():
        # The name is None where MATLAB stored an object of a class.
        if isinstance(name, str) and not name.startswith("__"):
            _flatten(name, value, arrays)
    if not arrays:
        raise InputError(f"{path}: there is no variable in this MAT file; save it again")
    return Table(
        source=str(path),
        names=tuple(arrays),
        load=lambda names: {name: np.asarray(arrays[name]) for name in names},
        units={},
        where=sample,
    )


def _flatten(name: str, value: Any, into: dict[str, Any]) -> None:
    if hasattr(value, "_fieldnames"):
        for field in value._fieldnames:
            _flatten(f"{name}.{field}", getattr(value, field), into)
    else:
        into[name] = value

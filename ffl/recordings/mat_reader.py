"""MAT files: level 5 by our own parser, 7.3 (an HDF5 file) by h5py."""

from __future__ import annotations

from pathlib import Path

import h5py

from ffl.errors import InputError
from ffl.recordings.hdf5_reader import read_hdf5
from ffl.recordings.mat5 import is_mat5, parse_mat5
from ffl.recordings.table import Table, sample, unreadable


def read_mat(path: Path) -> Table:
    """Variables and the fields of structs, as `rec.act_pos_mot_deg`."""
    if h5py.is_hdf5(path):
        return read_hdf5(path)
    raw = path.read_bytes()
    if not is_mat5(raw[:128]):
        raise InputError(
            f"{path}: is no MAT file of level 5 or 7.3; save it with -v7 or -v7.3 in MATLAB"
        )
    try:
        arrays = parse_mat5(raw)
    except Exception as error:  # struct, zlib, value and recursion errors of damaged bytes
        raise unreadable(path, "a MAT file", error) from None
    if not arrays:
        raise InputError(f"{path}: there is no variable in this MAT file; save it again")
    return Table(
        source=str(path),
        names=tuple(arrays),
        load=lambda names: {name: arrays[name] for name in names},
        units={},
        where=sample,
    )

"""Which reader opens which file: one line per ending."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ffl.errors import InputError
from ffl.recordings.arrow_reader import read_arrow
from ffl.recordings.csv_reader import read_csv
from ffl.recordings.hdf5_reader import read_hdf5
from ffl.recordings.lvm_reader import read_lvm
from ffl.recordings.mat_reader import read_mat
from ffl.recordings.mdf_reader import read_mdf
from ffl.recordings.npz_reader import read_npz
from ffl.recordings.parquet_reader import read_parquet
from ffl.recordings.table import Table
from ffl.recordings.tdms_reader import read_tdms
from ffl.recordings.wav_reader import read_wav
from ffl.recordings.xlsx_reader import read_xlsx

READERS: dict[str, Callable[..., Table]] = {
    ".csv": read_csv,
    ".tsv": read_csv,
    ".txt": read_csv,
    ".dat": read_csv,
    ".asc": read_csv,
    ".lvm": read_lvm,
    ".xlsx": read_xlsx,
    ".xlsm": read_xlsx,
    ".mat": read_mat,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".npz": read_npz,
    ".parquet": read_parquet,
    ".feather": read_arrow,
    ".arrow": read_arrow,
    ".mf4": read_mdf,
    ".mdf": read_mdf,
    ".tdms": read_tdms,
    ".wav": read_wav,
}
TEXT = frozenset(suffix for suffix, reader in READERS.items() if reader in (read_csv, read_lvm))


def open_table(path: Path, header: tuple[str, ...] = (), skip_lines: int = 0) -> Table:
    """The table in a file; `header` and `skip_lines` are for text only."""
    suffix = path.suffix.lower()
    if not path.exists():
        raise InputError(f"{path}: no such file; check the path")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give a recording")
    if suffix not in READERS:
        raise InputError(
            f"{path}: files ending in '{suffix}' are not read; give one of {', '.join(READERS)}"
        )
    text_only = {"header": header, "skip_lines": skip_lines}
    given = {name: value for name, value in text_only.items() if value}
    if given and suffix not in TEXT:
        raise InputError(
            f"{path}: {' and '.join(given)} in the mapping is for text files; leave it out"
        )
    try:
        return READERS[suffix](path, **given)
    except PermissionError:
        raise InputError(f"{path}: may not be read; check its permissions") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None

"""What differs where a run was done again: every number of results.json, every signal on disk.

What only the second has is no difference: earlier versions wrote less.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py

from ffl.campaign.signals import opened

TIMES = ("seconds",)  # wall times: no result


def table_differences(old: Any, new: Any, where: str = "") -> list[str]:
    """Keys (`update[1].kkt_residual`) of what `old` holds and `new` does not hold as it is."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        found = []
        for key in old:
            name = f"{where}.{key}" if where else key
            if key not in new:
                found.append(name)
            elif key not in TIMES:
                found += table_differences(old[key], new[key], name)
        return found
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        pairs = enumerate(zip(old, new, strict=True))
        return [name for k, (a, b) in pairs for name in table_differences(a, b, f"{where}[{k}]")]
    return [] if old == new else [where]


def signal_differences(old: Path, new: Path) -> list[str]:
    """Datasets of the HDF5 file `old` that are not the same to the bit in `new`."""
    with opened(old) as file:
        before = _datasets(file)
    with opened(new) as file:
        after = _datasets(file)
    return [name for name in before if before[name] != after.get(name)]


def _datasets(file: h5py.File) -> dict[str, tuple[Any, ...]]:
    found = {}

    def keep(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and name not in TIMES:
            values = item[()]
            found[name] = (item.shape, item.dtype.str, values.tobytes())

    file.visititems(keep)
    return found

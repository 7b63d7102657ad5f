"""MDF 3 and 4 (measurement data of test benches and cars), by the optional extra `mdf`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ffl.errors import InputError
from ffl.recordings.table import Array, Table, sample, unreadable

TIME = "t"


def read_mdf(path: Path) -> Table:
    """Channels by name, `t` for the clock they share; channels on different clocks are refused."""
    try:
        from asammdf import MDF
    except ImportError:
        raise InputError(
            f"{path}: reading MDF needs asammdf; install it with pip install 'ffl[mdf]'"
        ) from None
    try:
        with MDF(path) as file:
            channels = [
                (channel.name, channel.unit or "")
                for group in file.groups
                for channel in group.channels
                if channel.channel_type not in (2, 3)  # masters: the clocks themselves
            ]
    except Exception as error:  # asammdf raises its own, struct and OS errors
        raise unreadable(path, "an MDF file", error) from None

    def load(wanted: Sequence[str]) -> dict[str, Array]:
        named = [name for name in wanted if name != TIME] or [channels[0][0]]
        try:
            with MDF(path) as file:
                signals = {name: file.get(name) for name in named}
        except Exception as error:
            raise unreadable(path, "an MDF file", error) from None
        clock = signals[named[0]].timestamps
        for name in named[1:]:
            if not np.array_equal(signals[name].timestamps, clock):
                raise InputError(
                    f"{path}: channels '{named[0]}' and '{name}' are sampled on different clocks; "
                    "resample them to one raster and save again"
                )
        arrays = {name: np.asarray(signals[name].samples) for name in named}
        return {name: clock if name == TIME else arrays[name] for name in wanted}

    names = tuple(dict.fromkeys([TIME, *(name for name, _ in channels)]))
    units = {name: unit for name, unit in channels if unit}
    return Table(source=str(path), names=names, load=load, units=units, where=sample)

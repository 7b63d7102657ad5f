"""TDMS (National Instruments' binary measurement files), by the optional extra `tdms`."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ffl.errors import InputError
from ffl.recordings.table import Array, Table, sample, shortest, unreadable

TIME = "t"
SKEW = 0.01
"""Starts of channels may differ by this fraction of the sample time."""


def read_tdms(path: Path) -> Table:
    """Channels by name, by `group.channel` where several groups have that name; the property
    `unit_string` is their unit.

    `t` [s] is a channel of that name; or else k `wf_increment` from `wf_start_offset` on, for channels
    of the same `wf_start_time`.

    Raises `InputError`: npTDMS is not installed; cut off; channels on different clocks.
    """
    try:
        import nptdms
    except ImportError:
        raise InputError(
            f"{path}: reading TDMS needs npTDMS; install it with pip install 'ffl[tdms]'"
        ) from None
    # What it would print beside our one line.
    nptdms.log.log_manager.set_level("ERROR")
    if _is_cut_off(path):
        raise InputError(f"{path}: the file is cut off in its last segment; export it again")
    try:
        # A file handle, since by its path npTDMS would trust a stale index file beside it.
        with path.open("rb") as stream, nptdms.TdmsFile.open(stream, raw_timestamps=True) as file:
            channels = [channel for group in file.groups() for channel in group.channels()]
            pairs = [(channel.group_name, channel.name) for channel in channels]
            properties = [dict(channel.properties) for channel in channels]
    except Exception as error:  # npTDMS raises struct, value, key and OS errors on damaged files
        raise unreadable(path, "a TDMS file", error) from None
    if not pairs:
        raise InputError(f"{path}: there is no channel in this TDMS file; save it again")
    names, aliases = shortest(pairs)
    places = dict(zip(names, range(len(names)), strict=True))
    units = {n: unit for n, k in places.items() if (unit := properties[k].get("unit_string"))}
    clocked = [name for name, k in places.items() if _increment(properties[k])]
    if clocked and TIME not in places:
        names, units = (*names, TIME), units | {TIME: "s"}

    def load(wanted: Sequence[str]) -> dict[str, Array]:
        named = [name for name in wanted if name in places] or clocked[:1]
        try:
            with path.open("rb") as stream, nptdms.TdmsFile.open(stream) as file:
                arrays = {}
                for name in named:
                    group, channel = pairs[places[name]]
                    arrays[name] = np.asarray(file[group][channel][:])
        except Exception as error:
            raise unreadable(path, "a TDMS file", error) from None
        if TIME in wanted and TIME not in places:
            arrays[TIME] = _clock({name: properties[places[name]] for name in named}, arrays, path)
        return {name: arrays[name] for name in wanted}

    return Table(
        source=str(path), names=names, load=load, units=units, where=sample, aliases=aliases
    )


def _is_cut_off(path: Path) -> bool:
    """Whether the last segment says it is longer than the file. Every segment begins with 28 bytes: a
    mark, what is in it (64: big endian), a version, and its length behind these 28 (all ones where
    LabVIEW did not come to say it)."""
    size, place = path.stat().st_size, 0
    with path.open("rb") as file:
        while place < size:
            file.seek(place)
            lead = file.read(28)
            if lead[:4] != b"TDSm"[: len(lead)]:
                return False  # not TDMS at all, for the library to say
            if len(lead) < 28:
                return True
            order = ">" if lead[4] & 64 else "<"
            place += 28 + struct.unpack(order + "Q", lead[12:20])[0]
    return place > size


def _increment(properties: Mapping[str, Any]) -> float:
    """The sample time [s], 0 where the channel has none."""
    found = properties.get("wf_increment")
    return float(found) if isinstance(found, float | int) and found > 0 else 0.0


def _clock(
    channels: Mapping[str, Mapping[str, Any]], arrays: Mapping[str, Array], path: Path
) -> Array:
    """The time [s] that channels with a sample time share."""
    clocked = [name for name in channels if _increment(channels[name])]
    if not clocked:
        raise InputError(
            f"{path}: channel '{next(iter(channels))}' has no wf_increment; leave t out and give "
            "sample_time in a mapping"
        )
    first = channels[clocked[0]]
    step = _increment(first)
    for name in clocked[1:]:
        other = channels[name]
        if abs(_increment(other) - step) > 1e-6 * step or abs(_shift(first, other)) > SKEW * step:
            raise InputError(
                f"{path}: channels '{clocked[0]}' and '{name}' are sampled on different clocks; "
                "resample them to one raster and save again"
            )
    return float(first.get("wf_start_offset", 0.0)) + step * np.arange(len(arrays[clocked[0]]))


def _shift(one: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    """By how much the second channel starts later [s]; a time is whole seconds and 2^-64 of one."""
    shift = float(other.get("wf_start_offset", 0.0)) - float(one.get("wf_start_offset", 0.0))
    a, b = one.get("wf_start_time"), other.get("wf_start_time")
    if a is None or b is None:
        return shift
    if hasattr(a, "second_fractions") and hasattr(b, "second_fractions"):
        shift += (b.seconds - a.seconds) + (b.second_fractions - a.second_fractions) / 2**64
    return shift

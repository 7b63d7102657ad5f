"""WAV: sound cards and vibration loggers; the sample time by the rate in the header."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from scipy.io import wavfile

from ffl.errors import InputError
from ffl.recordings.table import Array, Table, sample, unreadable


def read_wav(path: Path) -> Table:
    """`channel_1`, `channel_2`, ... in parts of full scale (1.0; floats as they stand), and `t` [s]
    counted from 0 by the rate.

    Raises `InputError`: no WAV file; cut off; no sample.
    """
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")  # of chunks that are not sound
            rate, samples = wavfile.read(path)
    except Exception as error:  # scipy raises value, struct and memory errors on damaged files
        raise unreadable(path, "a WAV file", error) from None
    if any("EOF" in str(warning.message) for warning in said):
        raise InputError(f"{path}: the file is cut off; export it again")
    if not samples.size or rate <= 0:
        raise InputError(f"{path}: there is no sample in this WAV file; record it again")
    signals = _full_scale(samples if samples.ndim == 2 else samples[:, None]).T
    channels = {f"channel_{k + 1}": signal for k, signal in enumerate(signals)}
    arrays = {"t": 1.0 / rate * np.arange(len(samples)), **channels}
    return Table(
        source=str(path),
        names=tuple(arrays),
        load=lambda names: {name: arrays[name] for name in names},
        units={"t": "s"},
        where=sample,
    )


def _full_scale(samples: Array) -> Array:
    """Integers in parts of the largest; eight bits are unsigned, 24 stand in the upper ones of 32."""
    if samples.dtype.kind == "f":
        return samples.astype(float)
    middle = 128.0 if samples.dtype.kind == "u" else 0.0
    return (samples - middle) / 2.0 ** (8 * samples.dtype.itemsize - 1)

"""Recordings at another sample time, by a rational factor and a zero-phase filter."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np

from ffl.errors import InputError
from ffl.recordings.recording import Array, Recording
from ffl.recordings.sampling import accepts

LARGEST_FACTOR = 1000
_LOBES = 20
_CUT = 0.9


def resample_recording(recording: Recording, sample_time: float) -> Recording:
    """The recording at `sample_time` [s]; itself, where the two agree within 0.1 %.

    Every column is interpolated by up/down = old/new sample time (a fraction of whole numbers up
    to 1000) through one symmetric FIR low-pass (Kaiser, beta 8: 80 dB, 20 lobes each side, cut at
    0.9 of the lower Nyquist frequency): zero phase, and the same for all columns, so that linear
    relations between them hold below the cut. The ends are continued by reflection in the end
    points; about 20 of the slower samples at each end still feel it. The result says all this in
    its `notes`. A command held between samples is given back as the smooth curve through them.

    Raises `InputError` where no such fraction is within 1e-6 of the ratio.
    """
    old = recording.sample_time
    if not (np.isfinite(sample_time) and sample_time > 0):
        raise InputError(f"sample_time = {sample_time:g} s; give a positive number of seconds")
    if accepts(old, sample_time):
        return recording
    ratio = Fraction(old / sample_time).limit_denominator(LARGEST_FACTOR)
    up, down = ratio.numerator, ratio.denominator
    if up == 0 or up > LARGEST_FACTOR or abs(float(ratio) / (old / sample_time) - 1) > 1e-6:
        raise InputError(
            f"{recording.source}: sample times {old:.9g} s and {sample_time:.9g} s are in no ratio "
            f"of whole numbers up to {LARGEST_FACTOR}; correct one of them"
        )
    n = (len(recording) - 1) * up // down + 1
    signals = {
        name: _resampled(x, up, down, n)
        for name in ("r", "f", "u", "y", "d", "y_load")
        if (x := getattr(recording, name)) is not None
    }
    note = (
        f"resampled from {old:.6g} s to {sample_time:.6g} s by {up}/{down}, zero-phase low-pass at "
        f"{_CUT * 0.5 / max(old, sample_time):.4g} Hz"
    )
    return replace(
        recording,
        t=recording.t[0] + sample_time * np.arange(n),
        r=signals["r"],
        f=signals["f"],
        u=signals["u"],
        y=signals["y"],
        d=signals.get("d"),
        y_load=signals.get("y_load"),
        sample_time=sample_time,
        notes=(*recording.notes, note),
    )


def _resampled(x: Array, up: int, down: int, n: int) -> Array:
    if np.ptp(x) == 0 or np.isnan(x).all():
        return np.full(n, x[0])
    factor = max(up, down)
    from scipy.signal import firwin, resample_poly  # half a second to import

    taps = firwin(2 * _LOBES * factor + 1, _CUT / factor, window=("kaiser", 8.0))
    # A whole number of `down` samples before the start keeps sample 0 on the grid.
    pad = down * (-(-2 * _LOBES * factor // (up * down)))
    pad = min(pad, (len(x) - 1) // down * down)
    before = 2 * x[0] - x[pad:0:-1]
    after = 2 * x[-1] - x[-2 : -2 - pad : -1]
    y = resample_poly(np.concatenate([before, x, after]), up, down, window=taps)
    start = pad * up // down
    return y[start : start + n]

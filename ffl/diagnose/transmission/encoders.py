"""Two encoders of one motion: their difference and the motion they share, smoothed alike.

Every signal passes one Gaussian kernel, whose derivatives give velocity and acceleration and whose
shift reads the second encoder at another time, by fractions of a sample too: what is regressed on what
has seen the same filter. The motion is the mean of both encoders weighted by their noise; its noise is
then uncorrelated with that of their difference, so that noise alone explains nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.signal

from ffl.errors import InputError
from ffl.recordings import Recording
from ffl.systems.state_space import Array

CUT = 0.1325  # times 1/s: the Gaussian of s seconds is at -3 dB there
REACH = 5.0  # standard deviations of the kernel on either side
MOST = 0.9  # of the power of the acceleration asked for
BAND = 3.0  # times the frequency below which that lies: as far up the encoders are compared
FASTEST = 0.1  # of the sampling rate, which a kernel of 1.3 samples still resolves
SLOWEST = 40  # cut-off times duration: less would leave too few samples
FOLLOWS = 0.5  # correlation below which one signal does not follow another
UNIT = 20.0  # a factor between the encoders beyond which one of them is in another unit


@dataclass(frozen=True)
class Pair:
    """One recording's encoders on a coarse grid of `step` s, (n,) each: `difference` y - y_load(t +
    shift), `measured` the mean position, `position` and its derivatives in output units as far as they are
    foretold, `unforetold` the rest of the acceleration, `load` -d and `command` u in N (None where not
    recorded)."""

    source: str
    t: Array
    step: float
    width: float
    difference: Array
    measured: Array
    position: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    unforetold: Array
    load: Array | None
    load_rate: Array | None
    command: Array | None

    @property
    def sent(self) -> Array:
        """The command; for terms that stand only where all recordings have it."""
        assert self.command is not None
        return self.command


@dataclass(frozen=True)
class Smoother:
    """A Gaussian of `width` s, evaluated every `every` samples of `sample_time` s."""

    width: float
    every: int
    sample_time: float

    @classmethod
    def at(cls, cut: float, sample_time: float) -> Smoother:
        width = CUT / cut
        return cls(width, max(1, round(1.5 * width / sample_time)), sample_time)

    def margin(self, shift: float) -> int:
        """Samples at either end that feel the end."""
        return int(np.ceil((REACH * self.width + abs(shift)) / self.sample_time)) + 1

    def __call__(self, x: Array, derivative: int = 0, shift: float = 0.0, margin: int = 0) -> Array:
        """d^k/dt^k of x(t + shift), smoothed, at every `every`-th sample from `margin` on."""
        reach = self.margin(shift)
        margin = max(margin, reach)
        s = np.arange(-reach, reach + 1) * self.sample_time + shift
        z = s / self.width
        kernel = np.exp(-0.5 * z**2)
        kernel /= kernel.sum()
        hermite = (1.0, -z, z**2 - 1.0, 3.0 * z - z**3)[derivative]
        kernel = kernel * hermite / self.width**derivative
        middle = float(np.mean(x))  # a large offset would lose digits
        smooth = scipy.signal.fftconvolve(x - middle, kernel, mode="same")
        kept = smooth[margin : len(x) - margin : self.every]
        return kept + middle if derivative == 0 else kept


def comparable(recordings: Sequence[Recording], drives: Sequence[Array]) -> list[Recording]:
    """Recordings in which both encoders follow a motion; refuses, in one line, second encoders that can
    never be compared with the first. `drives`: what moves the machine."""
    kept = []
    for r, drive in zip(recordings, drives, strict=True):
        other = r.y_load
        if other is None:
            continue
        bad = np.flatnonzero(~np.isfinite(other))
        if len(bad):
            raise InputError(
                f"{r.source}: sample {bad[0]}, column y_load: {other[bad[0]]} is not a number that can "
                "be used; correct it or cut the recording there"
            )
        if np.ptp(other) == 0.0:
            raise InputError(
                f"{r.source}: y_load is constant at {other[0]:g}: the second encoder measured nothing; "
                "leave the column out, or map the right one"
            )
        a, b = r.y - r.y.mean(), other - other.mean()
        power = float(a @ a) * float(b @ b)
        if power == 0.0:
            continue
        factor = float(a @ b) / float(a @ a)
        alike = _alike(r.y, other)
        if alike < FOLLOWS and (np.ptp(drive) == 0.0 or _alike(r.y, drive) < FOLLOWS):
            continue  # nothing moves it: neither encoder says anything of the other
        if alike < FOLLOWS:
            raise InputError(
                f"{r.source}: y_load does not follow y (correlation {alike:.2g}): they measure "
                "different motions; map the encoder behind the same transmission"
            )
        if factor < 0:
            raise InputError(
                f"{r.source}: y_load follows {factor:.4g} y: one of them has the wrong sign; give it a "
                "negative scale in a mapping"
            )
        if not 1.0 / UNIT < factor < UNIT:
            raise InputError(
                f"{r.source}: y_load follows {factor:.4g} y: one of them is in another unit, or on the "
                f"other side of the gear; give y_load scale = {1.0 / factor:.3g} in a mapping"
            )
        kept.append(r)
    return kept


def _alike(x: Array, other: Array) -> float:
    """Magnitude of the correlation."""
    a, b = x - x.mean(), other - other.mean()
    power = float(a @ a) * float(b @ b)
    return abs(float(a @ b)) / float(np.sqrt(power)) if power > 0.0 else 0.0


def noise_of(x: Array) -> float:
    """Standard deviation of the white noise on a smooth signal, from its fourth differences."""
    return float(np.median(np.abs(np.diff(x, 4))) / 0.6745 / np.sqrt(70.0))


def cut_off(drives: Sequence[Array], recordings: Sequence[Recording]) -> float:
    """`BAND` times the frequency (Hz) below which nine tenths of the acceleration are that the `drives`
    ask for, within what the recordings resolve. What shakes faster, ripples that excite a resonance
    say, is no torque that could be foretold."""
    step = recordings[0].sample_time
    longest = max(r.duration for r in recordings)
    found = SLOWEST / longest
    for x in drives:
        n = 2 ** int(np.ceil(np.log2(len(x))))
        power = np.abs(np.fft.rfft(np.diff(x, 2) * np.hanning(len(x) - 2), n)) ** 2
        total = np.cumsum(power)
        if total[-1] > 0.0:
            at = int(np.searchsorted(total, MOST * total[-1]))
            found = max(found, BAND * at / (n * step))
    return float(np.clip(found, SLOWEST / longest, FASTEST / step))


def pair(r: Recording, smoother: Smoother, shift: float, margin: int, force: float) -> Pair:
    """The recording's encoders smoothed, y_load read `shift` s later; `force` N per input unit."""
    y, y_load = r.y, r.y_load
    assert y_load is not None  # they are two
    noise, other = noise_of(y), noise_of(y_load)
    share = 0.5 if noise + other == 0.0 else noise**2 / (noise**2 + other**2)
    x, v, a, jerk = (
        (1.0 - share) * smoother(y, k, 0.0, margin) + share * smoother(y_load, k, shift, margin)
        for k in range(4)
    )
    difference = smoother(y, 0, 0.0, margin) - smoother(y_load, 0, shift, margin)
    load = rate = command = None
    held = -0.5 * r.sample_time  # what is held for a sample acts half a sample later
    if r.d is not None and np.ptp(r.d) > 0.0:
        load = -force * smoother(r.d, 0, held, margin)
        rate = -force * smoother(r.d, 1, held, margin)
    if np.all(np.isfinite(r.u)) and np.ptp(r.u) > 0.0:
        command = force * smoother(r.u, 0, held, margin)
    t = r.t[margin : len(r) - margin : smoother.every]
    step = smoother.every * r.sample_time
    return Pair(
        r.source, t, step, smoother.width, difference, x, x, v, a, jerk, 0.0 * t, load, rate,
        command,
    )  # fmt: skip

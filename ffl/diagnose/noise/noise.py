"""Noise with physics in it: sensor noise through S, force noise through SP, each white and coloured.

A free autoregressive fit swallows the physics it is to reveal (one sinusoid: gain 79 with AR(24)
against 47,885 with this model), so the only freedom is six numbers with a meaning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy.optimize
import scipy.signal

from ffl.diagnose.noise.whittle import first_order, whittle
from ffl.systems.loop import Loop
from ffl.systems.state_space import Array

LASTING = 0.25  # of a cycle in the longest recording: slower noise is a constant
SLOWEST = 1.0  # Hz: lowest corner of coloured noise; what is slower is physics
SLOW = 0.02  # of the sampling rate: the same for processes that are sampled slowly
LOUDEST = 2.5  # most coloured noise beside the white: a louder one would pass friction for noise
GUESSED = 10.0  # times a guess of the force noise, where none is stated: louder than a drive is
ROUGH = 30.0  # Hz: corner of noise that is partly coloured


@dataclass(frozen=True)
class Noise:
    """Standard deviations of white and first-order parts and their corners in Hz.

    `sensor`, `sensor_coloured` in output units, `force`, `force_coloured` in input units.
    """

    sensor: float
    force: float
    sensor_coloured: float = 0.0
    sensor_corner: float = 30.0
    force_coloured: float = 0.0
    force_corner: float = 20.0

    def density(self, paths: Paths) -> Array:
        """Power of y's noise per sample at the frequencies of `paths`; its mean is the variance."""
        sensor = self.sensor**2 + self.sensor_coloured**2 * paths.colour(self.sensor_corner)
        force = self.force**2 + self.force_coloured**2 * paths.colour(self.force_corner)
        return paths.sensor * sensor + paths.force * force

    def scaled(self, factor: float) -> Noise:
        """All parts times `factor`."""
        return replace(
            self,
            sensor=self.sensor * factor,
            force=self.force * factor,
            sensor_coloured=self.sensor_coloured * factor,
            force_coloured=self.force_coloured * factor,
        )


@dataclass(frozen=True)
class Paths:
    """|S|^2 and |SP|^2 at `frequencies` (Hz): how sensor and force noise reach y."""

    frequencies: Array
    sensor: Array
    force: Array
    sample_time: float

    @classmethod
    def of(cls, loop: Loop, frequencies: Array) -> Paths:
        response = loop.system.response(frequencies)
        return cls(
            frequencies,
            np.abs(response[:, 0, 3]) ** 2,
            np.abs(response[:, 0, 2]) ** 2,
            loop.system.sample_time,
        )

    @cached_property
    def cosine(self) -> Array:
        """cos(2 pi f T)."""
        return np.cos(2 * np.pi * self.frequencies * self.sample_time)

    def colour(self, corner: float) -> Array:
        """Density of a first-order process of unit variance with its corner at `corner` Hz."""
        density, _ = first_order(float(corner), self.sample_time, self.cosine)
        return density  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Spectrum:
    """A smoothed periodogram: `power` per sample at `frequencies`, each worth `weight` pairs."""

    frequencies: Array
    power: Array
    weight: Array


def spectrum(
    residuals: Sequence[Array],
    sample_time: float,
    quantile: float | None,
    segment: int | None = None,
) -> Spectrum:
    """Power of the residuals in bands about a tenth of an octave wide, from segments of 2048 samples
    or `segment`.

    `quantile` None: the mean over segments and bins. Else that quantile over segments and the bins
    of a band, divided by what it would be for pure noise: a lower envelope that a mismatch confined
    to some of the segments leaves alone. The mean over all is what a likelihood is of, and holds what
    stands still too: without it a residual far from zero was judged by noise that knows of none (a force
    left out of a two-mass stage: 1,400 nats against the truth). The envelope is of what moves.
    """
    detrend: str | bool = False if quantile is None else "constant"
    shortest = min(len(x) for x in residuals)
    length = segment or int(min(2048, max(64, 2 ** int(np.log2(max(shortest // 3, 64))))))
    parts = []
    for x in residuals:
        n = min(length, len(x))
        frequencies, _, table = scipy.signal.spectrogram(
            np.asarray(x), 1 / sample_time, "hann", n, n // 2, length, detrend
        )
        parts.append(table * (0.5 / sample_time))
    table = np.concatenate(parts, axis=1)
    edges = [1]
    while edges[-1] < len(frequencies) - 1:
        edges.append(max(edges[-1] + 1, round(edges[-1] * 1.12)))
    edges[-1] = min(edges[-1], len(frequencies) - 1)
    out_f, out_p, out_w = [], [], []
    for low, high in pairwise(edges):
        cell = table[low:high]
        if quantile is None:
            level = float(np.mean(cell))
        else:
            level = float(np.quantile(cell, quantile) / -np.log(1 - quantile))
        out_f.append(float(np.mean(frequencies[low:high])))
        out_p.append(max(level, 1e-300))
        out_w.append(cell.size * 0.5)  # half overlapping segments: about half are independent
    return Spectrum(np.array(out_f), np.array(out_p), np.array(out_w))


def fit_noise(
    loop: Loop,
    residuals: Sequence[Array],
    start: Noise,
    *,
    quantile: float | None = None,
    coloured: bool = True,
    floor: float = 0.0,
    belief: float = 0.0,
    segment: int | None = None,
    slowest: float = SLOWEST,
) -> Noise:
    """Whittle's likelihood, sum of log(density) + power/density, over the six numbers.

    `floor`: least sensor noise (what the encoder's resolution alone gives). `belief`: weight of
    `start` as a prior on the two white parts, in units of 1/(standard deviation of the logarithm)^2.
    `slowest`: lowest corner of the coloured parts, Hz; 0: as slow as the recordings can hold.
    """
    seen = spectrum(residuals, loop.system.sample_time, quantile, segment)
    paths = Paths.of(loop, seen.frequencies)
    weight = seen.weight * min(1.0, 4000.0 / seen.weight.sum())
    levels = _levels(seen, paths, floor)
    duration = max(len(x) for x in residuals) * loop.system.sample_time
    slowest = min(slowest, SLOW / loop.system.sample_time)
    least = max(slowest, 2.0 / duration) if slowest else LASTING / duration
    corner = np.log([least, 0.25 / loop.system.sample_time])
    share = np.log([1e-3, LOUDEST])
    ranges = [np.log(level) + np.array([-9.0, 9.0]) for level in levels]
    bounds = [ranges[0], ranges[1], share, corner, share, corner]
    believed = np.log([max(start.sensor, 1e-6 * levels[0]), max(start.force, 1e-6 * levels[1])])

    def unpack(p: Array) -> Noise:
        sensor, *rest = (float(v) for v in np.exp(p))
        if len(rest) == 1:
            return Noise(float(np.hypot(sensor, floor)), rest[0])
        return Noise(
            float(np.hypot(sensor, floor)), rest[0], rest[1] * sensor, rest[2], rest[3] * rest[0], rest[4]
        )  # fmt: skip

    known = paths.sensor, paths.force, paths.cosine, paths.sample_time, seen.power, weight, floor

    def cost(p: Array) -> tuple[float, Array]:
        value, gradient = whittle(p, *known)
        away = p[:2] - believed
        gradient[:2] += 2.0 * belief * away
        return value + belief * float(away @ away), gradient

    white, slow = np.log(levels), np.log([0.1, 0.3, 1.0])
    begin: list[list[float] | Array]
    if coloured:
        begin = [
            [white[0], white[1] + slow[1], slow[0], np.log(30.0), slow[2], np.log(15.0)],
            [white[0], white[1], slow[1], np.log(30.0), slow[0], np.log(5.0)],
            [white[0], white[1] + slow[0], slow[2], np.log(150.0), slow[2], np.log(5.0)],
        ]
        if start.force_coloured > 0 and start.sensor_coloured > 0:
            corners = [start.sensor_corner, start.force_corner]
            shares = [start.sensor_coloured / start.sensor, start.force_coloured / start.force]
            begin.append(
                list(
                    np.log(
                        [start.sensor, start.force, shares[0], corners[0], shares[1], corners[1]]
                    )
                )
            )
    else:
        bounds, begin = bounds[:2], [white, believed]
    low, high = np.array(bounds).T
    found = [
        scipy.optimize.minimize(
            cost,
            np.clip(p, low, high),
            jac=True,
            method="L-BFGS-B",
            bounds=list(zip(low, high, strict=True)),
        )
        for p in begin
    ]
    return unpack(min(found, key=lambda f: f.fun).x)


def _levels(seen: Spectrum, paths: Paths, floor: float) -> tuple[float, float]:
    """First guesses of sensor and force noise: the high frequencies, and what is left below."""
    sensor2 = seen.power / np.maximum(paths.sensor, 1e-300)
    high = seen.frequencies > 0.5 * seen.frequencies[-1]
    sensor = np.sqrt(np.median(sensor2[high]))
    left = np.maximum(seen.power - paths.sensor * sensor**2, 0.05 * seen.power)
    force = np.sqrt(np.median((left / np.maximum(paths.force, 1e-300))[~high]))
    return float(max(sensor, floor, 1e-300)), float(max(force, 1e-300))


def partly_coloured(noise: Noise) -> Noise:
    """The same power, half of it first-order: white noise alone, where some of it is slow, makes the
    filter trust its state too much and lose it."""
    sensor, force = noise.sensor / np.sqrt(2.0), noise.force / np.sqrt(2.0)
    return Noise(sensor, force, sensor, ROUGH, force, ROUGH)


def louder(noise: Noise, stated: Noise) -> float:
    """How many times louder force or sensor are than stated."""
    force = np.hypot(noise.force, noise.force_coloured) / np.hypot(
        stated.force, stated.force_coloured
    )
    sensor = np.hypot(noise.sensor, noise.sensor_coloured)
    return float(max(force, sensor / np.hypot(stated.sensor, stated.sensor_coloured)))

"""References: point-to-point moves, multisines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.optimize import brentq

from ffl.errors import InputError
from ffl.systems.state_space import Array


@dataclass(frozen=True)
class Move:
    """One point-to-point move within limits (SI units of the output; `snap` limits the jerk rate).

    Without `snap` the jerk rises over half the time the acceleration takes to rise.
    """

    start: float
    distance: float
    velocity: float
    acceleration: float
    jerk: float
    snap: float | None = None


def move_times(move: Move) -> tuple[float, float, float, float]:
    """Durations T1 >= T2 + T3 + T4, T2 >= T3 + T4, T3 >= T4 of the four averaging windows, in s.

    A step of `distance` averaged over windows T1 .. T4 has peak velocity D/T1, acceleration
    D/(T1 T2), jerk D/(T1 T2 T3) and snap D/(T1 T2 T3 T4) exactly, as long as equal-signed pulses do
    not overlap, which is what the inequalities ensure. Where the move is too short for its limits,
    the highest attainable velocity, acceleration or jerk replaces the limit.
    """
    distance = abs(move.distance)
    if distance == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    limits = {"velocity": move.velocity, "acceleration": move.acceleration, "jerk": move.jerk}
    if move.snap is not None:
        limits["snap"] = move.snap
    for name, value in limits.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"move at {move.start} s: {name} = {value} must be positive")
    snap = move.snap if move.snap is not None else 2.0 * move.jerk**2 / move.acceleration

    def jerk_for(acceleration: float) -> float:
        return min(move.jerk, float(np.sqrt(acceleration * snap)))

    def ramp(acceleration: float) -> float:
        """T3 + T4 for a peak acceleration."""
        jerk = jerk_for(acceleration)
        return acceleration / jerk + jerk / snap

    def acceleration_for(velocity: float) -> float:
        full = move.acceleration
        if velocity / full >= ramp(full):
            return full
        return _highest(lambda a: velocity / a - ramp(a), full)

    def excess(velocity: float) -> float:
        a = acceleration_for(velocity)
        return distance / velocity - (velocity / a + ramp(a))

    v = move.velocity
    if excess(v) < 0:
        v = _highest(excess, v)
    a = acceleration_for(v)
    j = jerk_for(a)
    return distance / v, v / a, a / j, j / snap


def _highest(room: Callable[[float], float], limit: float) -> float:
    """Where `room`, which falls and is negative at `limit`, ends."""
    low = limit
    while room(low) < 0:
        low *= 1e-3
    return float(brentq(room, low, limit, xtol=1e-15 * limit))


def moves(sequence: list[Move], duration: float, sample_time: float) -> Array:
    """Reference of `duration` seconds through the moves, at rest before, between and after them.

    Each move is a step averaged over four windows (fourth order: finite jerk and snap), whole
    samples long, rounded up so that no limit is exceeded. Returns shape (round(duration / T),).
    """
    n = round(duration / sample_time)
    if n < 2:
        raise InputError(f"reference.duration = {duration} s holds fewer than 2 samples")
    reference = np.zeros(n)
    free_from = 0
    for index, move in enumerate(sequence):
        if not np.isfinite(move.distance):
            raise InputError(f"reference.moves[{index}].distance = {move.distance} must be finite")
        if move.distance == 0:
            continue
        windows = [max(1, int(np.ceil(t / sample_time - 1e-9))) for t in move_times(move)]
        start = round(move.start / sample_time)
        stop = start + sum(windows)
        if start < max(free_from, 1):
            raise InputError(
                f"reference.moves[{index}].start = {move.start} s: the reference must be at rest "
                f"until then; start at {max(free_from, 1) * sample_time:g} s or later"
            )
        if stop > n:
            raise InputError(
                f"reference.duration = {duration} s ends before moves[{index}] does "
                f"({stop * sample_time:g} s); lengthen it"
            )
        velocity = np.ones(1)
        for window in windows:
            velocity = np.convolve(velocity, np.full(window, 1.0 / window))
        reference[start : start + len(velocity)] += move.distance * np.cumsum(velocity)
        reference[start + len(velocity) :] += move.distance
        free_from = stop
    return reference


def multisine(
    band: tuple[float, float],
    rms: float,
    duration: float,
    sample_time: float,
    rng: Generator,
    rest: float = 0.0,
    taper: float = 0.0,
) -> Array:
    """Random-phase multisine with all lines of 1/(duration - 2 rest) in `band` (Hz), RMS `rms` between
    the rests.

    `rest` seconds of zero stand before and after; `taper` seconds of raised cosine start and end
    the signal so that it begins and ends at rest, half of what lies between the rests at most.
    """
    n, n_rest = round(duration / sample_time), round(rest / sample_time)
    m = n - 2 * n_rest
    if m < 8:
        raise InputError(f"reference.duration = {duration} s leaves no room beside rest = {rest} s")
    frequencies = np.fft.rfftfreq(m, sample_time)
    lines = (frequencies >= band[0]) & (frequencies <= band[1]) & (frequencies > 0)
    if not lines.any():
        raise InputError(
            f"reference.band = {list(band)} Hz holds no multiple of {1 / (m * sample_time):g} Hz; "
            "widen it or lengthen the duration"
        )
    spectrum = np.zeros(len(frequencies), complex)
    spectrum[lines] = np.exp(2j * np.pi * rng.random(int(lines.sum())))
    signal = np.fft.irfft(spectrum, m)
    n_taper = min(round(taper / sample_time), m // 2)
    if n_taper:
        window = 0.5 - 0.5 * np.cos(np.pi * np.arange(n_taper) / n_taper)
        signal[:n_taper] *= window
        signal[-n_taper:] *= window[::-1]
    signal *= rms / np.sqrt(np.mean(signal**2))
    reference = np.zeros(n)
    reference[n_rest : n_rest + m] = signal
    return reference

"""Experiments within a machine's own limits: the references from which the most telling one is chosen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.recorded.trials import Trial
from ffl.effects import is_speed
from ffl.systems.references import Move, move_times, moves, multisine
from ffl.systems.state_space import Array

REST = 0.3  # s of rest before, between and after moves
LONGEST = 10.0  # s, or
LEAST = 2000  # samples
STOOD = 0.01  # of half its stroke: what a machine that stands still moves by in a recording
STROKES, STARTS = 4.0, 20.0  # such a machine moves that often in a recording
SLOWEST = 4.0  # periods of a multisine's lowest line
SHARES = (1.0, 0.5, 0.25, 0.1, 0.05)  # of the stroke: the largest on which all moves fit
REVERSALS = [  # hops in shares of half the stroke: to and fro at three places, and back
    hop for place in (-0.6, 0.6, 0.6) for hop in (place, 0.05, -0.1, 0.1, -0.05)
] + [-0.6]


@dataclass(frozen=True)
class Limits:
    """What the machine has been seen to do: range of position, greatest speed and acceleration
    (99.9 % of the samples), range of the command."""

    low: float
    high: float
    speed: float
    acceleration: float
    command: tuple[float, float]
    duration: float

    @property
    def stroke(self) -> float:
        return self.high - self.low

    @property
    def middle(self) -> float:
        return 0.5 * (self.low + self.high)


def limits(model: Model, trials: Sequence[Trial]) -> Limits:
    """Read off the recordings, speed and acceleration (of an output that is a speed itself: its first and
    second derivative) off their noise-free simulation."""
    runs = [model.simulate(trial) for trial in trials]
    step = trials[0].sample_time
    speeds = [
        np.gradient(run.y, step) if is_speed(model.base.plant.output_unit) else run.v
        for run in runs
    ]
    v = np.concatenate(speeds)
    a = np.concatenate([np.gradient(speed, step) for speed in speeds])
    u = np.concatenate([t.u[np.isfinite(t.u)] for t in trials])
    if not len(u):
        u = np.concatenate([run.u for run in runs])
    y = np.concatenate([t.y for t in trials])
    duration = min(max(LONGEST, LEAST * step), max(len(t) for t in trials) * step)
    return Limits(
        float(y.min()), float(y.max()), float(np.quantile(np.abs(v), 0.999)),
        float(np.quantile(np.abs(a), 0.999)), (float(u.min()), float(u.max())), duration,
    )  # fmt: skip


@dataclass(frozen=True)
class Design:
    """A candidate: `text` for an engineer, `reference` (N,) around 0, and `heavier`, a known mass to be
    added (relative to the moving one)."""

    text: str
    reference: Array
    heavier: float = 0.0


def closed_loop_designs(lim: Limits, step: float) -> Iterator[Design]:
    """References about the middle of the stroke seen; all begin and end at rest there."""
    half = 0.48 * lim.stroke
    if half <= 0:
        return
    v, a = lim.speed, lim.acceleration
    if v * lim.duration < STOOD * half or a * lim.duration < v:  # it was told to stand still
        v = STROKES * half / lim.duration
        a = STARTS * v / lim.duration
    ladder = (0.25, 0.5, 1.0)
    longest = max(LONGEST, lim.duration)

    def fitting(
        text: str, *parts: tuple[Sequence[float], float], heavier: float = 0.0
    ) -> Iterator[Design]:
        """One after the other, hops in shares of half the stroke at their speed, on as much of it as they
        all fit in."""
        for share in SHARES:
            each = [
                _hops([share * half * hop for hop in hops], speed, a, step, longest)
                for hops, speed in parts
            ]
            if all(len(one) for one in each):
                name, colon, how = text.partition(":")
                on = "" if share == 1.0 else f" on {100 * share:.3g} % of the stroke"
                yield Design(name + on + colon + how, np.concatenate(each), heavier)
                return

    yield from fitting(
        "an amplitude ladder: the same move at a quarter, half and full stroke",
        (_there_and_back(ladder), v),
    )
    yield from fitting("slow ramps at 5 % of the highest speed", (_there_and_back([0.3]), 0.05 * v))
    yield from fitting(
        "short reversals at slow speed, places along the stroke", (REVERSALS, 0.1 * v)
    )
    yield from fitting("strokes at half speed", (_there_and_back([1.0]), 0.5 * v))
    yield from fitting(
        "constant speeds and the highest acceleration in turn",
        (_there_and_back([1.0]), 0.3 * v),
        (_there_and_back([1.0]), v),
    )
    for share in (0.02, 0.1, 0.4):
        band = _band(share, lim, step)
        yield Design(
            f"a multisine from {band[0]:.3g} to {band[1]:.3g} Hz", _multisine(band, lim, step)
        )
    yield from fitting(
        "the amplitude ladder with a known mass added (0.3 of the moving one)",
        (_there_and_back(ladder), v),
        heavier=0.3,
    )


def open_loop_designs(lim: Limits, step: float) -> Iterator[Design]:
    """Commands within the range seen, about its middle."""
    low, high = lim.command
    half, n = 0.48 * (high - low), round(lim.duration / step)
    if half <= 0:
        return
    t = np.arange(n) / n
    fade = np.clip(np.minimum(t, 1 - t) / 0.05, 0.0, 1.0)
    yield Design(
        "a slow triangle of the command over its full range",
        half * (2 / np.pi) * np.arcsin(np.sin(4 * np.pi * t)),
    )
    steps = np.repeat([0.0, 0.25, -0.25, 0.5, -0.5, 1.0, -1.0, 0.0], -(-n // 8))[:n]
    yield Design("steps of the command at a quarter, half and full size", half * steps)
    for share in (0.02, 0.1, 0.4):
        band = _band(share, lim, step)
        rng = np.random.default_rng(0)
        wave = multisine(band, 1.0, n * step, step, rng)
        yield Design(
            f"a multisine of the command from {band[0]:.3g} to {band[1]:.3g} Hz",
            half * wave / np.abs(wave).max() * fade,
        )


def _band(share: float, lim: Limits, step: float) -> tuple[float, float]:
    """From a few periods up to a share of Nyquist's frequency."""
    low = SLOWEST / lim.duration
    return low, max(4.0 * low, share / step / 2)


def _there_and_back(amplitudes: Sequence[float]) -> list[float]:
    """Hops to each amplitude on either side and back."""
    return [hop for h in amplitudes for hop in (h, -2 * h, h)]


def _hops(
    hops: Sequence[float], speed: float, acceleration: float, step: float, longest: float
) -> Array:
    """Moves one after the other, (0,) where they do not all fit in `longest`."""
    at, out = REST, []
    jerk = acceleration / max(10 * step, 0.02)
    for hop in hops:
        move = Move(round(at / step) * step, hop, speed, acceleration, jerk)
        at += sum(np.ceil(t / step) for t in move_times(move)) * step + REST
        if at > longest:
            return np.zeros(0)
        out.append(move)
    return moves(out, at + REST, step)


def _multisine(band: tuple[float, float], lim: Limits, step: float) -> Array:
    """As large as stroke, speed and acceleration allow."""
    wave = multisine(band, 1.0, lim.duration, step, np.random.default_rng(0), rest=REST, taper=REST)
    share = min(
        0.48 * lim.stroke / np.abs(wave).max(),
        lim.speed * step / np.abs(np.diff(wave)).max(),
        lim.acceleration * step**2 / np.abs(np.diff(wave, 2)).max(),
    )
    return wave * share

"""Experiments within a machine's own limits: the references from which the most telling one is chosen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.recorded.trials import Trial
from ffl.systems.references import Move, move_times, moves, multisine
from ffl.systems.state_space import Array

REST = 0.3  # s of rest before, between and after moves
LONGEST = 10.0  # s, or
LEAST = 2000  # samples
STOOD = 0.01  # of half its stroke: what a machine that stands still moves by in a recording
STROKES, STARTS = 4.0, 20.0  # such a machine moves that often in a recording
SLOWEST = 4.0  # periods of a multisine's lowest line


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
    """Read off the recordings, speed and acceleration off their noise-free simulation."""
    runs = [model.simulate(trial) for trial in trials]
    step = trials[0].sample_time
    v = np.concatenate([run.v for run in runs])
    a = np.concatenate([np.gradient(run.v, step) for run in runs])
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
    ladder = _strokes([0.25 * half, 0.5 * half, half], v, a, step)
    yield Design("an amplitude ladder: the same move at a quarter, half and full stroke", ladder)
    yield Design(
        "slow ramps at 5 % of the highest speed",
        _strokes([0.3 * half], 0.05 * v, a, step, lim.duration),
    )
    yield Design(
        "short reversals at slow speed, places along the stroke",
        _reversals(half, 0.1 * v, a, step, lim.duration),
    )
    yield Design("the full stroke at half speed", _strokes([half], 0.5 * v, a, step))
    yield Design(
        "constant speeds and the highest acceleration in turn",
        np.concatenate([_strokes([half], 0.3 * v, a, step), _strokes([half], v, a, step)]),
    )
    for share in (0.02, 0.1, 0.4):
        band = _band(share, lim, step)
        yield Design(
            f"a multisine from {band[0]:.3g} to {band[1]:.3g} Hz", _multisine(band, lim, step)
        )
    yield Design(
        "the amplitude ladder with a known mass added (0.3 of the moving one)", ladder, 0.3
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


def _strokes(
    halves: Sequence[float],
    speed: float,
    acceleration: float,
    step: float,
    longest: float = LONGEST,
) -> Array:
    """To each amplitude on either side and back."""
    hops = [d for h in halves for d in (h, -2 * h, h)]
    return _hops(hops, speed, acceleration, step, longest)


def _reversals(
    half: float, speed: float, acceleration: float, step: float, longest: float
) -> Array:
    hops: list[float] = []
    short = 0.05 * half
    for place in (-0.6 * half, 0.6 * half, 0.6 * half):
        hops += [place, short, -2 * short, 2 * short, -short]
    return _hops([*hops, -0.6 * half], speed, acceleration, step, longest)


def _hops(
    hops: Sequence[float], speed: float, acceleration: float, step: float, longest: float
) -> Array:
    """Moves one after the other, as many as fit."""
    at, out = REST, []
    jerk = acceleration / max(10 * step, 0.02)
    for hop in hops:
        move = Move(at, hop, speed, acceleration, jerk)
        took = sum(np.ceil(t / step) for t in move_times(move)) * step
        if at + took + REST > longest and out:
            break
        out.append(Move(round(at / step) * step, hop, speed, acceleration, jerk))
        at += took + REST
    return moves(out, at + REST, step)


def _multisine(band: tuple[float, float], lim: Limits, step: float) -> Array:
    """As large as stroke, speed and acceleration allow."""
    wave = multisine(band, 1.0, lim.duration, step, np.random.default_rng(0), rest=REST, taper=REST)
    v = np.gradient(wave, step)
    share = min(
        0.48 * lim.stroke / np.abs(wave).max(), lim.speed / np.abs(v).max(),
        lim.acceleration / np.abs(np.gradient(v, step)).max(),
    )  # fmt: skip
    return wave * share

"""How a mismatch goes with what the machine does: its linear share, and its power by operating state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.signal

from ffl.diagnose.contest.scene import Scene
from ffl.effects import Motion
from ffl.systems.state_space import Array

SEGMENTS = 8  # of a recording, for coherence
LEAST = 100  # samples of a state that are worth a figure
LOUDER = 1.5  # times the mean power: a state that what is left goes with
VARIABLES = {  # what tells a state
    "standstill and slow motion": "velocity",
    "fast motion": "velocity",
    "forward": "direction",
    "backward": "direction",
    "hard acceleration": "acceleration",
    "large commands": "command",
    "low end of the stroke": "position",
    "middle of the stroke": "position",
    "high end of the stroke": "position",
}


@dataclass(frozen=True)
class State:
    """Power of the whitened residual while the machine is in a state, over its mean power."""

    name: str
    power: float


def linear_share(scene: Scene, residuals: Sequence[Array]) -> float | None:
    """Coherence of the residual with the reference (the command in open loop), weighted by the residual's
    power: 1 where it goes linearly with it. Of the differences of both, whose power leaks less from one
    frequency to the next; None where there is too little to tell."""
    drive = [t.reference if np.ptp(t.reference) > 0 else t.feedforward for t in scene.trials]
    n = max(64, min(len(e) for e in residuals) // SEGMENTS)
    cross, first, second, power, count = 0.0, 0.0, 0.0, 0.0, 0
    for r, e in zip(drive, residuals, strict=True):
        if np.ptp(r) <= 0:
            continue
        options = {"nperseg": n, "detrend": "constant"}
        steps, changes = np.diff(r), np.diff(e)
        cross = cross + scipy.signal.csd(steps, changes, **options)[1] * len(e)
        first = first + scipy.signal.welch(steps, **options)[1] * len(e)
        second = second + scipy.signal.welch(changes, **options)[1] * len(e)
        power = power + scipy.signal.welch(e, **options)[1] * len(e)
        count += len(e) // n
    if count < 4 or np.ndim(first) == 0:
        return None
    squared = np.abs(cross) ** 2 / np.maximum(first * second, 1e-300)
    honest = np.clip(
        (squared - 1.0 / count) / (1.0 - 1.0 / count), 0.0, 1.0
    )  # bias of few segments
    return float(np.sum(honest * power) / np.sum(power))


def states(white: Array, motions: Sequence[Motion]) -> tuple[State, ...]:
    """Power of the whitened residual by operating state, the loudest first."""
    x, v, a, u = (np.concatenate([getattr(m, k) for m in motions]) for k in ("x", "v", "a", "u"))
    speed, low, high = np.abs(v), float(x.min()), float(x.max())
    third = (high - low) / 3
    sign = np.sign(np.where(speed > 1e-3 * speed.max(initial=0.0), v, 0.0))
    masks = {
        "standstill and slow motion": speed < 0.05 * speed.max(initial=0.0),
        "fast motion": speed > 0.6 * speed.max(initial=0.0),
        "forward": sign > 0,
        "backward": sign < 0,
        "hard acceleration": np.abs(a) > 0.6 * np.quantile(np.abs(a), 0.999),
        "large commands": np.abs(u) > 0.6 * np.quantile(np.abs(u), 0.999),
        "low end of the stroke": x < low + third,
        "middle of the stroke": np.abs(x - 0.5 * (low + high)) < 0.5 * third,
        "high end of the stroke": x > high - third,
    }
    whole = float(np.mean(white**2))
    out = [
        State(name, float(np.mean(white[mask] ** 2)) / whole)
        for name, mask in masks.items()
        if mask.sum() > LEAST and whole > 0
    ]
    return tuple(sorted(out, key=lambda s: -s.power))


def goes_with(found: Sequence[State]) -> tuple[str, ...]:
    """The variables that tell the states in which a residual is clearly louder than in the mean."""
    return tuple(dict.fromkeys(VARIABLES[s.name] for s in found if s.power > LOUDER))

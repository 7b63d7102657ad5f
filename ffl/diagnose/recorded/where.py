"""Where the mismatch lives: in time, in frequency, in operating state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.signal

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.wiener import Wiener
from ffl.diagnose.recorded.states import State
from ffl.effects import EFFECTS
from ffl.effects.modal import force_unit
from ffl.systems.state_space import Array


@dataclass(frozen=True)
class Map:
    """Power of one recording's whitened residual: `power` (F, T), 1 where there is only noise."""

    name: str
    times: Array
    frequencies: Array
    power: Array


@dataclass(frozen=True)
class Place:
    """`component`, `where` in words, `depends_on`, band in Hz and stretches of time in s; `port` and
    `formula` of what has no name, with `ports` ranked by log-evidence; `linear_share` of the mismatch
    and its power by operating state."""

    component: str
    where: str
    depends_on: tuple[str, ...]
    frequency_band_hz: tuple[float, float] | None = None
    time_s: tuple[tuple[float, float], ...] = ()
    port: str = ""
    formula: str = ""
    ports: tuple[tuple[str, float], ...] = ()
    linear_share: float | None = None
    states: tuple[State, ...] = ()


@dataclass(frozen=True)
class Forces:
    """Along the first recording: force that the residual asks for (smoothed), and that the effects
    give, in `unit`."""

    position: Array
    velocity: Array
    wanted: Array
    fitted: Array
    unit: str
    output_unit: str


def forces(scene: Scene, model: Model) -> Forces | None:
    """The equivalent force disturbance of the first recording, band-limited to where it is seen.

    The effects' own force plus the least force beside it (`wiener`) that explains the residual left. None
    where all of that force belongs to the linear part (viscous friction): a line at 0 would say nothing.
    """
    model, (trial,) = model.judged_on(scene.trials[:1])  # an amplifier's effects may be behind it
    acting = model.acting[: len(model.effects)]  # in the order in which they act
    kinds = [EFFECTS[e.name].port == "force" for e in acting]
    if not any(kinds):
        return None
    run = model.simulate(trial)
    fitted = (
        run.contribution[:, : len(kinds)][:, kinds].sum(axis=1) * model.simulator.force_per_input
    )
    if not np.any(fitted):
        return None
    size = float(np.mean((fitted / model.simulator.force_per_input) ** 2))
    beside = Wiener(scene, len(trial))(trial.y - run.y, size)
    return Forces(
        run.x, run.v, fitted + beside * model.simulator.force_per_input, fitted,
        force_unit(model.base.plant),
        model.base.plant.output_unit or "output",
    )  # fmt: skip


def maps(scene: Scene, white: Array) -> tuple[Map, ...]:
    """Time against frequency of the whitened residual, one map per recording."""
    pieces = np.split(white, np.cumsum([len(t) for t in scene.trials])[:-1])
    out = []
    for trial, piece in zip(scene.trials, pieces, strict=True):
        n = int(min(256, max(16, 2 ** int(np.log2(max(len(piece) // 24, 16))))))
        n = min(n, len(piece))
        f, t, power = scipy.signal.spectrogram(
            piece, 1 / trial.sample_time, "hann", n, n // 2, detrend=False
        )
        out.append(Map(trial.name, trial.start_time + t, f, power * (0.5 / trial.sample_time)))
    return tuple(out)


def band(maps_before: Sequence[Map]) -> tuple[float, float] | None:
    """Frequencies that hold the middle 90 % of the power beyond noise."""
    if not maps_before:
        return None
    excess = np.mean([np.maximum(m.power.mean(axis=1) - 1.0, 0.0) for m in _alike(maps_before)], 0)
    total = excess.sum()
    if total <= 0:
        return None
    share = np.cumsum(excess) / total
    f = maps_before[0].frequencies
    low, high = np.searchsorted(share, [0.05, 0.95])
    return float(f[low]), float(f[min(high + 1, len(f) - 1)])


def _alike(maps_before: Sequence[Map]) -> list[Map]:
    n = len(maps_before[0].frequencies)
    return [m for m in maps_before if len(m.frequencies) == n]


def stretches(maps_before: Sequence[Map], most: int = 6) -> tuple[tuple[float, float], ...]:
    """The few stretches of the first recording that hold most of the power beyond noise."""
    if not maps_before:
        return ()
    m = maps_before[0]
    excess = np.maximum(m.power.mean(axis=0) - 1.0, 0.0)
    if excess.max(initial=0.0) <= 0 or len(m.times) < 2:
        return ()
    hot = excess > max(0.25 * excess.max(), 3 * np.median(excess))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], hot.astype(int), [0]])))
    half = 0.5 * (m.times[1] - m.times[0])
    runs = [
        (float(m.times[a] - half), float(m.times[b - 1] + half), float(excess[a:b].sum()))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
    runs.sort(key=lambda r: -r[2])
    return tuple(sorted((round(a, 4), round(b, 4)) for a, b, _ in runs[:most]))


PHRASES = {
    frozenset({"direction"}): "velocity reversals and standstill",
    frozenset({"velocity"}): "motion, by its speed",
    frozenset({"velocity", "direction"}): "low speed and velocity reversals",
    frozenset({"position"}): "places along the stroke",
    frozenset({"position", "direction"}): "places along the stroke, by direction of motion",
    frozenset({"command"}): "large or small commands",
    frozenset({"position", "command"}): "the force per command along the stroke",
    frozenset({"time"}): "times, whatever the machine does",
    frozenset({"time", "temperature"}): "slow changes over the recording",
    frozenset({"acceleration"}): "accelerations",
    frozenset({"position", "acceleration"}): "an inertia that changes along the stroke",
    frozenset({"velocity", "acceleration"}): "an inertia that changes with speed",
    frozenset({"position", "velocity"}): "a damping that changes along the stroke",
    frozenset({"command", "velocity"}): "the force per command, by speed",
    frozenset({"command", "direction"}): "friction in proportion to the load",
    frozenset({"acceleration", "direction"}): "friction in proportion to the load",
    frozenset({"history", "position"}): "the path behind, fading",
    frozenset({"command", "history", "time"}): "the work done before, as heat would show",
    frozenset({"command", "time"}): "the force per command, by the time since the start",
    frozenset({"direction", "time"}): "friction, by the time since the start",
    frozenset({"acceleration", "time"}): "an inertia, by the time since the start",
    frozenset({"direction", "history"}): "reversals, with the path before them",
}
OF_NAMES = {  # what differs where an effect of the catalogue has these variables
    frozenset({"command", "time"}): "changes of the command, which act late",
    frozenset({"acceleration", "time"}): "accelerations, and what rings after them",
}


def phrase(depends_on: Sequence[str], named: bool = False) -> str:
    """Words for where a dependence shows, that of a map or of an effect that is `named`."""
    key = frozenset(depends_on)
    if named and key in OF_NAMES:
        return OF_NAMES[key]
    if key in PHRASES:
        return PHRASES[key]
    return "a dependence on " + ", ".join(depends_on) if depends_on else "the whole recording"

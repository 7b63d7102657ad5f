"""Dry friction, a damper or a sine over time, read from the balance of forces, slower than what rattles.

Averaged over a window that is long beside a machine's own oscillation a play takes nothing and gives
nothing: what moves the whole of it is

    u - d v = m a + level_positive [v > 0] - level_negative [v < 0],    or    m a + coefficient v,

with u, y averaged alike, d as the model has it, and least squares over the samples in clear motion (the two
at once are not told apart well). It starts a fit and decides nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
import scipy.optimize
from scipy.ndimage import uniform_filter1d

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.amounts import own_damping
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.predict.company import forces_along
from ffl.diagnose.recorded.trials import Trial
from ffl.diagnose.screen.scan import PASSES
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

PERIODS = 2.0  # of the slowest oscillation that a window lasts
SHORTEST = 8  # samples
CLEAR = 0.2  # of the RMS speed: slower than that no direction is sure
LEAST = 0.03  # of the RMS command: less friction hides no play
ENOUGH = 5  # windows in either direction
HIGHEST = 0.5  # passes of a sine in a window
FINE = 1e-3  # of a line of the spectrum, to which a frequency is sought
NOTICED = 0.15  # of what is left: what a sine must take (of rattle alone: 0.03)


def rubbing(
    trials: Sequence[Trial], model: Model, beside: Sequence[EffectSpec] = ()
) -> list[EffectSpec]:
    """Levels by direction that balance the forces with those that are `beside` them, a load where one of
    them pulls along, and a damper that does, without a place; those of them that are more than next to
    nothing."""
    simulator = model.base.simulator
    parts = _slow(trials, model, beside)
    if not parts:
        return []
    table = np.concatenate([part.table for part in parts])
    force = np.concatenate([part.force for part in parts])
    speed = np.abs(table[:, 3])
    usual = float(np.sqrt(np.mean(speed**2)))
    per, least = simulator.force_per_input, LEAST * float(np.std(force))
    up, down = _balanced(table[:, :3], force)[1:]
    load = 0.5 * (down - up) if up * down < 0.0 else 0.0
    up, down = max(up, 0.0), max(down, 0.0)
    (slope,) = _balanced(table[:, [0, 3]], force)[1:]
    out = []
    if max(up, down) > least:
        levels = {"level_positive": up * per, "level_negative": down * per}
        out.append(EffectSpec("asymmetric_friction", levels))
    if abs(load) > least:
        out.append(EffectSpec("constant_load", {"force": load * per}))
    if slope * usual > least:
        out.append(EffectSpec("viscous_friction", {"coefficient": slope * per}))
    return out


def humming(scene: Scene, model: Model) -> tuple[Scene, list[EffectSpec]]:
    """The scene, on clocks in step with it where they are free, and a sine over time that is much of what
    the balance with friction leaves, without a place; none where nothing is. (Friction, a play and 1.6 N at
    3.3 Hz: without the sine no gap foretold anything, and without the gap no free run held the sine.)"""
    trials = scene.trials
    parts = _slow(trials, model)
    if not parts:
        return scene, []
    table = np.concatenate([part.table[:, :3] for part in parts])
    level = np.array(_balanced(table, np.concatenate([part.force for part in parts])))
    left = [part.force - part.table[:, :3] @ level for part in parts]
    step = trials[0].sample_time
    longest = max(float(np.ptp(part.t)) for part in parts)
    most = scipy.fft.next_fast_len(4 * max(part.length for part in parts), real=True)
    power = np.zeros(most // 2 + 1)
    for part, e in zip(parts, left, strict=True):
        signal = np.zeros(part.length)
        signal[part.clear] = e
        power = power + np.abs(scipy.fft.rfft(signal, most)) ** 2 / max(len(e), 1)
    grid = scipy.fft.rfftfreq(most, step)
    usable = (grid > PASSES / longest) & (grid < HIGHEST / (parts[0].window * step))
    if not usable.any():
        return scene, []
    frequency = float(grid[usable][np.argmax(power[usable])])

    def fitted(frequency: float) -> list[tuple[Array, float]]:
        return [_sine(part, e, frequency) for part, e in zip(parts, left, strict=True)]

    near = scipy.optimize.minimize_scalar(
        lambda f: sum(squares for _, squares in fitted(f)),
        bounds=(frequency - grid[1], frequency + grid[1]),
        method="bounded",
        options={"xatol": FINE * grid[1]},
    )
    frequency = float(near.x)
    fits = fitted(frequency)
    taken = 1.0 - sum(s for _, s in fits) / sum(float(e @ e) for e in left)
    if taken < NOTICED:
        return scene, []
    passed = np.sinc(frequency * parts[0].window * step)  # what the window leaves of it
    sines = [-pair / passed for pair, _ in fits]  # the command holds against it
    phases = [float(np.arctan2(cosine, sine)) for sine, cosine in sines]
    values = {
        "amplitude": float(np.hypot(*sines[0])) * abs(model.base.simulator.force_per_input),
        "frequency": frequency,
        "phase": phases[0],
    }
    if scene.free_clocks:
        shift = {part.at: p - phases[0] for part, p in zip(parts, phases, strict=True)}
        turns = [shift.get(k, 0.0) / (2.0 * np.pi * frequency) for k in range(len(trials))]
        pairs = zip(trials, turns, strict=True)
        stepped = tuple(replace(trial, start_time=trial.start_time + turn) for trial, turn in pairs)
        scene = replace(scene, trials=stepped)
    return scene, [EffectSpec("periodic_disturbance", values)]


@dataclass(frozen=True)
class _Balance:
    """Samples of recording `at` in clear motion, averaged over `window`: at times `t`, where `clear` of
    `length`, (n, 4) accelerations, directions and velocity, and the force that moves the whole, input
    units."""

    at: int
    t: Array
    clear: Array
    length: int
    window: int
    table: Array
    force: Array


def _slow(
    trials: Sequence[Trial], model: Model, beside: Sequence[EffectSpec] = ()
) -> list[_Balance]:
    """What balances in every recording long enough, with the forces of those `beside` it along the motion;
    none where there is too little motion either way."""
    simulator = model.base.simulator
    if not simulator.mechanics.modes or model.base.is_process:
        return []
    step, bound = simulator.mechanics.sample_time, simulator.mechanics.modes[1:]
    slowest = min((float(np.sqrt(mode.stiffness)) for mode in bound), default=np.inf)
    window = max(SHORTEST, round(PERIODS * 2.0 * np.pi / slowest / step))
    damping = own_damping(model) * simulator.mechanics.moving_mass * simulator.mechanics.sign
    parts = []
    for at, trial in enumerate(trials):
        if len(trial) < 4 * window:
            continue
        known = sum(forces_along(trial, beside)) / simulator.force_per_input
        y, u = (uniform_filter1d(x, window) for x in (trial.y, trial.u + known))
        v = np.gradient(y, step)
        table = np.column_stack([np.gradient(v, step), v > 0.0, -(v < 0.0).astype(float), v])
        parts.append((at, trial.t, table, u - damping * v))
    if not parts:
        return []
    inner = slice(window, -window)
    speed = np.concatenate([table[inner, 3] for _, _, table, _ in parts])
    usual = float(np.sqrt(np.mean(speed**2)))
    out = []
    for at, t, table, force in parts:
        clear = np.abs(table[:, 3]) > CLEAR * usual
        clear[:window], clear[-window:] = False, False
        if clear.any():
            out.append(_Balance(at, t[clear], clear, len(t), window, table[clear], force[clear]))
    if not out:
        return []
    ways = np.concatenate([part.table[:, 1:3] for part in out])
    return out if np.count_nonzero(ways, axis=0).min() >= ENOUGH * window else []


def _sine(part: _Balance, left: Array, frequency: float) -> tuple[Array, float]:
    """Sine and cosine of the best sine of that frequency, and the sum of squares that it leaves."""
    angle = 2.0 * np.pi * frequency * part.t
    table = np.column_stack([np.sin(angle), np.cos(angle)])
    found = np.linalg.lstsq(table, left, rcond=None)[0]
    return found, float(np.sum((left - table @ found) ** 2))


def _balanced(table: Array, force: Array) -> list[float]:
    size = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
    return [float(x) for x in np.linalg.lstsq(table / size, force, rcond=None)[0] / size]

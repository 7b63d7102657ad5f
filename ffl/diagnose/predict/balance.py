"""Dry friction, or a damper, read from the balance of forces, slower than anything that rattles.

Averaged over a window that is long beside a machine's own oscillation a play takes nothing and gives
nothing: what moves the whole of it is

    u - d v = m a + level_positive [v > 0] - level_negative [v < 0],    or    m a + coefficient v,

with u, y averaged alike, d as the model has it, and least squares over the samples in clear motion (the two
at once are not told apart well). It starts a fit and decides nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from ffl.diagnose.hypothesis.amounts import own_damping
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.recorded.trials import Trial
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

PERIODS = 2.0  # of the slowest oscillation that a window lasts
SHORTEST = 8  # samples
CLEAR = 0.2  # of the RMS speed: slower than that no direction is sure
LEAST = 0.03  # of the RMS command: less friction hides no play
ENOUGH = 5  # windows in either direction


def rubbing(trials: Sequence[Trial], model: Model) -> list[EffectSpec]:
    """Levels by direction that balance the forces, and a damper that does, without a place; those of them
    that are more than next to nothing."""
    simulator = model.base.simulator
    if not simulator.mechanics.modes or model.base.is_process:
        return []
    step, bound = simulator.mechanics.sample_time, simulator.mechanics.modes[1:]
    slowest = min((float(np.sqrt(mode.stiffness)) for mode in bound), default=np.inf)
    window = max(SHORTEST, round(PERIODS * 2.0 * np.pi / slowest / step))
    damping = own_damping(model) * simulator.mechanics.moving_mass * simulator.mechanics.sign
    tables, forces = [], []
    for trial in trials:
        if len(trial) < 4 * window:
            continue
        y, u = (uniform_filter1d(x, window) for x in (trial.y, trial.u))
        v = np.gradient(y, step)
        table = np.column_stack([np.gradient(v, step), v > 0.0, -(v < 0.0).astype(float), v])
        inner = slice(window, -window)
        tables.append(table[inner])
        forces.append((u - damping * v)[inner])
    if not tables:
        return []
    table, force = np.concatenate(tables), np.concatenate(forces)
    speed = np.abs(table[:, 3])
    usual = float(np.sqrt(np.mean(speed**2)))
    clear = speed > CLEAR * usual
    table, force = table[clear], force[clear]
    if np.count_nonzero(table[:, 1:3], axis=0).min() < ENOUGH * window:
        return []
    per, least = simulator.force_per_input, LEAST * float(np.std(force))
    up, down = (max(level, 0.0) for level in _balanced(table[:, :3], force)[1:])
    (slope,) = _balanced(table[:, [0, 3]], force)[1:]
    out = []
    if max(up, down) > least:
        levels = {"level_positive": up * per, "level_negative": down * per}
        out.append(EffectSpec("asymmetric_friction", levels))
    if slope * usual > least:
        out.append(EffectSpec("viscous_friction", {"coefficient": slope * per}))
    return out


def _balanced(table: Array, force: Array) -> list[float]:
    size = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
    return [float(x) for x in np.linalg.lstsq(table / size, force, rcond=None)[0] / size]

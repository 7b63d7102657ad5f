"""Dry friction read from the balance of forces, slower than anything that rattles.

Averaged over a window that is long beside a machine's own oscillation a play takes nothing and gives
nothing: what moves the whole of it is

    u - d v = m a + level_positive [v > 0] - level_negative [v < 0],

with u, y averaged alike, d as the model has it (beside it levels are not told well), and least squares over
the samples in clear motion. It starts a fit and decides nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from ffl.diagnose.hypothesis.amounts import own_damping
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.recorded.trials import Trial
from ffl.systems.plant import EffectSpec

PERIODS = 2.0  # of the slowest oscillation that a window lasts
SHORTEST = 8  # samples
CLEAR = 0.2  # of the RMS speed: slower than that no direction is sure
LEAST = 0.03  # of the RMS command: less friction hides no play
ENOUGH = 5  # windows in either direction


def rubbing(trials: Sequence[Trial], model: Model) -> EffectSpec | None:
    """Levels by direction that balance the forces, without a place; None where there are as good as
    none."""
    simulator = model.base.simulator
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
        return None
    table, force = np.concatenate(tables), np.concatenate(forces)
    speed = np.abs(table[:, 3])
    clear = speed > CLEAR * np.sqrt(np.mean(speed**2))
    table, force = table[clear, :3], force[clear]
    if np.count_nonzero(table[:, 1:], axis=0).min() < ENOUGH * window:
        return None
    size = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
    found = np.linalg.lstsq(table / size, force, rcond=None)[0] / size
    per = simulator.force_per_input
    up, down = (max(float(level), 0.0) * per for level in found[1:])
    if max(up, down) < LEAST * abs(per) * float(np.std(force)):
        return None
    return EffectSpec("asymmetric_friction", {"level_positive": up, "level_negative": down})

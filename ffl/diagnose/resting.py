"""A machine with springs in it that stands still: what its effects and its command wind them up by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffl.effects import EFFECTS, Motion, Setting
from ffl.machines.simulator import Simulator
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

STANDING = frozenset({"position"})  # what a force may depend on that also acts at standstill


def winds(simulator: Simulator, effects: Sequence[EffectSpec]) -> bool:
    """Whether forces at standstill stretch a spring of the plant: it moves freely as a whole, has
    modes beside, and something pulls at a point or holds it."""
    modes = simulator.mechanics.modes
    if len(modes) < 2 or not modes[0].rigid:
        return False
    return any(_stands(spec) or _holds(spec) for spec in effects)


def wound(
    simulator: Simulator, effects: Sequence[EffectSpec], command: float, start: Array
) -> Array:
    """`start` with the plant's springs in balance at the same output, speed zero:
        A x + b u + sum_j p_j F_j(x) + p R = 0,
    forces F_j of position alone at their points p_j, `command` u (input units); dry friction holds
    with R at its own point, without it the drive does. A move that ends leaves a machine so."""
    m = simulator.mechanics
    n = m.own
    pull, hold = m.b[:n] * command, m.b[:n]
    for spec in effects:
        if not (_stands(spec) or _holds(spec)):
            continue
        effect = EFFECTS[spec.name]
        setting = Setting(simulator.force_per_input, m, spec.options)
        point = m.point(effect.side_in(setting), setting.mass_ratio)
        if _holds(spec):
            hold = point.force[:n]
            continue
        still = Motion.still(float(point.position[:n] @ start[:n]), m.sample_time)
        force = float(effect.signal(spec, still)[0]) / simulator.force_per_input
        pull = pull + point.force[:n] * force
    system = np.block([[m.a[:n, :n], hold[:, None]], [m.c[None, :n], np.zeros((1, 1))]])
    scale = np.abs(system).max(axis=1, keepdims=True)
    scale[scale == 0] = 1.0
    wanted = np.append(-pull, 0.0) / scale[:, 0]
    out = start.copy()
    out[:n] += np.linalg.lstsq(system / scale, wanted, rcond=1e-13)[0][:n]
    out[simulator.n_plant : simulator.n_plant + m.delay] = command
    return out


def _stands(spec: EffectSpec) -> bool:
    """A force at standstill, by where the machine stands alone."""
    effect = EFFECTS[spec.name]
    return effect.port == "force" and not _holds(spec) and set(effect.depends_on) <= STANDING


def _holds(spec: EffectSpec) -> bool:
    """Dry friction, rigid or on springs of its own: any force up to its level."""
    effect = EFFECTS[spec.name]
    return effect.port == "force" and (effect.switches or effect.reach(spec.parameters) > 0)

"""A machine with springs in it that stands still: what its effects and its command wind them up by."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ffl.effects import EFFECTS, Motion, Setting
from ffl.machines.simulator import Simulator
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

FEW, SURELY = 8, 12.0  # samples in which a speed shows, and standard errors by which it does
SLOW = frozenset({"position", "time", "temperature"})  # a force by these also acts at standstill


@dataclass(frozen=True)
class Pull:
    """A force without a name at standstill: `force` (input units) at a position of its point."""

    side: str
    mass_ratio: float | None
    force: Callable[[float], float]


def winds(simulator: Simulator, effects: Sequence[EffectSpec], pulls: Sequence[Pull] = ()) -> bool:
    """Whether forces at standstill stretch a spring of the plant: in open loop it stands on one, or it
    moves freely as a whole, has modes beside, and something pulls at a point or holds it."""
    modes = simulator.mechanics.modes
    if springs_back(simulator):
        return True
    if len(modes) < 2 or not modes[0].rigid:
        return False
    closed = simulator.plant.controller is not None
    return closed and (bool(pulls) or any(_stands(spec) or _holds(spec) for spec in effects))


def at_speed(y: Array) -> bool:
    """Whether the output has a speed at the first sample: the line of a parabola through the first few, by
    many of its standard errors. What stood until then has none, whatever pulls at it. (A stage that a fan
    shook at 8 mm/s had a hardening spring beside it, and was taken for one at rest: no drift came in.)"""
    if len(y) < FEW:
        return False
    t, first = np.arange(FEW) / FEW, y[:FEW]
    q = np.linalg.qr(np.column_stack([np.ones(FEW), t**2, t]))[0]
    told = q.T @ first
    rest = first - q @ told
    return bool(told[-1] ** 2 > SURELY**2 * (rest @ rest) / (FEW - 3))


def springs_back(simulator: Simulator) -> bool:
    """A stage on a spring in open loop: it stands where all forces balance, and swings about there."""
    modes = simulator.mechanics.modes
    if simulator.plant.controller is not None or not modes:
        return False
    return bool(modes[0].damping ** 2 < 4.0 * modes[0].stiffness)


def wound(
    simulator: Simulator, effects: Sequence[EffectSpec], command: float, time: float, start: Array,
    pulls: Sequence[Pull] = (),
) -> Array:  # fmt: skip
    """`start` with the plant's springs in balance at the same output, speed zero:
        A x + b u + sum_j p_j F_j(x, t) + p R = 0,
    forces F_j of position and slow time alone at their points p_j, `pulls` beside them, `command` u
    (input units), `time` t (s); dry friction holds with R at its own point, without it the drive does: a
    move that ends leaves a machine so. In open loop no drive does, and the output is where the forces
    balance."""
    m = simulator.mechanics
    n = m.own
    pull, hold, held = m.b[:n] * command, m.b[:n], not springs_back(simulator)
    for spec in effects:
        if not (_stands(spec) or _holds(spec)):
            continue
        effect = EFFECTS[spec.name]
        setting = Setting(simulator.force_per_input, m, spec.options)
        point = m.point(effect.side_in(setting), setting.mass_ratio)
        if _holds(spec):
            hold, held = point.force[:n], True
            continue
        still = Motion.still(float(point.position[:n] @ start[:n]), m.sample_time, time)
        force = float(effect.signal(spec, still)[0]) / simulator.force_per_input
        pull = pull + point.force[:n] * force
    for one in pulls:
        point = m.point(one.side, one.mass_ratio)
        pull = pull + point.force[:n] * one.force(float(point.position[:n] @ start[:n]))
    out, a = start.copy(), m.a[:n, :n]
    system, wanted = a, -pull - a @ start[:n]
    if held:
        system = np.block([[a, hold[:, None]], [m.c[None, :n], np.zeros((1, 1))]])
        wanted = np.append(wanted, 0.0)
    scale = np.abs(system).max(axis=1, keepdims=True)
    scale[scale == 0] = 1.0
    out[:n] += np.linalg.lstsq(system / scale, wanted / scale[:, 0], rcond=1e-13)[0][:n]
    out[simulator.n_plant : simulator.n_plant + m.delay] = command
    return out


def _stands(spec: EffectSpec) -> bool:
    """A force at standstill, by where the machine stands and how long alone."""
    effect = EFFECTS[spec.name]
    slow = set(effect.depends_on) <= SLOW and effect.scan != "time"
    return effect.port == "force" and not _holds(spec) and slow


def _holds(spec: EffectSpec) -> bool:
    """Dry friction, rigid or on springs of its own: any force up to its level."""
    effect = EFFECTS[spec.name]
    return effect.port == "force" and (effect.switches or effect.reach(spec.parameters) > 0)


def rest_under(simulator: Simulator, command: float, held: float, position: float) -> Array:
    """Standstill of an open-loop plant at `position` under a constant command, loads included in `held`.
    The plant may make another position of that command: what the model leaves out holds it then, as a
    force beside the command. (A valve with a dead zone stood at 0 bar under 0.09 V, of which the model
    makes 0.84 bar: it began half way.)"""
    m, n = simulator.mechanics, simulator.mechanics.own
    weight = np.abs(m.a).max() / max(np.abs(m.c).max(), 1e-300)
    seen = np.append(m.c[:n] * weight, 0.0)
    solution = np.linalg.lstsq(
        np.vstack([np.column_stack([m.a[:n, :n], m.b[:n]]), seen]),
        np.append(-m.b[:n] * held, position * weight),
        rcond=1e-13,
    )[0]
    start = np.zeros(simulator.n_states)
    start[:n] = solution[:n]
    start[simulator.n_plant : simulator.n_plant + m.delay] = command
    return start

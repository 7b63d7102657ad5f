"""What the linear model has but may have slightly wrong: mass, damping, stiffness, modes.

Taken apart into modes (`ffl.effects.mechanics`), each is eta'' + d eta' + k eta = residue * u. The
corrections act on these numbers and leave the shape of the modes alone:

mass         every residue divided by 1 + value (damping and stiffness of the rigid body, per mass,
             divided with it: they stay what they are in newton); of lags in a row: of the gain alone;
damping      d of the rigid body, value in units of 1/s at nominal mass;
stiffness    relative change of k of the first mode, where it is bound;
apart        of a process of two real lags, in place of the stiffness: change of r = (d^2 - 4 k)^(1/2)/d,
             their rates d (1 +- r)/2. Stages are told by these, which are smooth in d and r and begin
             like a root in k where two lags become one;
mode_i_frequency, mode_i_damping   relative changes of w and of zeta of a further mode, the numerator of its
             share of y (position and velocity as the sensor sees them) as it was;
mode_i_share   relative change of that share: of what u makes of the mode;
mode_i_lead    of that share (q + p s)/(s^2 + d s + k): change of p, in units of q/k^(1/2), which the first
             mode's share loses, so that y answers u no sooner than it did;
gain, time_constant   of a plant without modes, one lag: relative change of either.

`without_zero` is a choice, not a number that is fitted: the zero of two lags goes.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from ffl.effects.cascade import lags
from ffl.effects.mechanics import Mechanics, Mode
from ffl.machines.simulator import Simulator
from ffl.systems.loop import Loop, closed_loop
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array, StateSpace, series
from ffl.systems.zpk import Zpk

A_ZERO = 0.005  # of the sum of two lags: a faster zero is that of the hold, or rounding
WITHOUT_ZERO, APART = "without_zero", "apart"
BOUND = 2 * np.pi * 0.05  # rad/s: a first mode below it is as good as free
LIGHTEST = -0.95  # relative: a mass that also stood for a lag may be many times too large
NEARLY_ONE = 0.999  # a slower lag of two is as good as an integrator
AT_ONCE = 0.05  # two masses on a spring have 0.003 to 0.015, a car's suspension 0.11
KEPT = 64  # corrected simulators: more than one Jacobian asks for
BOUND_PER_SAMPLE = BOUND * 1e-3  # the same for processes that are sampled slower than 1 kHz


@dataclass(frozen=True)
class Correction:
    """One number of the linear model: its name, and a change of it that matters (`scale`); free only where
    it is `asked` for."""

    name: str
    scale: float
    lower: float
    upper: float
    asked: bool = False


def modal_terms(mechanics: Mechanics, mode: Mode) -> tuple[float, float]:
    """(d, k) of eta'' + d eta' + k eta = residue u."""
    drift = mode.velocity @ mechanics.a
    seen = np.vstack([mode.position, mode.velocity])
    terms = np.linalg.lstsq(seen.T, drift, rcond=None)[0]
    return float(-terms[1]), float(-terms[0])


def corrections_of(mechanics: Mechanics, process: bool = False) -> tuple[Correction, ...]:
    """The numbers of this plant, a `process` or one that may have a mass, that may be slightly wrong."""
    if not mechanics.modes:
        gain = Correction("gain", 0.01, -0.9, 10.0)
        one_lag = mechanics.order == 1 and mechanics.a[0, 0] < 0.0
        return (gain, Correction("time_constant", 0.01, -0.9, 10.0)) if one_lag else (gain,)
    first = mechanics.modes[0]
    damping, stiffness = modal_terms(mechanics, first)
    rate = 0.1 * abs(damping) + 0.01
    out = [Correction("mass", 0.01, LIGHTEST, 5.0)]
    if stiffness > min(BOUND, BOUND_PER_SAMPLE / mechanics.sample_time) ** 2:
        out.append(Correction("damping", 0.1 * abs(damping) + 1e-3, -abs(damping), 1e4))
        if process:
            apart = _apart(damping, stiffness)
            out.append(Correction(APART, 0.005, -apart, NEARLY_ONE - apart))
        else:
            out.append(Correction("stiffness", 0.01, -0.9, 10.0))
    else:
        out.append(Correction("damping", rate, -abs(damping) - 0.5, 1e4))
    for i in range(1, len(mechanics.modes)):
        out.append(Correction(f"mode_{i}_frequency", 0.005, -0.3, 0.3))
        out.append(Correction(f"mode_{i}_damping", 0.2, -0.9, 20.0))
        out.append(Correction(f"mode_{i}_share", 0.005, -0.3, 0.3, asked=True))
        out.append(Correction(f"mode_{i}_lead", 0.005, -0.3, 0.3, asked=True))
    return tuple(out)


def _apart(damping: float, stiffness: float) -> float:
    """(r1 - r2)/(r1 + r2) of the rates of two real lags."""
    return float(np.sqrt(max(1.0 - 4.0 * stiffness / damping**2, 0.0)))


def changed_stiffness(mechanics: Mechanics, values: Mapping[str, float]) -> float:
    """Relative change of k of the first mode."""
    if APART not in values:
        return values.get("stiffness", 0.0)
    damping, stiffness = modal_terms(mechanics, mechanics.modes[0])
    apart = _apart(damping, stiffness) + values[APART]
    return (0.5 * (damping + values.get("damping", 0.0))) ** 2 * (1.0 - apart**2) / stiffness - 1.0


def damped_together(mechanics: Mechanics) -> bool:
    """Whether dampers join the modes: the share of one in y, (q + p s)/(s^2 + d s + k), answers u at once
    by more than `AT_ONCE` of what it does in one radian."""
    for mode in mechanics.modes[1:]:
        damping, stiffness = modal_terms(mechanics, mode)
        p = float(mode.position @ mechanics.b)
        q = float(mode.velocity @ mechanics.b) + damping * p
        if abs(p) * np.sqrt(stiffness) > AT_ONCE * abs(q):
            return True
    return False


def has_zero(mechanics: Mechanics) -> bool:
    """Two real lags with a zero that is not the hold's: y'' + d y' + k y = c (u + lead u')."""
    if len(lags(mechanics)) != 2:
        return False
    mode = mechanics.modes[0]
    damping, stiffness = modal_terms(mechanics, mode)
    at_once = float(mode.position @ mechanics.b)
    lead = at_once / (float(mode.velocity @ mechanics.b) + damping * at_once)
    return abs(lead) > A_ZERO * damping / stiffness


def _without_zero(mechanics: Mechanics) -> Array:
    """b of two lags that y follows with a slope of its own only, the gain at rest as it was."""
    mode = mechanics.modes[0]
    damping, _ = modal_terms(mechanics, mode)
    at_once = float(mode.position @ mechanics.b)
    seen = np.vstack([mode.position, mode.velocity])
    return mechanics.b - np.linalg.solve(seen, np.array([at_once, -damping * at_once]))


def corrected(mechanics: Mechanics, values: Mapping[str, float]) -> Mechanics:
    """`mechanics` with the named changes; itself where all are zero."""
    if not any(values.values()):
        return mechanics
    a, b, d = np.array(mechanics.a), mechanics.b, mechanics.d
    if not mechanics.modes:
        factor, slower = (1.0 + values.get(name, 0.0) for name in ("gain", "time_constant"))
        a, b = a / slower, b / slower
        fast = mechanics.fast
        fast = StateSpace(fast.a, fast.b, fast.c * factor, fast.d * factor, fast.sample_time)
        return replace(mechanics, a=a, b=b * factor, d=d * factor, fast=fast, exact=None)
    gain = 1.0 / (1.0 + values.get("mass", 0.0))
    if values.get(WITHOUT_ZERO):
        b = _without_zero(mechanics)
    moved = []  # (d, k) of each mode anew, and its push
    for i, mode in enumerate(mechanics.modes):
        damping, stiffness = modal_terms(mechanics, mode)
        push = mode.force / mode.residue
        if i == 0:
            new_d = (damping + values.get("damping", 0.0)) * gain
            new_k = stiffness * (1.0 + changed_stiffness(mechanics, values)) * gain
            if APART in values:  # a process has a gain, not a mass
                new_d, new_k = new_d / gain, new_k / gain
            first = _position(mechanics, push, damping - new_d)
        else:
            w = 1.0 + values.get(f"mode_{i}_frequency", 0.0)
            new_k = stiffness * w**2
            new_d = damping * w * (1.0 + values.get(f"mode_{i}_damping", 0.0))
            # What u and the sensor are to it stays: the numerator p s + q of its share of y.
            p, rate = float(mode.position @ mechanics.b), float(mode.velocity @ mechanics.b)
            q = rate + damping * p
            b = b - push * (new_d - damping) * p
            share, lead = (values.get(f"mode_{i}_{name}", 0.0) for name in ("share", "lead"))
            if share or lead:
                more = share * p + lead * q / np.sqrt(stiffness)
                # As much of p the first mode loses: y answers u no sooner than it did.
                way = _position(mechanics, push, damping - new_d) - first
                b = b + share * q * push + more * way
        a -= np.outer(push, (new_d - damping) * mode.velocity + (new_k - stiffness) * mode.position)
        moved.append((new_k, new_d, push))
    modes = [
        _moved(mode, push, b * gain, new_k, new_d)
        for mode, (new_k, new_d, push) in zip(mechanics.modes, moved, strict=True)
    ]
    fast = mechanics.fast
    fast = StateSpace(fast.a, fast.b, fast.c * gain, fast.d * gain, fast.sample_time)
    return replace(
        mechanics, a=a, b=b * gain, d=d * gain, modes=tuple(modes), fast=fast, exact=None
    )


def _position(mechanics: Mechanics, push: Array, less: float) -> Array:
    """The state of position 1, and numerator s, of the mode with this `push` that has `less` damping."""
    return mechanics.a @ push + less * push


def _moved(mode: Mode, push: Array, b: Array, stiffness: float, damping: float) -> Mode:
    """`mode` with other numbers, driven by `b`. With p, q the shares of b in position and velocity of
    the mode, what u itself moves is read by m (velocity's share of b out of it), m ~ (q, -p)."""
    p, q = float(mode.position @ b), float(mode.velocity @ b)
    residue = abs(q + damping * p)
    m = np.array([q, -p]) / (q**2 + p * (stiffness * p + damping * q))
    return replace(
        mode,
        residue=residue,
        force=push * residue,
        motor_position=m[0] * mode.position + m[1] * mode.velocity,
        motor_velocity=-stiffness * m[1] * mode.position + (m[0] - damping * m[1]) * mode.velocity,
        stiffness=stiffness,
        damping=damping,
    )


def simulator_with(simulator: Simulator, values: Mapping[str, float]) -> Simulator:
    """`simulator` on the corrected plant; its states keep their meaning. One for all models with these
    corrections: most that are fitted differ in their effects alone."""
    return _simulator_with(simulator, tuple(values.items()))


@functools.lru_cache(KEPT)
def _simulator_with(simulator: Simulator, values: tuple[tuple[str, float], ...]) -> Simulator:
    mechanics = corrected(simulator.mechanics, dict(values))
    if mechanics is simulator.mechanics:
        return simulator
    return simulator.with_mechanics(mechanics)


def carried(state: Array, before: Mechanics, after: Mechanics) -> Array:
    """The state of `before` (`own` of it, in front of what follows) as one of `after`, a plant of the
    same modes in other coordinates: what every mode reads, and what is left of the output's row and
    its derivatives, stays the same."""
    n = before.own
    if n != after.own:
        return state
    seen, wanted = _readings(before, before), _readings(after, before)
    moved = np.linalg.lstsq(wanted, seen @ state[:n], rcond=1e-13)[0]
    return np.concatenate([moved, state[n:]])


def _readings(mechanics: Mechanics, scale: Mechanics) -> Array:
    """Rows that read the state of the plant itself, in units of the frequencies of `scale`."""
    n = mechanics.own
    rows = []
    for mode, unit in zip(mechanics.modes, scale.modes, strict=True):
        rate = max(np.sqrt(abs(unit.stiffness)), abs(unit.damping), BOUND)
        rows += [mode.position[:n], mode.velocity[:n] / rate]
    row = mechanics.rest[:n]
    rate = max(float(np.abs(np.linalg.eigvals(scale.a[:n, :n])).max(initial=0.0)), BOUND)
    for _ in range(n - 2 * len(mechanics.modes)):
        rows.append(row)
        row = row @ mechanics.a[:n, :n] / rate
    return np.array(rows)


def discrete(mechanics: Mechanics) -> StateSpace:
    """The plant under a zero-order hold, as a plant file states it."""
    if mechanics.exact is not None and not mechanics.fast.order and not mechanics.delay:
        return mechanics.exact
    n, step = mechanics.order, mechanics.sample_time
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = mechanics.a, mechanics.b
    held = scipy.linalg.expm(block * step)
    k = mechanics.own
    slow = StateSpace(held[:k, :k], held[:k, n:], mechanics.c[None, :k], mechanics.d, step)
    fast = mechanics.fast
    if fast.order:
        slow = StateSpace(
            scipy.linalg.block_diag(slow.a, fast.a),
            np.vstack([slow.b, fast.b]),
            np.hstack([slow.c, fast.c]),
            slow.d + fast.d,
            step,
        )
    if mechanics.delay:
        line = Zpk(np.zeros(0), np.zeros(0), 1.0, step, mechanics.delay).state_space()
        slow = series(line, slow)
    return slow


def loop_by_states(plant: Plant, simulator: Simulator) -> Loop:
    """The loop of `plant`, its states in the order of the simulator's start vector: the plant's, its delay
    line from the command that is due, the controller's."""
    mechanics, n = simulator.mechanics, simulator.n_plant
    if mechanics.exact is not None and not mechanics.fast.order and not mechanics.delay:
        return plant.loop
    whole, delay = discrete(mechanics), mechanics.delay
    at = np.concatenate([np.arange(delay, delay + n), np.arange(delay)[::-1]])
    states = StateSpace(
        whole.a[np.ix_(at, at)], whole.b[at], whole.c[:, at], whole.d, whole.sample_time
    )
    return closed_loop(states, plant.controller)


def corrected_plant(plant: Plant, mechanics: Mechanics, values: Mapping[str, float]) -> Plant:
    """The plant file's plant with the corrections in its linear part."""
    if not any(values.values()):
        return plant
    return replace(plant, system=discrete(corrected(mechanics, values)))

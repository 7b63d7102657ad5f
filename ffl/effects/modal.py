"""A plant taken apart: from a discrete-time system to continuous-time mechanics with modes."""

from __future__ import annotations

import re
import threading
import warnings

import numpy as np
import scipy.linalg

from ffl.effects.mechanics import Mechanics, Mode
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array, StateSpace
from ffl.systems.zpk import Zpk

FAST_POLE = 1e-6  # a pole nearer to the origin of the z plane is part of a delay, not of mechanics


_TURN = r"(m|µ|μ|u)?rad|deg|°|rev|turns?"
_WAY = r"(k|d|c|m|µ|μ|u|n)?m|in|inch|ft|mi|ticks?|counts?|inc|steps?"
_PER_TIME = r"\s*(/\s*(s|sec|min|h|hr)|[ .·]\s*(s|min|h)\^?-1)"
_ROTATION = r"k?rpm|(r|rev|1|u|turns)/min|min\^?-1"
_TRAVEL = r"km/?h|kph|mph|(?-i:kn|kts?)|knots?"  # kN is a force

SPEEDS = re.compile(rf"\s*({_ROTATION}|{_TRAVEL}|({_TURN}|{_WAY}){_PER_TIME})\s*", re.I)
WAYS = re.compile(rf"\s*({_TURN}|{_WAY})\s*", re.I)
TURNS = re.compile(rf"\s*({_ROTATION}|({_TURN})({_PER_TIME})?)\s*", re.I)


REMEMBERED = 8  # systems
_REMEMBERED: dict[tuple[int, bool], tuple[Zpk | StateSpace, Mechanics]] = {}
_LOCK = threading.Lock()


def is_speed(unit: str) -> bool:
    """Whether an output in this unit is a speed: rpm, rad/s, km/h, kn, ticks/s and their like."""
    return SPEEDS.fullmatch(unit) is not None


def moves(plant: Plant) -> bool:
    """Whether the output is a motion, as far as its unit or the plant's physics say: a temperature, a level
    or a voltage has neither springs nor friction, though it may do as if."""
    stated = plant.physics.mass is not None or plant.physics.motor_constant is not None
    unit = plant.output_unit
    return stated or not unit or is_speed(unit) or WAYS.fullmatch(unit) is not None


def force_unit(plant: Plant) -> str:
    """What a force is in: N, or N m where the output is an angle or its rate, with the motor constant
    known; else the unit of the command."""
    if plant.physics.motor_constant is None:
        return plant.input_unit or "input"
    return "N m" if TURNS.fullmatch(plant.output_unit) else "N"


def mechanics_of(system: Zpk | StateSpace, speed: bool = False) -> Mechanics:
    """`taken_apart`, remembered for the systems last asked for: a scan over numbers of effects asks
    for one and the same system hundreds of times."""
    key = (id(system), speed)
    with _LOCK:
        known = _REMEMBERED.get(key)
    if known is None:
        known = (system, taken_apart(system, speed))  # kept with it, the system's id stays its own
        with _LOCK:
            while len(_REMEMBERED) >= REMEMBERED:
                _REMEMBERED.pop(next(iter(_REMEMBERED)))
            _REMEMBERED[key] = known
    return known[1]


def taken_apart(system: Zpk | StateSpace, speed: bool = False) -> Mechanics:
    """Continuous-time mechanics of a discrete plant under a zero-order hold.

    Whole delays (poles at z = 0) are taken off and kept as delay of the command; the rest is brought
    to continuous time by the matrix logarithm, refined once. Where poles lie on the negative real
    axis, the plant is split there and they stay in discrete time. `speed`: the output is the speed of
    what moves, so its integral is added as the last state and forces depend on both.
    """
    delay, ss = _without_delay(system)
    slow, fast = _split_fast(ss)
    n = slow.order
    block = np.eye(n + 1)
    block[:n, :n], block[:n, n:] = slow.a, slow.b
    log = _logarithm(block) if n else np.zeros((1, 1))
    log[n:] = 0.0
    a, b, c = log[:n, :n] / slow.sample_time, log[:n, n] / slow.sample_time, slow.c[0]
    feed = float(slow.d[0, 0])
    if speed:
        grown = np.zeros((n + 1, n + 1))
        grown[:n, :n], grown[n, :n] = a, c
        a, b, c, place = grown, np.append(b, feed), np.append(c, 0.0), np.eye(n + 1)[n]
        modes, sign = _modes(a, b, place)
        rest = place - sum((mode.position for mode in modes), np.zeros(n + 1))
        rest = np.zeros(n + 1) if n + 1 == 2 * len(modes) else rest
        return Mechanics(
            a, b, c, feed, ss.sample_time, delay, rest, modes, sign, None, fast, place=place
        )
    modes, sign = _modes(a, b, c)
    rest = c - sum((mode.position for mode in modes), np.zeros(n))
    if n == 2 * len(modes):
        rest = np.zeros(n)  # nothing but rounding is left
    return Mechanics(a, b, c, feed, ss.sample_time, delay, rest, modes, sign, slow, fast)


def _logarithm(block: Array) -> Array:
    """L with exp(L) = block, (n, n). That of a defective matrix loses digits, of which scipy warns; one
    Newton step brings them back."""
    with _LOCK, warnings.catch_warnings():  # filters are shared by all threads
        warnings.filterwarnings("ignore", "logm result may be inaccurate", RuntimeWarning)
        log = np.real(scipy.linalg.logm(block))
    return log + scipy.linalg.expm(-log) @ block - np.eye(len(block))


def _without_delay(system: Zpk | StateSpace) -> tuple[int, StateSpace]:
    if isinstance(system, Zpk):
        at_zero = np.abs(system.poles) < FAST_POLE
        delay = min(int(at_zero.sum()) + system.delay, max(0, system.relative_degree - 1))
        kept = at_zero.sum() + system.delay - delay  # z^-kept stays in the plant
        poles = np.concatenate([system.poles[~at_zero], np.zeros(kept)])
        return delay, Zpk(system.zeros, poles, system.gain, system.sample_time).state_space()
    t, q, k = scipy.linalg.schur(
        system.a, output="real", sort=lambda re, im=0.0: np.hypot(re, im) > FAST_POLE
    )
    delay = system.order - k
    if not delay or system.d[0, 0] != 0:
        return 0, system
    # z^-delay times the slow part: its input vector is A^delay times the one that is seen.
    x = scipy.linalg.solve_sylvester(t[:k, :k], -t[k:, k:], -t[:k, k:])
    b, c = q.T @ system.b, system.c @ q
    seen = b[:k] - x @ b[k:]
    ahead = np.linalg.matrix_power(t[:k, :k], delay) @ seen
    advanced = StateSpace(t[:k, :k], ahead, c[:, :k], 0.0, system.sample_time)
    n = 3 * system.order + 10
    whole, shifted = system.impulse_response(n), advanced.impulse_response(n)
    padded = np.concatenate([np.zeros(delay), shifted])[:n]
    if np.abs(whole - padded).max() > 1e-9 * np.abs(whole).max():
        return 0, system  # the poles at 0 are not a pure delay
    return delay, advanced


def _split_fast(ss: StateSpace) -> tuple[StateSpace, StateSpace]:
    """The part with a continuous counterpart, and the rest (poles at z <= 0), by Schur and Sylvester."""

    def convertible(re: float, im: float = 0.0) -> bool:
        return bool(abs(im) > 1e-9 * max(abs(re), 1e-12) or re > FAST_POLE)

    nothing = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), 0.0, ss.sample_time)
    if all(convertible(p.real, p.imag) for p in ss.poles):
        return ss, nothing
    t, q, k = scipy.linalg.schur(ss.a, output="real", sort=convertible)
    x = scipy.linalg.solve_sylvester(t[:k, :k], -t[k:, k:], -t[:k, k:])
    b, c = q.T @ ss.b, ss.c @ q
    slow = StateSpace(t[:k, :k], b[:k] - x @ b[k:], c[:, :k], ss.d, ss.sample_time)
    fast = StateSpace(t[k:, k:], b[k:], c[:, :k] @ x + c[:, k:], 0.0, ss.sample_time)
    return slow, fast


def _modes(a: Array, b: Array, c: Array) -> tuple[tuple[Mode, ...], float]:
    """The rigid body (slowest pair of poles), one mode per further pair, and the rigid body's sign."""
    poles = np.linalg.eigvals(a) if len(a) else np.zeros(0, complex)
    groups = _pairs(poles)
    modes: list[Mode] = []
    rigid_sign = 0.0
    scale = max(1.0, float(np.abs(poles).max(initial=0.0)))
    for group in groups:
        projector, basis = _projector(a, group, poles, scale)
        position, velocity = c @ projector, c @ projector @ a
        numerator = float(velocity @ b - group.sum().real * (position @ b))
        seen = np.vstack([position @ basis, velocity @ basis])
        if abs(numerator) == 0 or np.linalg.cond(seen) > 1e14:
            continue
        force = basis @ np.linalg.solve(seen, np.array([0.0, abs(numerator)]))
        driven = np.column_stack([projector @ b, projector @ (a @ b)])
        motor = np.linalg.lstsq(driven.T, np.array([0.0, 1.0]), rcond=None)[0] @ projector
        rigid_sign = rigid_sign or float(np.sign(numerator))
        sign = float(np.sign(numerator)) * rigid_sign
        stiffness, damping = float(np.prod(group).real), -float(group.sum().real)
        modes.append(
            Mode(
                force,
                position,
                velocity,
                motor,
                motor @ a,
                abs(numerator),
                sign,
                stiffness,
                damping,
                not modes,
            )
        )
    return tuple(modes), rigid_sign or (-1.0 if c @ b < 0 else 1.0)


def _pairs(poles: np.ndarray) -> list[np.ndarray]:
    """Complex pairs, and real poles two by two from the slowest, slowest pair first; the fastest of
    an odd number of real poles is left out (a lag, which is no mode)."""
    tiny = 1e-9 * np.maximum(np.abs(poles), 1e-9)
    upper = poles[poles.imag > tiny]
    real = poles[np.abs(poles.imag) <= tiny]
    real = real[np.argsort(np.abs(real), kind="stable")]
    pairs = [np.array([p, p.conjugate()]) for p in upper]
    pairs += [real[k : k + 2] for k in range(0, len(real) - 1, 2)]
    return sorted(pairs, key=lambda pair: float(np.abs(pair).max()))


def _projector(a: Array, group: np.ndarray, poles: np.ndarray, scale: float) -> tuple[Array, Array]:
    """Spectral projector onto the invariant subspace of `group`, and a basis of that subspace."""
    own: list[complex] = group.tolist()
    others = [p for p in poles.tolist() if min(abs(p - q) for q in own) > 1e-12 * scale]
    if len(others) + len(group) != len(poles) or not others:
        return np.eye(len(a)), np.linalg.qr(np.eye(len(a)))[0]

    def chosen(re: float, im: float = 0.0) -> bool:
        point = complex(re, im)
        return min(abs(point - p) for p in own) < min(abs(point - p) for p in others)

    k = len(group)
    right = scipy.linalg.schur(a, output="real", sort=chosen)[1][:, :k]
    left = scipy.linalg.schur(a.T, output="real", sort=chosen)[1][:, :k]
    return right @ np.linalg.solve(left.T @ right, left.T), right

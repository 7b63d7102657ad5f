"""A plant taken apart: from a discrete-time system to continuous-time mechanics with modes."""

from __future__ import annotations

import re
import threading
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.linalg.lapack import dtrsen

from ffl.effects.mechanics import Mechanics, Mode
from ffl.recordings.units import KNOWN, plain
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array, StateSpace
from ffl.systems.zpk import Zpk

FAST_POLE = 1e-6  # a pole nearer to the origin of the z plane is part of a delay, not of mechanics
NEAR, MOST = 0.25, 2.0**40  # to the identity, where Gauss's rule is exact; roots taken until then
NODES, WEIGHTS = (0.5 * x for x in np.polynomial.legendre.leggauss(8))
NODES = NODES + 0.5  # of (0, 1)

_TURN = r"(m|µ|μ|u)?rad|deg|°|rev|turns?|arc(min|sec)"
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
    known; the unit of the command where that is not, or where the command is a force and it is 1 (kN)."""
    constant, unit = plant.physics.motor_constant, plant.input_unit
    turns = TURNS.fullmatch(plant.output_unit) is not None
    measures = KNOWN.get(plain(unit), ("", 1.0))[0]
    if constant is None or (constant == 1.0 and measures == ("Nm" if turns else "N")):
        return unit or "input"
    return "N m" if turns else "N"


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
    """L with exp(L) = block, (n, n), by square roots B^(1/2^k) = I + E of its balanced Schur form B,
    near the identity,

        log B = 2^k int_0^1 E (I + x E)^-1 dx,

    that integral exact to rounding by Gauss's rule, and Newton steps for the digits that roots lose."""
    balanced, (scale, _) = scipy.linalg.matrix_balance(block, permute=False, separate=True)
    form, turn = scipy.linalg.schur(balanced)
    unit, root, doubled = np.eye(len(block)), form, 1.0
    while np.abs(root - unit).sum(axis=0).max() > NEAR and doubled < MOST:
        root, doubled = np.real(scipy.linalg.sqrtm(root)), 2.0 * doubled
    parts = np.linalg.solve(unit + NODES[:, None, None] * (root - unit), root - unit)
    log = doubled * np.einsum("k,kij->ij", WEIGHTS, parts)
    log = turn @ log @ turn.T
    for _ in range(2):
        log = log + scipy.linalg.expm(-log) @ balanced - unit
    return scale[:, None] * log / scale  # type: ignore[no-any-return]


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
    form = SchurForm.of(a)
    modes: list[Mode] = []
    rigid_sign = 0.0
    for own in _pairs(form.poles):
        group = form.poles[own]
        projector, basis = form.projector(own)
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


def _pairs(poles: np.ndarray) -> list[list[int]]:
    """Where complex pairs are, and real poles two by two from the slowest, slowest pair first; the fastest
    of an odd number of real poles is left out (a lag, which is no mode)."""
    tiny = 1e-9 * np.maximum(np.abs(poles), 1e-9)
    upper, real = poles.imag > tiny, np.flatnonzero(np.abs(poles.imag) <= tiny)
    real = real[np.argsort(np.abs(poles[real]), kind="stable")]
    pairs = [[int(k), int(k) + 1] for k in np.flatnonzero(upper)]
    pairs += [real[k : k + 2].tolist() for k in range(0, len(real) - 1, 2)]
    return sorted(pairs, key=lambda pair: float(np.abs(poles[pair]).max()))


@dataclass(frozen=True)
class SchurForm:
    """A = Q T Q' with the `poles` in the order of the diagonal, a complex pair in neighbouring places."""

    t: Array
    q: Array
    poles: np.ndarray

    @classmethod
    def of(cls, a: Array) -> SchurForm:
        if not len(a):
            return cls(a, a, np.zeros(0, complex))
        t, q = scipy.linalg.schur(a, output="real")
        poles = np.diag(t).astype(complex)
        for k in np.flatnonzero(np.diag(t, -1)):  # of LAPACK's blocks [[p, b], [c, p]], b c < 0
            poles[k : k + 2] += 1j * np.sqrt(-t[k, k + 1] * t[k + 1, k]) * np.array([1.0, -1.0])
        return cls(t, q, poles)

    def projector(self, own: list[int]) -> tuple[Array, Array]:
        """Spectral projector onto the invariant subspace of the poles `own`, (n, n), and a basis of it:
        with these first, T11 X - X T22 = T12 gives Q [I X; 0 0] Q'. All is one where another pole is the
        same to rounding."""
        n, k = len(self.t), len(own)
        others = np.delete(self.poles, own)
        scale = max(1.0, float(np.abs(self.poles).max()))
        if not len(others) or np.abs(np.subtract.outer(self.poles[own], others)).min() <= (
            1e-12 * scale
        ):
            return np.eye(n), np.eye(n)
        chosen = np.zeros(n, np.int32)
        chosen[own] = 1
        t, q, *_, failed = dtrsen(chosen, self.t, self.q, job="N")
        if failed:
            return np.eye(n), np.eye(n)
        x = scipy.linalg.solve_sylvester(t[:k, :k], -t[k:, k:], t[:k, k:])
        onto = np.hstack([np.eye(k), x]) @ q.T
        return q[:, :k] @ onto, q[:, :k]

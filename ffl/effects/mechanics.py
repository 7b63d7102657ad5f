"""Where forces act and motion is felt: the plant as a mechanical system with points.

A zeros-poles-gain says what the plant does from command to sensor, not where things are. Taken
apart into its modes, y = sum_i G_i u, each mode i has a shape phi_i(point) and
G_i = phi_i(motor) phi_i(sensor) / (s^2 + 2 zeta w s + w^2); a force at a point then drives mode i
with phi_i(point), and the motion of a point is sum_i phi_i(point) eta_i, so that a collocated
response (force and motion at one point) has positive residues only. The residues of the plant give
the products phi_i(motor) phi_i(sensor). What they leave open is settled by the two-mass picture:

* a positive residue (relative to the rigid body): sensor and motor are on the same side for that
  mode, and phi_i(load)/phi_i(motor) = -1/ratio with ratio = residue_i/residue_0;
* a negative residue: the sensor is on the load side, and phi_i(motor)^2 = ratio * phi_0^2, where
  ratio = (mass of the load side)/(mass of the motor side) is the free number `mass_ratio`; where it
  is not given, both ends are taken to move equally far, which is a ratio of 1 for two masses.

Positions are in output units, forces in input units, masses therefore in input unit s^2 / output
unit.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg

from ffl.errors import InputError
from ffl.systems.state_space import Array, StateSpace
from ffl.systems.zpk import Zpk

SIDES = ("sensor", "motor", "load", "coupling")
FAST_POLE = 1e-6  # a pole nearer to the origin of the z plane is part of a delay, not of mechanics


@dataclass(frozen=True)
class Point:
    """Force vector (state derivative per unit force) and rows that read position and velocity."""

    force: Array
    position: Array
    velocity: Array

    @property
    def mobility(self) -> float:
        """Acceleration per unit force at this point (1/mass felt at high frequency)."""
        return float(self.velocity @ self.force)


@dataclass(frozen=True)
class Mechanics:
    """The plant from command to noise-free output in continuous time, with its modes.

    dx/dt = `a` x + `b` u, y = `c` x + `d` u, u delayed by `delay` samples. `exact` holds the
    plant's own discrete matrices as long as nothing has been changed, so that the linear loop stays
    equal to the last digit. `fast` is a part that no continuous system can have under a zero-order
    hold (poles at or left of z = 0); it adds to y and feels no other force than u. `rest` reads the
    share of y that belongs to no mode. `bias` are constant forces at points, which loads and centred
    springs bring. States that effects add come last; `hung` gives their start, at rest beside the
    plant, from the plant's own states. `sensor` replaces the sensor's point where an effect has
    moved it.
    """

    a: Array
    b: Array
    c: Array
    d: float
    sample_time: float
    delay: int
    rest: Array
    modes: tuple[Mode, ...]
    exact: StateSpace | None
    fast: StateSpace
    bias: tuple[tuple[Point, float], ...] = ()
    hung: Array = field(default_factory=lambda: np.zeros((0, 0)))
    sensor: Point | None = None

    @property
    def order(self) -> int:
        return self.a.shape[0]

    @property
    def moving_mass(self) -> float:
        """1/(residue of the rigid body, or of the lowest mode), input unit s^2 / output unit."""
        if not self.modes:
            raise InputError(
                "the plant has no mode (fewer than two poles from input to output), so it moves no "
                "mass; effects on a mass do not apply to it"
            )
        return 1.0 / self.modes[0].residue

    def point(self, side: str = "sensor", mass_ratio: float | None = None) -> Point:
        """The point on `side`: 'sensor', 'motor', 'load', or 'coupling' (motor minus load)."""
        if side not in SIDES:
            raise InputError(f"side = '{side}' is unknown; take one of {', '.join(SIDES)}")
        if side == "coupling":
            motor, load = self.point("motor", mass_ratio), self.point("load", mass_ratio)
            return Point(
                motor.force - load.force,
                motor.position - load.position,
                motor.velocity - load.velocity,
            )
        if side == "sensor" and self.sensor is not None:
            return self.sensor
        if not self.modes:
            return Point(self.b, self.c, self.c @ self.a)
        force, position = np.zeros(self.order), np.array(self.rest)
        velocity = self.rest @ self.a
        for mode in self.modes:
            shape = mode.shape(side, mass_ratio, self.modes[0].residue)
            to_sensor = mode.shape("sensor", mass_ratio, self.modes[0].residue)
            force += mode.force * (mode.sign * shape)
            position += mode.position * (shape / to_sensor)
            velocity += mode.velocity * (shape / to_sensor)
        return Point(force, position, velocity)

    def with_feedback(self, point: Point, position: float, velocity: float) -> Mechanics:
        """Adds the force position * x + velocity * v at `point` to the linear part."""
        row = position * point.position + velocity * point.velocity
        return replace(self, a=self.a + np.outer(point.force, row), exact=None)

    def with_load(self, point: Point, force: float) -> Mechanics:
        """Adds a constant force at `point`."""
        return replace(self, bias=(*self.bias, (point, force)))

    def with_hung_mass(
        self, point: Point, mass: float, stiffness: float, damping: float, sensed: bool
    ) -> Mechanics:
        """Hangs `mass` on a spring and damper at `point`; `sensed`: the sensor moves with it."""
        n = self.order
        row = stiffness * point.position + damping * point.velocity
        a = np.zeros((n + 2, n + 2))
        a[:n, :n] = self.a - np.outer(point.force, row)
        a[:n, n], a[:n, n + 1] = point.force * stiffness, point.force * damping
        a[n, n + 1] = 1.0
        a[n + 1, :n], a[n + 1, n:] = row / mass, [-stiffness / mass, -damping / mass]

        def longer(vector: Array) -> Array:
            return np.append(vector, [0.0, 0.0])

        def moved(p: Point) -> Point:
            return Point(longer(p.force), longer(p.position), longer(p.velocity))

        base = self.hung.shape[1] or n
        known = np.vstack([np.eye(base), self.hung]) if len(self.hung) else np.eye(base)
        hung = np.vstack([known[base:], point.position @ known, point.velocity @ known])
        hung_point = Point(*(np.eye(n + 2)[[n + 1, n, n + 1]] * np.array([[1 / mass], [1], [1]])))
        sensor = None if self.sensor is None else moved(self.sensor)
        return replace(
            self,
            a=a,
            b=longer(self.b),
            c=hung_point.position if sensed else longer(self.c),
            rest=longer(self.rest),
            modes=tuple(
                replace(
                    mode,
                    force=longer(mode.force),
                    position=longer(mode.position),
                    velocity=longer(mode.velocity),
                )
                for mode in self.modes
            ),
            exact=None,
            bias=tuple((moved(p), f) for p, f in self.bias),
            hung=hung,
            sensor=hung_point if sensed else sensor,
        )

    def with_mass(self, point: Point, mass: float) -> Mechanics:
        """Adds the force -mass * acceleration at `point` to the linear part."""
        mobility = point.mobility
        if 1.0 + mass * mobility <= 0:
            raise InputError(
                f"a mass change of {mass:g} leaves no positive mass at the point (it has "
                f"{1 / mobility:g}); give a smaller reduction"
            )
        share = mass / (1.0 + mass * mobility)

        def changed(vector: Array) -> Array:
            return vector - point.force * (share * float(point.velocity @ vector))

        a = self.a - np.outer(point.force, share * (point.velocity @ self.a))
        modes = tuple(replace(mode, force=changed(mode.force)) for mode in self.modes)
        bias = tuple((replace(p, force=changed(p.force)), f) for p, f in self.bias)
        return replace(self, a=a, b=changed(self.b), modes=modes, exact=None, bias=bias)


@dataclass(frozen=True)
class Mode:
    """One second-order part of the plant.

    `position` and `velocity` read its share of y and dy/dt from the state, `force` is the state
    derivative that gives its share of y the acceleration `residue` = |phi(motor) phi(sensor)|,
    `sign` is the sign of that product relative to the rigid body's. Left alone, its share of y
    follows d2y/dt2 + `damping` dy/dt + `stiffness` y = 0.
    """

    force: Array
    position: Array
    velocity: Array
    residue: float
    sign: float
    stiffness: float
    damping: float
    rigid: bool

    def shape(self, side: str, mass_ratio: float | None, rigid_residue: float) -> float:
        """phi(side)/phi(motor), 1 for the rigid body."""
        if self.rigid or side == "motor":
            return 1.0
        relative = self.residue / rigid_residue
        if self.sign > 0:
            ratio = relative if mass_ratio is None else mass_ratio
            return 1.0 if side == "sensor" else -1.0 / ratio
        return -1.0 if mass_ratio is None else -relative / mass_ratio


def mechanics_of(system: Zpk | StateSpace) -> Mechanics:
    """Continuous-time mechanics of a discrete plant under a zero-order hold.

    Whole delays (poles at z = 0) are taken off and kept as delay of the command; the rest is brought
    to continuous time by the matrix logarithm, refined once. Where poles lie on the negative real
    axis, the plant is split there and they stay in discrete time.
    """
    delay, ss = _without_delay(system)
    slow, fast = _split_fast(ss)
    n = slow.order
    block = np.eye(n + 1)
    block[:n, :n], block[:n, n:] = slow.a, slow.b
    log = np.real(scipy.linalg.logm(block)) if n else np.zeros((1, 1))
    # One Newton step on exp(L) = block: the logarithm of a defective matrix loses digits.
    log = log + scipy.linalg.expm(-log) @ block - np.eye(n + 1)
    log[n:] = 0.0
    a, b, c = log[:n, :n] / slow.sample_time, log[:n, n] / slow.sample_time, slow.c[0]
    modes = _modes(a, b, c)
    rest = c - sum((mode.position for mode in modes), np.zeros(n))
    return Mechanics(a, b, c, float(slow.d[0, 0]), ss.sample_time, delay, rest, modes, slow, fast)


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


def _modes(a: Array, b: Array, c: Array) -> tuple[Mode, ...]:
    """The rigid body (two slowest poles) and one mode per further complex pair."""
    poles = np.linalg.eigvals(a) if len(a) else np.zeros(0, complex)
    groups: list[np.ndarray] = []
    rest = list(poles[np.argsort(np.abs(poles), kind="stable")])
    while rest:
        first = rest.pop(0)
        pairable = abs(first.imag) > 1e-9 * max(abs(first), 1e-9)
        if pairable:
            mate = int(np.argmin([abs(p - first.conjugate()) for p in rest]))
            groups.append(np.array([first, rest.pop(mate)]))
        elif not groups and rest and abs(rest[0].imag) <= 1e-9 * max(abs(rest[0]), 1e-9):
            groups.append(np.array([first, rest.pop(0)]))
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
        rigid_sign = rigid_sign or float(np.sign(numerator))
        sign = float(np.sign(numerator)) * rigid_sign
        stiffness, damping = float(np.prod(group).real), -float(group.sum().real)
        modes.append(
            Mode(force, position, velocity, abs(numerator), sign, stiffness, damping, not modes)
        )
    return tuple(modes)


def _projector(a: Array, group: np.ndarray, poles: np.ndarray, scale: float) -> tuple[Array, Array]:
    """Spectral projector onto the invariant subspace of `group`, and a basis of that subspace."""
    others = np.array([p for p in poles if np.abs(p - group).min() > 1e-12 * scale])
    if len(others) + len(group) != len(poles) or not len(others):
        return np.eye(len(a)), np.linalg.qr(np.eye(len(a)))[0]

    def chosen(re: float, im: float = 0.0) -> bool:
        point = complex(re, im)
        return bool(np.abs(point - group).min() < np.abs(point - others).min())

    k = len(group)
    right = scipy.linalg.schur(a, output="real", sort=chosen)[1][:, :k]
    left = scipy.linalg.schur(a.T, output="real", sort=chosen)[1][:, :k]
    return right @ np.linalg.solve(left.T @ right, left.T), right

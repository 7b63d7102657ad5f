"""What two encoders may differ by, as columns of a regression: every term with its physics.

With e = y - y_load, x the position, v and a its derivatives, tau the torque (force) that the
transmission carries:

    delay        e = D v                        the second encoder is read D s later
    scale        e = s x                        one of them, or the gear ratio, is off by s
    torsion      e = tau / c                    by load: tau = J_load a - d, all friction at the motor; by
                                                command: tau = u - J_motor a, all friction behind the spring
    friction     e = (tau + p F) / c            by load, F = u - J_motor a - tau: the share p of friction
                                                acts behind the spring, the rest at the motor
    command      e = (u - J_motor a) / c        where nothing is known of the load
    damping      e = tau / c - k tau' / c^2     k the spring's damping
    play         e = g/2 h, h in -1 .. 1        side of a gap: by travel, a play operator on the position
                                                (the load stays where it is left); by load, command or a
                                                torque between them, the sign that it had last
    ripple       e = A sin(2 pi x / P + phase)  eccentricity, gear mesh, one of the scales

x, v, a are the part of the motion that the reference (in open loop the model's answer to the command)
foretells: what shakes on one encoder alone has e = a/w^2 at every frequency w, whatever the stiffness,
and would pass for a spring (two-stage least squares; Theil 1953, Basmann 1957).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.special

from ffl.diagnose.noise.coloured import Regression, noise_beside, order_of, regress
from ffl.diagnose.transmission.encoders import Pair
from ffl.systems.state_space import Array

POSITIVE = {"torsion", "friction", "command", "play", "inertia"}
MOST = 3  # ripples
AGREES = 0.25  # relative: two ways to one stiffness


@dataclass(frozen=True)
class Known:
    """What is known of the machine, in force and output units; None where it is not."""

    load_mass: float | None
    motor_mass: float
    has_load: bool
    has_command: bool
    moved: bool


@dataclass(frozen=True)
class Term:
    """A term of the difference; `by` says what winds up a spring or drives a play, `period` is a
    ripple's, `reach` how far a play's driver goes before its side changes, from `side` at the start,
    `share` how much of the friction is in that driver."""

    name: str
    by: str = ""
    period: float = 0.0
    reach: float = 0.0
    side: float = 0.0
    share: float = 0.0

    def __str__(self) -> str:
        return f"{self.name} by {self.by}" if self.by else self.name

    @property
    def size(self) -> int:
        """Free numbers."""
        return 2 if self.name in ("ripple", "command") else 1


@dataclass(frozen=True)
class Scene:
    """Recordings as they stand, and with the second encoder read `shift` s later; where there is a spring,
    the difference is free of what the acceleration that nobody foretold winds up, `wound` times it."""

    plain: tuple[Pair, ...]
    shifted: tuple[Pair, ...]
    shift: float
    known: Known
    order: int
    phi: Array
    wound: float = 0.0

    def pairs(self, terms: Sequence[Term]) -> tuple[Pair, ...]:
        return self.shifted if any(t.name == "delay" for t in terms) else self.plain

    def targets(self, terms: Sequence[Term]) -> list[Array]:
        """The difference in every recording."""
        wound = self.wound if any(t.name == "torsion" for t in terms) else 0.0
        return [p.difference - wound * p.unforetold for p in self.pairs(terms)]

    def winding(self, fit: Fit) -> Scene:
        """With the spring of `fit`, where the acceleration that nobody foretold winds it up by as much:
        what shakes on one encoder has another ratio, and is left as noise."""
        known, wound = self.known, 0.0
        for term in fit.terms:
            if term.name == "torsion":
                by_load = term.by == "load"
                wound += fit.value(term.name)[0] * (
                    (known.load_mass or 0.0) if by_load else -known.motor_mass
                )
            elif term.name == "friction":
                mass = known.motor_mass + (known.load_mass or 0.0)
                wound -= fit.value(term.name)[0] * mass
        if wound == 0.0:
            return replace(self, wound=0.0)
        tables = [
            np.column_stack([table, wound * p.unforetold])
            for table, p in zip(self.tables(fit.terms), self.pairs(fit.terms), strict=True)
        ]
        bare = [p.difference for p in self.pairs(fit.terms)]
        found = regress(bare, tables, self.phi)
        alike = found is not None and abs(float(found.values[-1]) - 1.0) < AGREES
        return replace(self, wound=wound if alike else 0.0)

    def tables(self, terms: Sequence[Term]) -> list[Array]:
        """(n, columns) of every recording: an offset each, then the terms."""
        pairs = self.pairs(terms)
        out = []
        for i, pair in enumerate(pairs):
            offsets = np.zeros((len(pair.t), len(pairs)))
            offsets[:, i] = 1.0
            out.append(np.column_stack([offsets, *(columns(t, pair, self.known) for t in terms)]))
        return out

    def beside(self, terms: Sequence[Term]) -> Scene:
        """With the noise that `terms` leave together with all that needs no search."""
        known = self.known
        more = [Term("delay"), Term("scale")]
        if known.moved and (known.load_mass is not None or known.has_load):
            more.append(Term("torsion", "load"))
            if known.has_command and known.load_mass is not None:
                more.append(Term("friction"))
        rich = [*terms, *(m for m in more if all(t.name != m.name for t in terms))]
        targets, tables = self.targets(rich), self.tables(rich)
        order = self.order
        if not order:
            values = np.linalg.lstsq(np.concatenate(tables), np.concatenate(targets), rcond=1e-9)[0]
            order = order_of([y - x @ values for y, x in zip(targets, tables, strict=True)])
        return replace(self, order=order, phi=noise_beside(targets, tables, order))

    def fit(self, terms: Sequence[Term]) -> Fit | None:
        """The terms together; None where they cannot be told apart at all."""
        targets = self.targets(terms)
        found = regress(targets, self.tables(terms), self.phi)
        return None if found is None else Fit(tuple(terms), found, len(targets))


@dataclass(frozen=True)
class Fit:
    """A regression with the meaning of its columns; the first `offsets` are the encoders' zeros."""

    terms: tuple[Term, ...]
    regression: Regression
    offsets: int

    def place(self, term: Term) -> slice:
        at = self.offsets
        for other in self.terms:
            if other == term:
                return slice(at, at + other.size)
            at += other.size
        raise KeyError(term.name)

    def value(self, name: str) -> tuple[float, float]:
        """Value and standard error of the first number of the term `name`; (0, 0) where it is not there."""
        for term in self.terms:
            if term.name == name:
                at = self.place(term).start
                return float(self.regression.values[at]), float(self.regression.std_errors[at])
        return 0.0, 0.0

    def has(self, name: str) -> bool:
        return any(t.name == name for t in self.terms)

    @property
    def physical(self) -> bool:
        """A spring holds, a gap is not negative, damping takes, and no more friction than there is acts
        behind the spring."""
        for term in self.terms:
            value = float(self.regression.values[self.place(term).start])
            if term.name in POSITIVE and value <= 0.0:
                return False
            if term.name == "damping" and value >= 0.0:
                return False
        if not self.believable:
            return False
        if self.has("command"):
            at = self.place(next(t for t in self.terms if t.name == "command"))
            values, errors = self.regression.values[at], self.regression.std_errors[at]
            return bool(values[1] < 2.0 * errors[1])  # the motor's inertia takes away
        return True

    @property
    def believable(self) -> bool:
        """As `physical`, but that a spring may still be stiffer than can be told."""
        if not self.has("friction"):
            return True
        share, whole = self.value("friction")[0], self.value("torsion")[0]
        return 0.0 < share < whole


def torque(pair: Pair, known: Known) -> Array:
    """What the load asks of the transmission: J_load a - d."""
    out = np.zeros(len(pair.t))
    if known.load_mass is not None:
        out = out + known.load_mass * pair.acceleration
    return out if pair.load is None else out + pair.load


def columns(term: Term, pair: Pair, known: Known) -> Array:
    """(n, size) of a term in one recording."""
    if term.name == "delay":
        out = pair.velocity
    elif term.name == "scale":
        out = pair.measured
    elif term.name == "torsion" and term.by == "command":
        out = pair.sent - known.motor_mass * pair.acceleration
    elif term.name == "torsion":
        out = torque(pair, known)
    elif term.name == "inertia":
        out = pair.acceleration
    elif term.name == "friction":
        out = pair.sent - known.motor_mass * pair.acceleration - torque(pair, known)
    elif term.name == "command":
        out = np.column_stack([pair.sent, pair.acceleration])
    elif term.name == "damping":
        out = known.load_mass * pair.jerk
        out = out if pair.load_rate is None else out + pair.load_rate
    elif term.name == "play":
        x = driving(term, pair, known)
        if term.by == "travel":
            out = contact(x, term.reach, term.side)
        else:
            out = relay(x, term.reach, term.side, pair.width / pair.step)
    else:
        z = 2.0 * np.pi * pair.measured / term.period
        fade = np.exp(-0.5 * (2.0 * np.pi * pair.width * pair.velocity / term.period) ** 2)
        out = np.column_stack([fade * np.sin(z), fade * np.cos(z)])
    return out.reshape(len(pair.t), -1)


def driving(term: Term, pair: Pair, known: Known) -> Array:
    """What takes a play to its sides: the position, the load's torque, the command less the motor's
    inertia, or a torque between these two with a share of the friction."""
    if term.by == "travel":
        return pair.position
    if term.by == "load":
        return torque(pair, known)
    given = pair.sent - known.motor_mass * pair.acceleration
    if term.by == "torque":
        return (1.0 - term.share) * torque(pair, known) + term.share * given
    return given


def contact(x: Array, reach: float, side: float) -> Array:
    """Side of a gap, -1 to 1, that a position `x` has taken: changed where it has gone back by twice
    `reach`; `side` at the start."""
    out = np.empty(len(x))
    rest = x[0] - side * reach
    for k, value in enumerate(x):
        rest = min(max(rest, value - reach), value + reach)
        out[k] = (value - rest) / reach
    return out


def relay(x: Array, reach: float, side: float, width: float) -> Array:
    """Side of a gap, -1 to 1, that a torque `x` has taken: changed where it passes `reach` the other way;
    `side` at the start. Changes are smoothed as the signals are, by a Gaussian of `width` samples."""
    at = np.arange(len(x), dtype=float)
    out, now = np.full(len(x), side), side
    for k in np.flatnonzero(np.abs(x) > reach):
        new = float(np.sign(x[k]))
        if new != now:
            slope = x[k] - x[k - 1] if k else 0.0
            time = k - (x[k] - new * reach) / slope if slope * new > 0.0 else float(k)
            change = 0.5 * scipy.special.erfc((time - at) / (np.sqrt(2.0) * width))
            out, now = out + (new - now) * change, new
    return out


def with_motion(
    pairs: Sequence[Pair], drives: Sequence[Array]
) -> tuple[tuple[Pair, ...], float, float]:
    """The pairs with the motion as `drives` (n, k) foretell it, and the shares of position and
    acceleration that this is."""
    basis = np.concatenate(drives)
    basis = basis / np.maximum(np.sqrt((basis**2).sum(axis=0)), 1e-300)
    q, r = np.linalg.qr(basis)
    size = np.abs(np.diag(r))
    q = q[:, size > 1e-9 * size.max(initial=1e-300)]
    names = ("position", "velocity", "acceleration", "jerk")
    whole = {n: np.concatenate([getattr(p, n) for p in pairs]) for n in names}
    seen = {n: q @ (q.T @ x) for n, x in whole.items()}
    shares = {n: 1.0 - _power(whole[n] - seen[n]) / max(_power(whole[n]), 1e-300) for n in names}
    ends = np.cumsum([len(p.t) for p in pairs])[:-1]
    parts = {n: np.split(x, ends) for n, x in seen.items()}
    made = tuple(
        replace(
            p,
            unforetold=p.acceleration - parts["acceleration"][i],
            position=parts["position"][i],
            velocity=parts["velocity"][i],
            acceleration=parts["acceleration"][i],
            jerk=parts["jerk"][i],
        )
        for i, p in enumerate(pairs)
    )
    return made, shares["position"], shares["acceleration"]


def _power(x: Array) -> float:
    return float(np.sum((x - x.mean()) ** 2))

"""Dry friction predicted sample by sample: a Kalman filter that sticks and slips.

Noise that moves a machine as much as its command does smooths dry friction: where the speed is in doubt by
more than it is, the friction in the mean is a damping, and a simulation without noise, which knows its
speed, asks for half the level. The filter keeps state and doubt. Over a sample everything but the friction
moves the speed at its point to v with standard deviation s; the friction takes off what it can, up to what
its level changes the speed by,

    v' = v - clip(v, -d-, d+),   d+- = level+- (what a unit of force there changes v by),

of which mean, slope and what is left of the variance beside the slope are known for a Gaussian v. A contact
that yields before it slides is a spring of the plant whose stretch z is held within what the level makes of
it, z' = clip(z, -d-, d+), in the same way. The innovations have the likelihood of `foretold`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numba import njit

from ffl.diagnose.hypothesis.linear import corrected
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.predict.company import separable, without
from ffl.diagnose.predict.foretold import Foretold
from ffl.diagnose.recorded.trials import Trial
from ffl.effects import EFFECTS
from ffl.effects.base import Setting
from ffl.errors import InputError
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

FORMS = (
    "coulomb_friction",
    "asymmetric_friction",
    "stribeck_friction",
    "presliding_friction",
    "position_dependent_friction",
)
LINEAR = frozenset(
    {"viscous_friction", "mass_change", "linear_stiffness", "constant_load", "flexible_mode"}
)
NEVER = 1e12  # speeds over which a level that does not fall would fall
NONE = (0.0, 0.0, NEVER)
UNKNOWN = 10.0  # times what noise alone makes of the state: where a recording begins in motion
STEPS = 4  # of a sample, where a contact yields
STIFF = 2.5  # what a contact turns by in a sample: one that is stiffer yields in none
DOUBLINGS = 10  # 1,024 samples, in which noise has made of the state what it may be in doubt by
STEP = 0.01  # of a logarithm, or of a number's scale, for derivatives


@njit(cache=True, nogil=True)
def _beyond(depth, spread):  # type: ignore[no-untyped-def]
    """(probability of being above zero, mean and mean square of max(0, d)) of d, Gaussian about `depth`."""
    a = depth / spread
    if a > 8.0:
        return 1.0, depth, depth * depth + spread * spread
    if a < -8.0:
        return 0.0, 0.0, 0.0
    share = 0.5 * (1.0 + math.erf(a * 0.7071067811865476))
    bell = 0.3989422804014327 * math.exp(-0.5 * a * a)
    square = (a * a + 1.0) * share + a * bell
    return share, spread * (a * share + bell), spread * spread * square


@njit(cache=True, nogil=True)
def _level(grid, values, x):  # type: ignore[no-untyped-def]
    """Straight between knots, constant beyond the ends."""
    if x <= grid[0]:
        return values[0]
    for k in range(1, len(grid)):
        if x < grid[k]:
            share = (x - grid[k - 1]) / (grid[k] - grid[k - 1])
            return values[k - 1] + share * (values[k] - values[k - 1])
    return values[-1]


@njit(cache=True, nogil=True)
def _filter(  # type: ignore[no-untyped-def]
    y, u, x, p, move, push, drift, colour, renewed, steps, row, spot, speed, kick, table, ease, white,
    bristle,
):  # fmt: skip  # type: ignore[no-untyped-def]
    """(innovations (N,), their standard deviations (N,)).

    State x (n,) with covariance p, at the first sample before its y is seen; its last are noises, held over
    a sample and then `colour` (c,) of themselves, with variances `renewed` (c,) of what is new. move
    (n, n), push (n,) from u, drift (n,) from constant forces: one of the `steps` of a sample, without
    friction; row, spot, speed (n,): y, position and speed at the friction's point; kick (n,): of a force
    there that changes that speed by 1. table (3, k): positions, and what the friction takes off the speed
    in a step there, moving up and down. ease: how much more of it at rest, as a share and as that, and the
    speed over which that falls. white: variance of y's white noise. `bristle`: speed and kick are those of
    a contact's stretch, and it is the stretch that the table bounds.
    """
    n, samples = len(x), len(y)
    out, scale = np.empty(samples), np.empty(samples)
    other, new = np.empty((n, n)), np.empty(n)
    pc, pv = np.empty(n), np.empty(n)
    for t in range(samples):
        seen, s = 0.0, white
        for i in range(n):
            pc[i] = 0.0
            for j in range(n):
                pc[i] += p[i, j] * row[j]
            seen += row[i] * x[i]
            s += row[i] * pc[i]
        e = y[t] - seen
        out[t], scale[t] = e, np.sqrt(s)
        for i in range(n):
            x[i] += pc[i] * e / s
            for j in range(n):
                p[i, j] -= pc[i] * pc[j] / s
        for _ in range(steps):
            for i in range(n):
                new[i] = push[i] * u[t] + drift[i]
                for j in range(n):
                    new[i] += move[i, j] * x[j]
                    other[i, j] = 0.0
                    for k in range(n):
                        other[i, j] += move[i, k] * p[k, j]
            for i in range(n):
                x[i] = new[i]
                for j in range(i + 1):
                    total = 0.0
                    for k in range(n):
                        total += other[i, k] * move[j, k]
                    p[i, j] = total
                    p[j, i] = total
            v, square, place = 0.0, 0.0, 0.0
            for i in range(n):
                place += spot[i] * x[i]
                pv[i] = 0.0
                for j in range(n):
                    pv[i] += p[i, j] * speed[j]
                v += speed[i] * x[i]
                square += speed[i] * pv[i]
            doubt = np.sqrt(max(square, 1e-300))
            bell = 0.0
            if ease[0] != 0.0 or ease[1] != 0.0:  # the mean of exp(-(v/w)^2) over the doubt
                width = 1.0 + 2.0 * square / (ease[2] * ease[2])
                bell = math.exp(-v * v / (ease[2] * ease[2] * width)) / np.sqrt(width)
            more = 1.0 + ease[0] * bell
            rising = more * _level(table[0], table[1], place) + ease[1] * bell
            falling = more * _level(table[0], table[2], place) + ease[1] * bell
            if rising <= 0.0 and falling <= 0.0 and not bristle:
                continue
            up, mean_up, square_up = _beyond(v - rising, doubt)
            down, mean_down, square_down = _beyond(-v - falling, doubt)
            left, slope = mean_up - mean_down, up + down
            rest = max(square_up + square_down - left * left - slope * slope * square, 0.0)
            # p' = (1 - g kick speed) p (...)' + rest kick kick', g the share that sticks, or slides
            g, change = 1.0 - slope, v - left
            if bristle:
                g, change = slope, left
            for i in range(n):
                x[i] -= kick[i] * change
            for i in range(n):
                for j in range(i + 1):
                    total = p[i, j] - g * (kick[i] * pv[j] + pv[i] * kick[j])
                    total += (g * g * square + rest) * kick[i] * kick[j]
                    p[i, j] = total
                    p[j, i] = total
        for k in range(len(colour)):
            at = n - len(colour) + k
            x[at] *= colour[k]
            for j in range(n):
                p[at, j] *= colour[k]
                p[j, at] *= colour[k]
            p[at, at] += renewed[k]
    return out, scale


@dataclass(frozen=True)
class Slipping:
    """The plant of a model and the dry friction in it, ready to predict. In a basis in which noise makes
    all states equally large a covariance stays one."""

    a: Array
    drive: Array
    load: Array
    output: Array
    force: Array
    place: Array
    speed: Array
    table: Array  # (3, k): positions and the levels there in either direction, input units
    ease: tuple[float, float, float]  # more at rest, as a share and in input units, and its speed
    bristle: float  # stiffness of a contact, input units; 0: it does not yield
    hung: Array
    delay: int
    sample_time: float

    @classmethod
    def of(cls, model: Model) -> Slipping | None:
        """None for a plant that no such filter describes (parts faster than any continuous system), or
        where something stands beside the friction that is neither `LINEAR` nor separable."""
        per = model.base.simulator.force_per_input
        mechanics = corrected(model.base.simulator.mechanics, dict(model.corrections))
        dry = None
        for spec in model.effects:
            setting = Setting(per, mechanics, spec.options)
            if spec.name in LINEAR:
                mechanics = EFFECTS[spec.name].modify(mechanics, spec.parameters, setting)
            elif spec.name in FORMS and dry is None:
                dry = spec
            elif not separable(spec):
                return None
        if (
            mechanics.fast.order
            or mechanics.place is not None
            or mechanics.d
            or not mechanics.modes
        ):
            return None
        if dry is None:
            point, table, eases, bristle = mechanics.point("motor"), np.zeros((3, 1)), NONE, 0.0
        else:
            setting = Setting(per, mechanics, dry.options)
            point = setting.point(EFFECTS[dry.name].side_in(setting))
            table, eases = levels(dry, per), ease(dry, per)
            bristle = dry.parameters.get("stiffness", 0.0) / per
        load = sum((f * at.force for at, f in mechanics.bias), np.zeros(mechanics.order))
        return cls(
            mechanics.a, mechanics.b, load, mechanics.c, point.force, point.position,
            point.velocity, table, eases,
            bristle, mechanics.hung, mechanics.delay, mechanics.sample_time,
        )  # fmt: skip

    def predict(self, trial: Trial, noise: Noise) -> tuple[Array, Array]:
        """(innovations (N,) in output units, their standard deviations (N,)) of one recording, from y
        and u as measured."""
        n, step = len(self.a), self.sample_time
        stiffness = self.bristle
        if np.sqrt(stiffness * float(self.speed @ self.force)) * step > STIFF:
            stiffness = 0.0
        m = n + (stiffness > 0.0)  # the stretch of a contact is one state more
        block = np.zeros((m + 3, m + 3))
        block[:n, :n] = self.a
        if m > n:
            block[:n, n], block[n, :n] = -stiffness * self.force, self.speed
        block[:n, m:] = np.column_stack([self.drive, self.load, self.force])
        held = scipy.linalg.expm(block * step)
        swing = _swing(held[:m, :m], held[:m, m])
        large = np.sqrt(np.diag(swing))
        steps = STEPS if m > n else 1
        held = scipy.linalg.expm(block * step / steps)
        move, (push, drift, force) = held[:m, :m], held[:m, m:].T
        move = move * large / large[:, None]
        push, drift, force = push / large, drift / large, force / large
        # Noises of sensor and force that stay over a sample or longer are the last states.
        corners = np.array([noise.sensor_corner, noise.force_corner, np.inf])
        colour = np.exp(-2 * np.pi * corners * step)
        power = np.array([noise.sensor_coloured, noise.force_coloured, noise.force]) ** 2
        whole = np.eye(m + 3)
        whole[:m, :m], whole[:m, m + 1], whole[:m, m + 2] = move, push, push
        push, drift, force, large = (
            np.append(b, (0.0, 0.0, 0.0)) for b in (push, drift, force, large)
        )
        rows = np.zeros((4, m + 3))
        rows[:3, :n] = np.stack([self.output, self.place, self.speed]) * large[:n]
        rows[0, m] = 1.0
        if m > n:
            rows[3, n] = large[n]
            # Beyond its bounds the stretch has pushed as well, in the mean by half of its excess.
            per, at, kick = 1.0 / stiffness, rows[3], -0.5 * stiffness * force
            kick[n] += 1.0 / large[n]
        else:
            per, at = float(rows[2] @ force), rows[2]
            kick = force / per
        table = self.table * np.array([[1.0], [per], [per]])
        x, p = self._start(trial, power, large[:m], swing / np.outer(large[:m], large[:m]))
        sent = trial.u if trial.load is None else trial.u + trial.load
        if self.delay:
            sent = np.concatenate([np.full(self.delay, sent[0]), sent[: -self.delay]])
        return _filter(
            trial.y, sent, x, p, whole, push, drift, colour, power * (1.0 - colour**2), steps, rows[0],
            rows[1], at, kick, table, np.array(self.ease) * np.array([1.0, per, 1.0]), noise.sensor**2,
            m > n,
        )  # fmt: skip

    def _start(self, trial: Trial, power: Array, large: Array, swing: Array) -> tuple[Array, Array]:
        """State at the first sample and its covariance: as the linear model has it, in doubt by what noise
        makes of it, and in motion by much more. `power`: variances of the noises."""
        n, m = len(self.a), len(large)
        own = n - len(self.hung)
        known = np.vstack([np.eye(own), self.hung]) if len(self.hung) else np.eye(n)
        known = known / large[:n, None]
        x, p = np.zeros(m + len(power)), np.zeros((m + len(power),) * 2)
        x[:n] = known @ trial.start[:own]
        p[:n, :n] = known @ trial.doubt[:own, :own] @ known.T
        p[:m, :m] += (1.0 if trial.at_rest else UNKNOWN) ** 2 * power[1:].sum() * swing
        p[m:, m:] = np.diag(power)
        return x, p


def levels(spec: EffectSpec, per: float) -> Array:
    """Positions, and the levels there moving up and down in input units, (3, k)."""
    p = spec.parameters
    if spec.name == "position_dependent_friction":
        table = p["table"]
        return np.array(
            [table["grid"], *(np.array(table[k]) / per for k in ("positive", "negative"))]
        )
    if spec.name == "asymmetric_friction":
        return np.array([[0.0], [p["level_positive"] / per], [p["level_negative"] / per]])
    level = p["coulomb_level" if spec.name == "stribeck_friction" else "level"] / per
    return np.array([[0.0], [level], [level]])


def ease(spec: EffectSpec, per: float) -> tuple[float, float, float]:
    """How much more of the level there is at rest, as a share and in input units, and the speed over which
    that falls."""
    p = spec.parameters
    if spec.name == "stribeck_friction":
        return 0.0, (p["static_level"] - p["coulomb_level"]) / per, p["stribeck_velocity"]
    if p.get("stribeck_velocity", 0.0) > 0.0:
        return p["static_ratio"] - 1.0, 0.0, p["stribeck_velocity"]
    return NONE


def _swing(move: Array, push: Array) -> Array:
    """Covariance of the state that white unit noise beside the command makes in 2^DOUBLINGS samples."""
    swing, power = np.outer(push, push), move
    for _ in range(DOUBLINGS):
        swing, power = swing + power @ swing @ power.T, power @ power
    return swing


@dataclass(frozen=True)
class Slip(Foretold):
    """A model whose dry friction, if it has one, is foretold by `Slipping`; what else it has belongs to
    the linear part (`LINEAR`), or can be taken out of the recordings (`company`)."""

    @property
    def steps(self) -> Array:
        return np.array([STEP if c.log else STEP * c.scale for c in self.model.coordinates])

    def predict(self, trials):  # type: ignore[no-untyped-def]
        """See `Foretold.predict`."""
        try:
            slipping = Slipping.of(self.model)
        except InputError:
            return None
        if slipping is None:
            return None
        others = [spec for spec in self.model.effects if separable(spec)]
        seen = [without(trial, others) if others else trial for trial in trials]
        pairs = [slipping.predict(trial, self.noise) for trial in seen]
        e, s = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
        with np.errstate(all="ignore"):
            white = e / s
        return (white, np.log(s)) if np.all(np.isfinite(white)) else None

    def linearised(self, trials, found, factor):  # type: ignore[no-untyped-def]
        """By Fisher's scoring: w = e/s and (1 - w^2)/sqrt(2), with de/s and sqrt(2) d(log s), since what a
        friction holds is known better as well as elsewhere."""
        white = found[0] / factor
        moved, scales = self._changes(trials, found)
        table = np.vstack([moved / factor, np.sqrt(2.0) * scales])
        return np.concatenate([white, (1.0 - white**2) / np.sqrt(2.0)]), -table

    def columns(self, trials, white):  # type: ignore[no-untyped-def]
        """Derivatives of the prediction in units of its doubt, (N, p)."""
        found = self.predict(trials)
        return -self._changes(trials, found)[0]

    def _changes(self, trials, found):  # type: ignore[no-untyped-def]
        """(derivatives of e, in units of s, and of log s by theta)."""
        theta = self.theta
        moved, scales = (np.zeros((len(found[0]), len(theta))) for _ in range(2))
        for k, step in enumerate(self.steps):
            other = theta.copy()
            other[k] += step
            there = self.at(other).predict(trials)
            if there is not None:
                ratio = np.exp(there[1] - found[1])
                moved[:, k] = (there[0] * ratio - found[0]) / step
                scales[:, k] = (there[1] - found[1]) / step
        return moved, scales

"""Play in a coupling, predicted sample by sample: a Kalman filter that switches with the contact.

A loop around a coupling with play rattles. Where motor and load fly free of one another nothing holds
their paths together, so two runs of the very same machine part within a second: a free-running
simulation, right in every number, is no nearer to a recording than one without the play. What
remains the same in both is the law of motion. Within the gap the plant is linear, two masses apart;
in contact it is linear too, two masses on a spring. The filter keeps the plant's state at what y and
the command as sent tell of it, moves on with the one or the other, and its innovations have

    log p(y_t | all before) = -(log(2 pi S_t) + e_t^2/S_t)/2,

the same likelihood that whitening gives every hypothesis whose free run can be trusted: fed back or
not, the command is known once y is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numba import njit

from ffl.diagnose.hypothesis.linear import corrected
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.predict.clipped import LOST, MEMORY
from ffl.diagnose.predict.company import along, forces_along
from ffl.diagnose.predict.slipping import FORMS, ease, levels
from ffl.diagnose.recorded.trials import Trial
from ffl.effects import EFFECTS
from ffl.effects.base import Setting
from ffl.effects.point import Point
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

# Radian that the contact's resonance turns in one sub-step at most. Finer ones are no better: by the true
# numbers what is left of 72 recordings has 1.03 times the variance foretold, and at 0.1 it has 1.23.
FINE = 0.3
# Sub-steps of a sample: enough for a contact that rings at the sampling rate. What rings faster is rigid
# to all that is seen (130 Hz sampled at 20 Hz asked for 409 of them: 12 minutes did not end the search).
MOST_SUBSTEPS = 64
STATES = 6  # two masses and two noises: known to the compiler, whose code is twice as fast for it


@njit(cache=True, nogil=True, error_model="numpy")
def _rectified(depth, spread):  # type: ignore[no-untyped-def]
    """(probability of being above zero, density at zero times the variance, variance of max(0, d) that a
    line through its mean does not explain) of d, Gaussian about `depth`."""
    a = depth / spread
    if a > 6.0:
        return 1.0, 0.0, 0.0
    if a < -6.0:
        return 0.0, 0.0, 0.0
    share = 0.5 * (1.0 + math.erf(a * 0.7071067811865476))
    bell = 0.3989422804014327 * math.exp(-0.5 * a * a)
    mean = a * share + bell
    rest = (a * a + 1.0) * share + a * bell - mean * mean - share * share
    return share, spread * bell, spread * spread * max(rest, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _passing(depth, spread, way):  # type: ignore[no-untyped-def]
    """The same of d in the mean over a sub-step on which its mean goes `way` about `depth`, evenly: with G
    and H the first and second integral of the Gaussian distribution, (G(+) - G(-))/way of being above and
    (H(+) - H(-))/way of max(0, d): how d goes is no doubt about it. Last how the first goes with depth."""
    way = abs(way)
    if way < 0.1 * spread:
        share, up, wide = _rectified(depth, spread)
        return share, up, wide, up / (spread * spread)
    if depth - 0.5 * way > 6.0 * spread:
        return 1.0, 0.0, 0.0, 0.0
    if depth + 0.5 * way < -6.0 * spread:
        return 0.0, 0.0, 0.0, 0.0
    share, mean, steep = 0.0, 0.0, 0.0
    for sign in (1.0, -1.0):
        z = depth + sign * 0.5 * way
        a = z / spread
        below = 0.5 * (1.0 + math.erf(a * 0.7071067811865476))
        bell = 0.3989422804014327 * math.exp(-0.5 * a * a) * spread
        steep += sign * below / way
        share += sign * (z * below + bell) / way
        mean += sign * 0.5 * ((z * z + spread * spread) * below + z * bell) / way
    square = spread * spread
    whole = square + way * way / 12.0
    wide = _rectified(depth, math.sqrt(whole))[2] * (square / whole) ** 2
    return share, mean - share * depth, wide, steep


@njit(cache=True, nogil=True, error_model="numpy")
def _clipped(middle, spread, low, high):  # type: ignore[no-untyped-def]
    """(mean of max(low, min(high, c)), probability of lying between, variance that a line through the mean
    does not explain) of c, Gaussian about `middle`."""
    above, over, wide = _rectified(middle - high, spread)
    below, under, deep = _rectified(low - middle, spread)
    mean = middle - (middle - high) * above - over + (low - middle) * below + under
    return mean, max(1.0 - above - below, 0.0), min(wide + deep, 0.25 * (high - low) ** 2)


@njit(cache=True, nogil=True, error_model="numpy")
def _filter(y, drive, x, p, moves, kick, spread, rows, law, white, again, rub, substeps):  # type: ignore[no-untyped-def]
    """(innovations (N,), their standard deviations (N,)).

    State x (n,) with covariance p, at the first sample before its y is seen. moves (2, n, n), drive
    (2, N, n) from the forces that are known, spread (2, n, n): one sub-step in the gap and in contact;
    kick (n,): in contact, of a spring compressed by 1. rows (3, n): y, stretch, its rate. law:
    half the gap, stiffness and damping in contact, sub-step. white: variance of y's white noise. again
    (n, n): added to p where the innovations say that the filter has lost the stretch.
    rub: of dry friction the row (n,) that reads the speed which it takes towards zero, what it pushes
    (2, n), and its force at most (2, N) either way.
    """
    n, samples = STATES, len(y)
    out, scale = np.empty(samples), np.empty(samples)
    surprise = 1.0
    half, stiffness, damping, step = law[0], law[1], law[2], law[3]
    other, blend, new = np.empty((n, n)), np.empty((n, n)), np.empty(n)
    feel, brake, level = rub
    dry = np.any(level > 0.0)
    held, felt = np.empty(n), np.empty(n)
    for t in range(samples):
        seen = 0.0
        pc = np.zeros(n)
        for i in range(n):
            seen += rows[0, i] * x[i]
            for j in range(n):
                pc[i] += p[i, j] * rows[0, j]
        s = white
        for i in range(n):
            s += rows[0, i] * pc[i]
        e = y[t] - seen
        out[t], scale[t] = e, np.sqrt(s)
        surprise += MEMORY * (min(e * e / s, 10.0 * LOST) - surprise)
        for i in range(n):
            x[i] += pc[i] * e / s
            for j in range(n):
                p[i, j] -= pc[i] * pc[j] / s
        if surprise > LOST:
            surprise = 1.0
            for i in range(n):
                for j in range(n):
                    p[i, j] += again[i, j]
        for _ in range(substeps):
            stretch, rate = 0.0, 0.0
            for i in range(n):
                stretch += rows[1, i] * x[i]
                rate += rows[2, i] * x[i]
            doubt = 0.0
            for i in range(n):
                for j in range(n):
                    doubt += rows[1, i] * p[i, j] * rows[1, j]
            doubt = np.sqrt(max(doubt, 0.0) + 1e-30)
            stretch += 0.5 * rate * step
            lag = damping * rate / stiffness  # a contact that lets go never pulls
            above, up, wide, rise = _passing(stretch - half + min(lag, 0.0), doubt, rate * step)
            below, down, deep, fall = _passing(-stretch - half - max(lag, 0.0), doubt, rate * step)
            share = above + below
            shift = half * (above - below) - up + down
            for i in range(n):
                total = (1.0 - share) * drive[0, t, i] + share * drive[1, t, i] + shift * kick[i]
                for j in range(n):
                    blend[i, j] = (1.0 - share) * moves[0, i, j] + share * moves[1, i, j]
                    total += blend[i, j] * x[j]
                new[i] = total
            for i in range(n):
                x[i] = new[i]
            # Met later it damps less long: a push that begins at a step is in doubt by when.
            jump = abs(lag) * (rise if rate > 0.0 else fall) * doubt
            for i in range(n):
                for j in range(n):
                    total = 0.0
                    for k in range(n):
                        total += blend[i, k] * p[k, j]
                    other[i, j] = total
            for i in range(n):
                for j in range(i + 1):
                    total = (1.0 - share) * spread[0, i, j] + share * spread[1, i, j]
                    total += (wide + deep + jump * jump) * kick[i] * kick[j]
                    for k in range(n):
                        total += other[i, k] * blend[j, k]
                    p[i, j] = total
                    p[j, i] = total
            if dry:  # the force that would stop it within the sub-step, as far as friction can
                speed, power, give = 0.0, 0.0, 0.0
                for i in range(n):
                    held[i] = (1.0 - share) * brake[0, i] + share * brake[1, i]
                    felt[i] = 0.0
                    for j in range(n):
                        felt[i] += p[i, j] * feel[j]
                    speed += feel[i] * x[i]
                    power += feel[i] * felt[i]
                    give += feel[i] * held[i]
                force, sticks, rest = _clipped(
                    speed / give, np.sqrt(max(power, 0.0)) / give + 1e-12 * (level[0, t] + level[1, t]),
                    -level[1, t], level[0, t],
                )  # fmt: skip
                sticks /= give
                rest += sticks * sticks * power
                for i in range(n):
                    x[i] -= held[i] * force
                    for j in range(n):
                        p[i, j] += rest * held[i] * held[j]
                        p[i, j] -= sticks * (held[i] * felt[j] + felt[i] * held[j])
    return out, scale


@dataclass(frozen=True)
class Switching:
    """The plant of a model whose last effect is a backlash with a contact, ready to predict; of others
    what belongs to the linear part is in it.

    In the order stretch, rate and output, its rate (rates times the sample time) the states have
    like sizes, which a covariance needs.
    """

    free: Array
    contact: Array
    drive: Array
    load: Array
    press: Array
    output: Array
    point: Point
    hung: Array
    turn: Array
    gap: float
    stiffness: float
    damping: float
    resonance: float
    rubs: Point
    friction: EffectSpec | None
    driven: tuple[tuple[EffectSpec, Array], ...]  # forces along the motion as measured, and where
    per: float
    delay: int
    sample_time: float

    @classmethod
    def of(cls, model: Model) -> Switching | None:
        """None where the plant is not one of two masses on a spring, with or without the effect, which
        is the last of the model's."""
        spec = model.effects[-1]
        effect = EFFECTS[spec.name]
        per, dry = model.base.simulator.force_per_input, None
        linear = corrected(model.base.simulator.mechanics, dict(model.corrections))
        for other in model.effects[:-1]:
            setting = Setting(per, linear, other.options)
            linear = EFFECTS[other.name].modify(linear, other.parameters, setting)
            dry = other if other.name in FORMS and not along(other) else dry
        setting = Setting(per, linear, spec.options)
        mechanics = effect.modify(linear, spec.parameters, setting)
        setting = replace(setting, mechanics=mechanics)
        if mechanics.order != 4 or mechanics.fast.order or mechanics.place is not None:
            return None
        gap, stiffness, damping, contact = effect.pack(spec.parameters, setting)

        def at(other: EffectSpec | None) -> Point:
            if other is None:
                return setting.point("motor")
            own = replace(setting, options=other.options)
            return setting.point(EFFECTS[other.name].side_in(own))

        point = setting.point(effect.side_in(setting))
        step, a = mechanics.sample_time, mechanics.a
        free = a + np.outer(point.force, stiffness * point.position + damping * point.velocity)
        pull = stiffness * point.position + contact * point.velocity
        turn = np.vstack([point.position, step * point.velocity, mechanics.c,
                          step * (mechanics.c @ a)])  # fmt: skip
        size = np.linalg.norm(turn, axis=1, keepdims=True)
        if not np.all(np.isfinite(turn)) or np.linalg.cond(turn / size) > 1e12:
            return None
        return cls(
            free,
            free - np.outer(point.force, pull),
            mechanics.b,
            sum((f * at.force for at, f in mechanics.bias), np.zeros(mechanics.order)),
            point.force * stiffness,
            mechanics.c,
            point,
            mechanics.hung,
            turn,
            gap,
            stiffness,
            contact,
            float(np.sqrt(stiffness * point.mobility)),
            at(dry),
            dry,
            tuple((spec, at(spec).force) for spec in model.effects[:-1] if along(spec)),
            per,
            mechanics.delay,
            step,
        )

    def predict(self, trial: Trial, noise: Noise) -> tuple[Array, Array]:
        """(innovations (N,) in output units, their standard deviations (N,)) of one recording, from y
        and u as measured."""
        n = len(self.free)
        substeps = int(np.clip(np.ceil(self.resonance * self.sample_time / FINE), 1, MOST_SUBSTEPS))
        step = self.sample_time / substeps
        back = np.linalg.inv(self.turn)
        colour = np.exp(-2 * np.pi * np.array([noise.sensor_corner, noise.force_corner]) * step)
        moves, spread = np.zeros((2, n + 2, n + 2)), np.zeros((2, n + 2, n + 2))
        known = self._known(trial)
        drive, kick = np.zeros((2, len(trial), n + 2)), np.zeros(n + 2)
        rub, feel = np.zeros((2, n + 2)), np.zeros(n + 2)
        given = self.press, self.rubs.force, self.drive, self.load, *(f for _, f in self.driven)
        for m, a in enumerate((self.free, self.contact)):
            block = np.zeros((n + len(given), n + len(given)))
            block[:n, :n], block[:n, n:] = a, np.column_stack(given)
            held = scipy.linalg.expm(block * step)
            moves[m, :n, :n] = self.turn @ held[:n, :n] @ back
            kick[:n], rub[m, :n], *rest = (self.turn @ held[:n, n:]).T
            drive[m, :, :n] = known @ np.array(rest)
            moves[m, :n, n + 1] = rest[0]
            moves[m, n, n], moves[m, n + 1, n + 1] = colour
            spread[m, :n, :n] = noise.force**2 * substeps * np.outer(rest[0], rest[0])
            spread[m, n, n] += noise.sensor_coloured**2 * (1.0 - colour[0] ** 2)
            spread[m, n + 1, n + 1] += noise.force_coloured**2 * (1.0 - colour[1] ** 2)
        rows = np.zeros((3, n + 2))
        rows[0, :n], rows[0, n] = self.output @ back, 1.0
        rows[1, :n], rows[2, :n] = self.point.position @ back, self.point.velocity @ back
        feel[:n] = self.rubs.velocity @ back
        x, p = self._start(trial, noise)
        law = np.array([0.5 * self.gap, self.stiffness, self.damping, step])
        again = np.zeros((n + 2, n + 2))
        again[0, 0] = law[0] ** 2
        again[1, 1] = (law[0] * self.resonance * self.sample_time) ** 2
        return _filter(
            trial.y, drive, x, p, moves, kick, spread, rows, law, noise.sensor**2, again,
            (feel, rub, self._levels(trial)), substeps,
        )  # fmt: skip

    def _known(self, trial: Trial) -> Array:
        """(N, k) the forces that are known in every sample: the command as it arrives, constant loads, and
        those along the motion."""
        force = trial.u if trial.load is None else trial.u + trial.load
        if self.delay:
            force = np.concatenate([np.full(self.delay, force[0]), force[: -self.delay]])
        felt = forces_along(trial, [spec for spec, _ in self.driven])
        return np.column_stack([force, np.ones(len(trial)), *(f / self.per for f in felt)])

    def _levels(self, trial: Trial) -> Array:
        """(2, N) dry friction at most, moving up and down, input units: where y is, at its speed."""
        if self.friction is None:
            return np.zeros((2, len(trial)))
        at, *ways = levels(self.friction, self.per)
        level = np.stack([np.interp(trial.y, at, way) for way in ways])
        share, more, fall = ease(self.friction, self.per)
        speed = np.gradient(trial.y, trial.sample_time)
        return level + (share * level + more) * np.exp(-((speed / fall) ** 2))

    def _start(self, trial: Trial, noise: Noise) -> tuple[Array, Array]:
        """State at the first sample and its covariance: as the linear model has it, in doubt by the
        play, by what a rattle across it moves at, and by what the first sample is off: in the gap, or in
        a dead zone of the drive, a machine rests anywhere."""
        n = len(self.free)
        own = n - len(self.hung)
        known = np.vstack([np.eye(own), self.hung]) if len(self.hung) else np.eye(n)
        x, p = np.zeros(n + 2), np.zeros((n + 2, n + 2))
        x[:n] = self.turn @ known @ trial.start[:own]
        half = 0.5 * self.gap
        fast = 0.0 if trial.at_rest else self.resonance * self.sample_time * half
        p[:n, :n] = self.turn @ known @ trial.doubt[:own, :own] @ known.T @ self.turn.T
        off = trial.y[0] - x[2]
        p[:n, :n] += np.diag([half**2, fast**2, noise.sensor**2 + off**2, fast**2])
        p[n, n], p[n + 1, n + 1] = noise.sensor_coloured**2, noise.force_coloured**2
        return x, p

"""Dry friction predicted sample by sample: a Kalman filter that sticks and slips.

Noise that moves a machine as much as its command does smooths dry friction: where the speed is in doubt by
more than it is, the friction in the mean is a damping, and a simulation without noise, which knows its
speed, asks for half the level. The filter keeps state and doubt. Over a step, a sample or a part of one,
everything but the friction moves the speed at its point to v with standard deviation s; the friction takes
off what it can, up to what its level changes the speed by,

    v' = v - clip(v, -d-, d+),   d+- = level+- (what a unit of force there changes v by),

of which the moments are known for a Gaussian v (`clipped`). A contact that yields before it slides is a
spring of the plant whose stretch z is held within what the level makes of it, z' = clip(z, -d-, d+), in the
same way. So is a play of the measuring head: a machine moves the head once it has crossed the play, and

    y = x - z,   z' = clip(z + dx, -gap/2, gap/2),

is all that is seen of it. The innovations have the likelihood of `foretold`.

A step of a sample is wrong by what friction does while it turns within one, which a quiet sensor sees;
steps of parts match moments in each of them, as if the noise that is held over the sample were another in
every one. So parts are halved as long as that is likelier and leaves clearly less for noise (`finer`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from ffl.diagnose.contest.parallel import each
from ffl.diagnose.hypothesis.linear import corrected
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.predict.clipped import predicted
from ffl.diagnose.predict.company import along, forces_along, separable, without
from ffl.diagnose.predict.foretold import Foretold, refitted
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
PARTS, FINEST = (1, 2), 8  # of a sample, in which rigid friction is begun, and acts at most
QUIETER = 0.97  # of the noise that is left: more by finer parts is no reason for them
STIFF = 2.5  # what a contact turns by in a sample: one that is stiffer yields in none
DOUBLINGS = 10  # 1,024 samples, in which noise has made of the state what it may be in doubt by
SOFT = 1e-6  # of the fastest rate of a plant: a shift that changes slower changes nothing
STEP = 0.01  # of a logarithm, or of a number's scale, for derivatives


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
    play: float  # of the measuring head
    driven: tuple[tuple[EffectSpec, Array], ...]  # forces along the motion as measured, and where
    hung: Array
    per: float  # force per input
    delay: int
    sample_time: float

    @classmethod
    def of(cls, model: Model) -> Slipping | None:
        """None for a plant that no such filter describes (parts faster than any continuous system), or
        where something stands beside the friction that is neither `LINEAR` nor separable."""
        per = model.base.simulator.force_per_input
        mechanics = corrected(model.base.simulator.mechanics, dict(model.corrections))
        dry, play, driven = None, 0.0, []
        for spec in model.effects:
            setting = Setting(per, mechanics, spec.options)
            if spec.name in LINEAR:
                mechanics = EFFECTS[spec.name].modify(mechanics, spec.parameters, setting)
            elif spec.name in FORMS and dry is None:
                dry = spec
            elif of_the_head(spec):
                play = spec.parameters["gap"]
            elif along(spec):
                driven.append(spec)
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
        points = [
            Setting(per, mechanics, s.options).point(
                EFFECTS[s.name].side_in(Setting(per, mechanics, s.options))
            )
            for s in driven
        ]
        return cls(
            mechanics.a, mechanics.b, load, mechanics.c, point.force, point.position,
            point.velocity, table, eases, bristle, play,
            tuple((spec, at.force) for spec, at in zip(driven, points, strict=True)),
            mechanics.hung, per, mechanics.delay, mechanics.sample_time,
        )  # fmt: skip

    def predict(self, trial: Trial, noise: Noise, parts: int = 1) -> tuple[Array, Array, Array]:
        """(innovations (N,) in output units, their standard deviations (N,), logarithms of their scales) of
        one recording, from y and u as measured; rigid friction acts in so many `parts` of a sample."""
        n, step = len(self.a), self.sample_time
        stiffness = self.bristle
        if np.sqrt(stiffness * float(self.speed @ self.force)) * step > STIFF:
            stiffness = 0.0
        held = n + (stiffness > 0.0)  # the stretch of a contact is one state more,
        m = held + (self.play > 0.0)  # and that of a play
        given = np.column_stack([self.drive, self.load, self.force, *(f for _, f in self.driven)])
        block = np.zeros((m + given.shape[1],) * 2)
        block[:n, :n], block[:n, m:] = self.a, given
        alone = np.r_[:n, m]  # the plant, no contact holding it, and the command
        if held > n:
            block[:n, n], block[n, :n] = -stiffness * self.force, self.speed
        if m > held:
            block[held, :n], block[held, m:] = self.output @ self.a, self.output @ given
        rigid = scipy.linalg.expm(block[np.ix_(alone, alone)] * step)
        swing = _swing(rigid[:n, :n], rigid[:n, n])
        large = np.sqrt(np.diag(swing))
        if held > n:
            large = np.append(large, self.table[1:].max() / stiffness)
        if m > held:  # a play hangs on what is measured and moves nothing
            large = np.append(large, 0.5 * self.play)
        steps = STEPS if held > n else parts
        whole = scipy.linalg.expm(block * step / steps)
        move = whole[:m, :m] * large / large[:, None]
        pushes = whole[:m, m:].T / large
        # Noises of sensor and force that stay over a sample or longer are the last states.
        corners = np.array([noise.sensor_corner, noise.force_corner, np.inf])
        colour = np.exp(-2 * np.pi * corners * step)
        power = np.array([noise.sensor_coloured, noise.force_coloured, noise.force]) ** 2
        moves = np.eye(m + 3)
        moves[:m, :m], moves[:m, m + 1], moves[:m, m + 2] = move, pushes[0], pushes[0]
        rows = np.zeros((4, m + 3))
        rows[:3, :n] = np.stack([self.output, self.place, self.speed]) * large[:n]
        rows[0, m] = 1.0
        force = np.append(pushes[2], (0.0, 0.0, 0.0))
        if held > n:
            rows[3, n] = large[n]
            # Beyond its bounds the stretch has pushed as well, in the mean by half of its excess.
            per, at, kick = 1.0 / stiffness, rows[3], -0.5 * stiffness * force
            kick[n] += 1.0 / large[n]
        else:
            per, at = float(rows[2] @ force), rows[2]
            kick = force / per
        table = self.table * np.array([[1.0], [per], [per]])
        x, p = self._start(trial, power, large[:held], swing)
        again = np.zeros_like(p)
        if m > held:
            rows[0, held] = -large[held]
            x, p, again = self._in_play(x, p, held, large[:n])
        drive, lean = np.zeros((len(trial), m + 3)), np.zeros((0, m + 3))
        known = self._known(trial)
        drive[:, :m] = known @ pushes
        rate, rates = np.zeros(m + 3), np.zeros(len(trial))
        if m > held:
            stretch = block[held] * (step / steps / large[held])
            rate[:n], rates = stretch[:n] * large[:n], known @ stretch[m:]
        if m > held and self.driven:
            lean = np.zeros_like(drive)
            lean[:, :m] = self._leaning(trial) @ pushes[3:] * large[held]
        return predicted(
            trial.y, drive, lean, x, p, moves, colour, power * (1.0 - colour**2), steps, rows[0], rows[1],
            at, kick, table, np.array(self.ease) * np.array([1.0, per, 1.0]), held > n, held,
            float(m > held), again, noise.sensor**2, rate, rates,
        )  # fmt: skip

    def _known(self, trial: Trial) -> Array:
        """(N, k) the forces that are known in every sample: the command as it arrives, constant loads, none
        of the friction, and those along the motion."""
        sent = trial.u if trial.load is None else trial.u + trial.load
        if self.delay:
            sent = np.concatenate([np.full(self.delay, sent[0]), sent[: -self.delay]])
        still = np.ones(len(trial)), np.zeros(len(trial))
        felt = forces_along(trial, [spec for spec, _ in self.driven])
        return np.column_stack([sent, *still, *(f / self.per for f in felt)])

    def _leaning(self, trial: Trial) -> Array:
        """(N, k) by what the forces along the motion change with the way from the head to what moves it."""
        specs, half = [spec for spec, _ in self.driven], 0.5 * self.play
        sides = [forces_along(trial, specs, aside) for aside in (half, -half)]
        return np.column_stack(
            [(f - b) / (self.play * self.per) for f, b in zip(*sides, strict=True)]
        )

    def _start(self, trial: Trial, power: Array, large: Array, swing: Array) -> tuple[Array, Array]:
        """State at the first sample and its covariance: as the linear model has it, in doubt by what noise
        makes of it, and in motion by much more; a contact's stretch is anywhere within its bounds. What
        noise makes of a machine that no contact holds, for every form of a friction alike: a doubt that
        one makes smaller counts for it as if it foretold the first sample. `power`: variances of the
        noises."""
        n, m = len(self.a), len(large)
        own = n - len(self.hung)
        known = np.vstack([np.eye(own), self.hung]) if len(self.hung) else np.eye(n)
        known = known / large[:n, None]
        x, p = np.zeros(m + len(power)), np.zeros((m + len(power),) * 2)
        x[:n] = known @ trial.start[:own]
        p[:n, :n] = known @ trial.doubt[:own, :own] @ known.T
        unrest = (1.0 if trial.at_rest else UNKNOWN) ** 2 * power[1:].sum()
        p[:n, :n] += unrest * swing / np.outer(large[:n], large[:n])
        p[n:m, n:m] = np.eye(m - n) / 3.0
        p[m:, m:] = np.diag(power)
        return x, p

    def _in_play(self, x: Array, p: Array, at: int, large: Array) -> tuple[Array, Array, Array]:
        """(state, its covariance, what is added to that where the play is lost) with the stretch of a play
        as state `at`: anywhere within it, and the machine by as much elsewhere than where y is."""
        x, p = np.insert(x, at, 0.0), np.insert(np.insert(p, at, 0.0, axis=0), at, 0.0, axis=1)
        n = len(large)
        # Where the machine rests nearly as well: the shift of y by 1 that changes its motion least.
        a, c = self.a * large / large[:, None], self.output * large
        _, sizes, right = np.linalg.svd(a)
        weights = 1.0 / np.maximum(sizes, SOFT * sizes[0]) ** 2
        shift = right.T @ (weights * (right @ c))
        shift = 0.5 * self.play * shift / float(c @ shift)
        again = np.zeros_like(p)
        for together in (np.append(shift, 1.0), np.append(0.0 * shift, 0.3)):
            whole = np.zeros(len(x))
            whole[:n], whole[at] = together[:n], together[n]
            again += np.outer(whole, whole) / 3.0
        return x, p + again, again


def of_the_head(spec: EffectSpec) -> bool:
    """Whether it is a play between what moves and what measures it."""
    return spec.name == "backlash" and spec.options.get("kind") == "play"


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
    the linear part (`LINEAR`), or can be taken out of the recordings (`company`). `parts`: of a sample, in
    which rigid friction acts."""

    parts: int = 1

    @property
    def steps(self) -> Array:
        return np.array([STEP if c.log else STEP * c.scale for c in self.model.coordinates])

    def predict(self, trials):  # type: ignore[no-untyped-def]
        """See `Foretold.predict`."""
        others = [spec for spec in self.model.effects if separable(spec)]
        try:
            slipping = Slipping.of(self.model)
            if slipping is None:
                return None
            seen = [without(trial, others) if others else trial for trial in trials]
            parts = each(lambda trial: slipping.predict(trial, self.noise, self.parts), seen)
        except (InputError, np.linalg.LinAlgError):  # numbers that no machine has
            return None
        e, s, logs = (np.concatenate(part) for part in zip(*parts, strict=True))
        with np.errstate(all="ignore"):
            white = e / s
        good = np.all(np.isfinite(white)) and np.all(np.isfinite(logs))
        return (white, logs) if good else None

    def linearised(self, trials, found, factor, fixed=()):  # type: ignore[no-untyped-def]
        """By Fisher's scoring: w = e/s and (1 - w^2)/sqrt(2), with de/s and sqrt(2) d(log s), since what a
        friction holds is known better as well as elsewhere."""
        white = found[0] / factor
        moved, scales = self._changes(trials, found, fixed)
        table = np.vstack([moved / factor, np.sqrt(2.0) * scales])
        return np.concatenate([white, (1.0 - white**2) / np.sqrt(2.0)]), -table

    def columns(self, trials, white, fixed=()):  # type: ignore[no-untyped-def]
        """Derivatives of the prediction in units of its doubt, (N, p)."""
        found = self.predict(trials)
        return -self._changes(trials, found, fixed)[0]

    def _changes(self, trials, found, fixed):  # type: ignore[no-untyped-def]
        """(derivatives of e, in units of s, and of log s by theta)."""
        moved, scales = (np.zeros((len(found[0]), len(self.theta))) for _ in range(2))
        for k, step, there in self.stepped(trials, fixed):
            ratio = np.exp(there[1] - found[1])
            moved[:, k] = (there[0] * ratio - found[0]) / step
            scales[:, k] = (there[1] - found[1]) / step
        return moved, scales


def finer(found: Slip, trials: Sequence[Trial]) -> Slip:
    """`found` with its dry friction in as many parts of a sample as leave clearly less noise than half as
    many do, and are likelier, all else fitted again. (Stribeck friction in noise of 1 % of it: by halves
    of a sample 0.0034 m/s for 0.0025, by eighths 0.0028, the noise 0.83 times as loud. In noise as loud as
    the friction quarters were 150 likelier than halves, left as much, and had 0.86 of its level for
    0.92.)"""
    if not set(found.model.names) & set(FORMS):
        return found
    begun = found.parts
    while found.parts > 1:
        coarser = refitted(replace(found, parts=found.parts // 2), trials)
        if _quieter(found, coarser, trials):
            break
        found = coarser
    while begun <= found.parts < FINEST:  # coarser than it began, the next finer is tried already
        other = refitted(replace(found, parts=2 * found.parts), trials)
        if not _quieter(other, found, trials):
            break
        found = other
    return found


def _quieter(found: Slip, other: Slip, trials: Sequence[Trial]) -> bool:
    """Whether `found` leaves clearly less noise than `other`, and is the likelier."""
    less = found.scaled(trials)[1] < QUIETER * other.scaled(trials)[1]
    return less and found.worth(trials) > other.worth(trials)

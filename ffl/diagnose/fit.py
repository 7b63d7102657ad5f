"""Fitting a hypothesis: whitened output error by Levenberg and Marquardt, likelihood with noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ffl.diagnose.model import Coordinate, Model
from ffl.diagnose.noise import SLOWEST, Noise, fit_noise
from ffl.diagnose.parallel import each
from ffl.diagnose.stepping import aligned, damped, further_on, principal_steps
from ffl.diagnose.trials import Trial
from ffl.diagnose.triangle import lengths, triangle
from ffl.diagnose.whitening import Whitener
from ffl.machines.simulator import Simulation
from ffl.systems.loop import Loop
from ffl.systems.state_space import Array

if TYPE_CHECKING:
    from ffl.diagnose.doubt import Doubt

WORST = 1e30
LONG = 0.5  # of the longest calm stretch: noise is read from those at least as long
CALM = 0.2  # of all samples that these must hold
LEAST_DAMPING = 1e-10
STALE = 4  # rank-one updates on which small steps are no longer believed to be all there is
SLOW = 0.3  # of the sum of squares: a small step
ASTRAY = 0.25  # of a round: one simulation instead of one for every number
CLOSING = 0.7  # of the way to a goal that four rounds may leave
MISTAKEN = 5.0  # times what is believed of a number of the linear model (a mass to 3 %)
SWINGS = 4.0  # mean square of the whitened residual from which first orders may mislead
PATIENCE = 32  # rounds at most on the way to a goal
Key = tuple[str, str, int, tuple[str, int] | None]


class Runs(Protocol):
    """What can be simulated beside a recording, with numbers that are free."""

    @property
    def theta(self) -> Array: ...
    @property
    def coordinates(self) -> Sequence[Coordinate]: ...
    def at(self, theta: Array) -> Runs: ...
    def attempt(self, trial: Trial) -> Simulation | None: ...


@dataclass(frozen=True)
class Scene:
    """What every hypothesis is judged by: recordings, the loop that colours noise, the noise."""

    loop: Loop
    trials: tuple[Trial, ...]
    noise: Noise
    floor: float = 0.0
    free_clocks: bool = False  # the recordings' clocks overlap: their offsets are unknown
    worth: float = 1.0  # of a sample, in log-likelihood: less where what is left stays coloured
    plain: bool = False  # no filter of force noise describes what is left: taken as white at y
    loudest: Noise | None = None  # what white noise can be at most, where it is stated
    doubt: Doubt | None = None  # of recordings that judge: what the fitted ones left open
    slowest: float = SLOWEST  # Hz: lowest corner of coloured noise; what is slower is physics
    observed: bool = False  # an observer closes the loop: noise goes round it in no machine

    @cached_property
    def whiteners(self) -> tuple[Whitener, ...]:
        shared: Whitener | None = None
        out = []
        for trial in self.trials:
            if not trial.doubt.any():
                shared = shared or Whitener.of(self.loop, self.noise)
                out.append(shared)
            else:
                out.append(Whitener.of(self.loop, self.noise, trial.doubt))
        return tuple(out)

    @cached_property
    def log_scale(self) -> float:
        unrest = sum(float(np.log(t.unrest).sum()) for t in self.trials if t.unrest is not None)
        return unrest + sum(
            w.log_scale(len(t)) for w, t in zip(self.whiteners, self.trials, strict=True)
        )

    @property
    def samples(self) -> int:
        return sum(len(t) for t in self.trials)

    def like(self, other: Scene) -> Scene:
        """The scene whitened as `other` is."""
        return replace(self, loop=other.loop, noise=other.noise)

    def head(self, rows: int) -> Scene:
        """The first `rows` samples of the first recording alone."""
        out = replace(self, trials=(self.trials[0].head(rows),))
        object.__setattr__(out, "whiteners", self.whiteners[:1])
        return out

    def residuals(self, model: Runs) -> list[Array] | None:
        """y - yhat of each recording; None where the simulation leaves all bounds."""
        out = []
        for trial in self.trials:
            y = model.output(trial)
            if y is None:
                return None
            out.append(trial.y - y)
        return out

    def cost(self, model: Model) -> float:
        """Sum of squares of the whitened residual; infinite where the simulation leaves all bounds."""
        residuals = self.residuals(model)
        if residuals is None:
            return np.inf
        white = self.whiten(residuals)
        return float(white @ white)

    def whiten(self, residuals: Sequence[Array]) -> Array:
        entries = zip(self.trials, self.whiteners, residuals, strict=True)
        return np.concatenate([trial.weighed(whitener(e)) for trial, whitener, e in entries])

    def judge(self, residuals: Sequence[Array], known: Array | None = None) -> Array:
        """Whitened residuals of recordings that judge, corrections granted what is open of them."""
        white = self.whiten(residuals)
        return white if self.doubt is None else self.doubt.settled(self, white, known)

    def whiten_stacked(self, columns: Array) -> Array:
        """Columns (N, k) over all recordings, whitened together: many at once cost little more
        than one."""
        cuts = np.cumsum([len(t) for t in self.trials])[:-1]
        return self.whiten(np.split(columns, cuts))

    def with_noise_of(
        self, residuals: Sequence[Array], coloured: bool = True, quantile: float | None = None
    ) -> Scene:
        """The scene with the noise that these residuals would be, were they all noise (`quantile`:
        a lower envelope, see `noise.spectrum`)."""
        if self.plain:
            size = float(np.sqrt(np.mean(np.concatenate(residuals) ** 2)))
            return replace(
                self, noise=Noise(max(size, self.floor, 1e-300), 1e-6 * self.noise.force)
            )
        noise = fit_noise(
            self.loop,
            self._calm(residuals),
            self.noise,
            floor=self.floor,
            coloured=coloured,
            quantile=quantile,
            slowest=self.slowest,
        )
        if quantile is not None and self.loudest is not None:
            sensor, force = self.loudest.sensor, self.loudest.force
            noise = replace(noise, sensor=min(noise.sensor, sensor), force=min(noise.force, force))
        return replace(self, noise=noise)

    def _calm(self, residuals: Sequence[Array]) -> list[Array]:
        """The stretches of `residuals` in which the linear loop answers noise; where they are few, all,
        turned down by as much as they are loud."""
        if all(t.unrest is None for t in self.trials):
            return list(residuals)
        runs: list[Array] = []
        for trial, e in zip(self.trials, residuals, strict=True):
            loud = np.zeros(len(e), bool) if trial.unrest is None else trial.unrest > 1.0
            edges = np.flatnonzero(np.diff(loud)) + 1
            pieces = zip(np.split(e, edges), np.split(loud, edges), strict=True)
            runs += [run for run, own in pieces if not own[0]]
        longest = max(map(len, runs), default=0)
        runs = [run for run in runs if len(run) >= LONG * longest]
        if sum(map(len, runs)) > CALM * self.samples:
            return runs
        return [t.weighed(e) for t, e in zip(self.trials, residuals, strict=True)]

    def log_likelihood(self, white: Array) -> float:
        return self.worth * float(-0.5 * (white @ white) - self.log_scale)


@dataclass(frozen=True)
class Fit:
    """A hypothesis at its best point: whitened residual, its Jacobian, and the likelihood.

    `jacobian` (N, p) is of the whitened prediction, `columns` (N, p) of y itself, in units of theta.
    """

    model: Model
    white: Array
    jacobian: Array
    columns: Array
    status: str

    def known(
        self, kinds: Sequence[str] = ("correction", "given", "effect", "option")
    ) -> dict[Key, Array]:
        """The columns by what they belong to: near enough for the first step of another fit."""
        keys = [c.key for c in self.model.coordinates]
        return {key: self.columns[:, k] for k, key in enumerate(keys) if key[0] in kinds}

    @cached_property
    def freedom(self) -> int:
        """Numbers that the data see."""
        return int(np.sum(lengths(self.jacobian) > 0))

    @property
    def surprise(self) -> float:
        """-log of the prior density of the corrections, 0 at nominal."""
        return surprise(self.model)

    @property
    def cost(self) -> float:
        """Sum of squares of the whitened residual."""
        return float(self.white @ self.white)

    @property
    def far(self) -> bool:
        """So far from what was measured that first orders may mislead, and corrections stand for what is
        missing."""
        return self.cost > SWINGS * len(self.white)

    @property
    def loop(self) -> Loop:
        """What colours the noise."""
        return colouring(self.model, self.far)

    @cached_property
    def spread(self) -> Array:
        """Standard deviation of theta; infinite where the data see nothing."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @cached_property
    def covariance(self) -> Array:
        """(J'J)^-1 by SVD with directions below 1e-9 of the largest left infinite, those in which a run
        overflows among them."""
        j = self.jacobian
        if j.shape[1] == 0:
            return np.zeros((0, 0))
        j = np.where(np.isfinite(j).all(axis=0), j, 0.0)
        scale = np.maximum(lengths(j), 1e-150)  # its square must not vanish
        r, _ = triangle(j / scale, self.white)
        _, s, vt = np.linalg.svd(r)
        if not s[0] > 0.0:  # the data see nothing of any number
            return np.full((len(s), len(s)), np.inf)
        s = np.where(s < 1e-9 * s[0], 1e-9 * s[0], s)
        half = vt.T / s
        inflate = max(1.0, self.cost / max(len(self.white) - j.shape[1], 1))
        with np.errstate(over="ignore"):  # what the data do not see has no finite spread
            return inflate * (half @ half.T) / np.outer(scale, scale)


def colouring(model: Model, far: bool) -> Loop:
    """What colours the noise: the linear loop as it stands; as it was stated where that is `far` off, or
    has numbers that no engineer mistakes so much: they stand for what is missing."""
    numbers = zip(model.coordinates, model.theta, strict=True)
    bent = any(abs(at) > MISTAKEN * c.doubt for c, at in numbers if c.kind == "correction")
    return (replace(model, corrections={}) if far or bent else model).loop


def jacobian(
    scene: Scene,
    model: Runs,
    base: Sequence[Array],
    known: Mapping[Key, Array] | None = None,
    chosen: Sequence[int] | None = None,
) -> Array:
    """Columns d yhat / d theta by one-sided differences, (N, p), or the `chosen` of them; those
    `known` are taken from there."""
    theta = model.theta
    coordinates = model.coordinates
    known = known or {}

    def column(k: int) -> Array:
        c = coordinates[k]
        if c.key in known:
            return known[c.key]
        step = np.zeros(len(theta))
        step[k] = c.step if theta[k] + c.step <= c.upper else -c.step
        return _difference(scene, model, base, step) / step[k]

    columns = each(column, range(len(theta)) if chosen is None else chosen)
    return np.column_stack(columns) if columns else np.zeros((scene.samples, 0))


def jacobian_along(
    scene: Scene, model: Model, base: Sequence[Array], j: Array, white: Array
) -> Array:
    """The columns of `jacobian` by differences along the principal directions of the last one, `j`:
    what of them nearly cancels, where one number can undo what another does, is seen for itself."""
    steps = principal_steps(j, white, model.theta, model.coordinates)
    ends = each(lambda k: _difference(scene, model, base, steps[:, k]), range(len(steps)))
    return np.linalg.solve(steps.T, np.column_stack(ends).T).T


def _difference(scene: Scene, model: Runs, base: Sequence[Array], step: Array) -> Array:
    """What `step` adds to yhat, whose residuals at `model` are `base`; zero where it leaves all
    bounds."""
    residuals = scene.residuals(model.at(model.theta + step))
    if residuals is None:
        return np.zeros(scene.samples)
    return np.concatenate([a - b for a, b in zip(base, residuals, strict=True)])


def surprise(model: Model) -> float:
    """-log of the prior density of the corrections, 0 at nominal."""
    return float(np.sum(_surprise(model.theta, _doubts(model))))


def _doubts(model: Model) -> Array:
    return np.array([c.doubt for c in model.coordinates])


def _surprise(theta: Array, doubts: Array) -> Array:
    """-log of Student's density with two degrees of freedom: an engineer's numbers are right to a
    few per cent, and now and then quite wrong."""
    return 1.5 * np.log1p(0.5 * (theta / doubts) ** 2)


def fit(
    scene: Scene,
    model: Model,
    *,
    rounds: int = 12,
    tolerance: float = 0.02,
    known: Mapping[Key, Array] | None = None,
    goal: float | None = None,
) -> Fit:
    """Levenberg-Marquardt from `model`; stops where a step promises less than `tolerance` in the
    sum of squares (in units of the noise), or after so many `rounds`: a step that leads astray is one
    simulation and counts as a part of one. With a `goal`, a sum of squares that another hypothesis
    reaches, it goes on as long as it closes in on that. Broyden's rank-one update spares differences
    while the steps do what they promise; columns `known` from elsewhere spare the first of them. After
    that differences follow the principal directions of the columns before (`jacobian_along`), and two
    poor steps that go the same way are gone on with as long as that helps (`further_on`). The
    corrections of the linear model pay for leaving their nominal values (`Coordinate.doubt`).
    """
    theta = model.theta
    residuals = scene.residuals(model)
    if residuals is None:
        white = np.full(scene.samples, np.sqrt(WORST / scene.samples))
        empty = np.zeros((scene.samples, len(theta)))
        return Fit(model, white, empty, empty, "diverged")
    white = scene.whiten(residuals)
    if not len(theta):
        empty = np.zeros((len(white), 0))
        return Fit(model, white, empty, empty, "converged")
    doubts = _doubts(model)
    units = np.array([c.scale for c in model.coordinates])

    def cost_of(white: Array, theta: Array) -> float:
        return float(white @ white) + 2.0 * float(np.sum(_surprise(theta, doubts)))

    columns = jacobian(scene, model, residuals, known)
    j = scene.whiten_stacked(columns)
    fresh, damping, status = not known, 1e-4, "rounds"
    factors, way = None, np.zeros(len(theta))
    lower = np.array([c.lower for c in model.coordinates])
    upper = np.array([c.upper for c in model.coordinates])
    spent, last, stale = 0.0, float(white @ white), 0
    while spent < rounds:
        if goal is not None and spent >= rounds - 1.0 and rounds < PATIENCE:
            cost = float(white @ white)
            if cost - goal > CLOSING * (last - goal):
                break
            rounds, last = rounds + 4, cost
        spent += 1.0
        pull = np.sqrt(3.0 / (2.0 + (theta / doubts) ** 2)) / doubts
        factors = factors or triangle(j, white)
        step, promised = damped(*factors, damping, theta, lower, upper, pull, units)
        if promised < tolerance:
            if fresh or promised < 0.1 * tolerance:
                status = "converged"
                break
            columns = jacobian_along(scene, model, residuals, j, white)
            j, fresh, factors = scene.whiten_stacked(columns), True, None
            continue
        trial_theta = np.clip(theta + step, lower, upper)
        candidate = model.at(trial_theta)
        tried = scene.residuals(candidate)
        gained = -np.inf
        if tried is not None:
            tried_white = scene.whiten(tried)
            gained = cost_of(white, theta) - cost_of(tried_white, trial_theta)
        if gained > 0:
            factors = None
            moved = trial_theta - theta
            ratio = gained / promised
            weighted = moved * lengths(j) ** 2
            secant = weighted / max(moved @ weighted, 1e-300)
            change = white - tried_white - j @ moved
            raw = np.concatenate(residuals) - np.concatenate(tried) - columns @ moved
            theta, model, residuals, white = trial_theta, candidate, tried, tried_white
            if ratio < 0.5 and aligned(moved, way, lengths(j)):
                now = cost_of(white, theta)
                beyond = further_on(scene, model, theta, moved, (lower, upper), now, cost_of)
                if beyond is not None:
                    theta, model, residuals, white = beyond
            way = moved
            damping = max(0.2 * damping, LEAST_DAMPING) if ratio > 0.5 else 2.0 * damping
            stale = 0 if fresh else stale + 1
            if ratio > 0.7 and not (stale >= STALE and gained < SLOW * (white @ white)):
                j, columns = j + np.outer(change, secant), columns + np.outer(raw, secant)
                fresh = False
            elif gained > tolerance:
                model, residuals, white = _resettled(scene, model, residuals, white)
                columns = jacobian_along(scene, model, residuals, j, white)
                j, fresh = scene.whiten_stacked(columns), True
        elif fresh:
            damping = max(damping * 10.0, 1e-3)
            spent -= 1.0 - ASTRAY
            if damping > 1e6:
                status = "stalled"
                break
        else:
            columns = jacobian_along(scene, model, residuals, j, white)
            j, fresh, factors = scene.whiten_stacked(columns), True, None
    return Fit(model, white, j, columns, status)


def _resettled(scene: Scene, model: Model, residuals: list[Array], white: Array):
    """The model with as many sub-steps as its numbers now ask for: they stay fixed in between, since
    a step in them would show as a step in the differences."""
    other = model.resettled()
    if other.substeps == model.substeps:
        return model, residuals, white
    again = scene.residuals(other)
    if again is None:
        return model, residuals, white
    return other, again, scene.whiten(again)

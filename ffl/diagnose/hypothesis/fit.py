"""Fitting a hypothesis: whitened output error by Levenberg and Marquardt, likelihood with noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ffl.diagnose.contest.parallel import each
from ffl.diagnose.contest.scene import Runs, Scene, is_far
from ffl.diagnose.hypothesis.coordinate import Coordinate
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.stepping import FEW, aligned, damped, further_on, principal_steps
from ffl.diagnose.hypothesis.triangle import lengths, triangle
from ffl.diagnose.noise.colour import colouring
from ffl.systems.loop import Loop
from ffl.systems.state_space import Array

WORST = 1e30
LEAST_DAMPING = 1e-10
SPREAD_EVENLY = float(np.sqrt(12.0))  # range over standard deviation
STALE = 4  # rank-one updates on which small steps are no longer believed to be all there is
SLOW = 0.3  # of the sum of squares: a small step
ASTRAY = 0.25  # of a round: one simulation instead of one for every number
CLOSING = 0.7  # of the way to a goal that four rounds may leave
PATIENCE = 32  # rounds at most on the way to a goal
Key = tuple[str, str, int, tuple[str, int] | None]


@dataclass(frozen=True, eq=False)
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

    def shared(self, other: Model) -> dict[Key, Array]:
        """The columns that serve `other` for its first step: of what it has too and what an effect more or
        less changes little, which is corrections, the plant file's own numbers, and levels at the same
        places of the same table, which are many."""
        mine, theirs = self.model.effects, other.effects

        def same(key: Key) -> bool:
            kind, name, at, place = key
            if kind != "effect" or place is None or at >= len(theirs):
                return kind in ("correction", "given")
            grids = (spec.parameters.get(name, {}).get("grid") for spec in (mine[at], theirs[at]))
            return mine[at].name == theirs[at].name and len({tuple(g or ()) for g in grids}) == 1

        return {key: column for key, column in self.known().items() if same(key)}

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
        """See `is_far`."""
        return is_far(self.cost, len(self.white))

    @property
    def loop(self) -> Loop:
        """What colours the noise."""
        return colouring(self.model, self.cost / max(len(self.white), 1))

    @cached_property
    def spread(self) -> Array:
        """Standard deviation of theta; infinite where the data see nothing."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def spread_of(self, name: str) -> float:
        """Standard error of a correction; 0 where it is held."""
        for c, spread in zip(self.model.coordinates, self.spread, strict=True):
            if c.key[:2] == ("correction", name):
                return float(spread)
        return 0.0

    @cached_property
    def root(self) -> tuple[Array, Array] | None:
        """(half (p, p), scale (p,)) with (J'J + P)^-1 = half half'/(scale scale'), by SVD; P: an option
        (how a mass is shared) is somewhere within its bounds, and what the data do not see of it may not
        pass for doubt of the other numbers. Directions below 1e-9 of the largest at that, those in which
        a run overflows among them. None where the data see nothing of any number."""
        j = np.where(np.isfinite(self.jacobian).all(axis=0), self.jacobian, 0.0)
        return root_of(j, self.white, np.array([_within(c) for c in self.model.coordinates]))

    @cached_property
    def covariance(self) -> Array:
        """(J'J)^-1 times the mean square of what is left, where that is above noise."""
        p = self.jacobian.shape[1]
        if self.root is None:
            return np.full((p, p), np.inf)
        half, scale = self.root
        inflate = max(1.0, self.cost / max(len(self.white) - p, 1))
        with np.errstate(over="ignore"):  # what the data do not see has no finite spread
            return inflate * (half @ half.T) / np.outer(scale, scale)


def root_of(j: Array, white: Array, within: Array) -> tuple[Array, Array] | None:
    """See `Fit.root`: of the columns `j` (N, p) of `white`, and how far `within` bounds each number is."""
    if j.shape[1] == 0:
        return None
    scale = np.maximum(np.hypot(lengths(j), within), 1e-150)  # its square must not vanish
    r, _ = triangle(j / scale, white)
    _, s, vt = np.linalg.svd(np.vstack([r, np.diag(within / scale)]))
    if not s[0] > 0.0:
        return None
    return vt.T / np.where(s < 1e-9 * s[0], 1e-9 * s[0], s), scale


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
    scene: Scene,
    model: Model,
    base: Sequence[Array],
    columns: Array,
    j: Array,
    white: Array,
    damping: float | None = None,
) -> Array:
    """The `columns` of `jacobian`, `j` when whitened, brought up to date by differences along their
    principal directions: what of them nearly cancels, where one number can undo what another does, is
    seen for itself. With a `damping`, of many directions only along those that the step with it takes:
    what moves the others is left as it was."""
    steps = principal_steps(j, white, model.theta, model.coordinates, damping)
    ends = each(lambda k: _difference(scene, model, base, steps[:, k]), range(steps.shape[1]))
    sizes = lengths(j)
    seen = np.isfinite(sizes) & (sizes > 0)
    # The directions are principal, so each is corrected by itself: steps' weighted is diagonal.
    weighted = steps * np.where(seen, sizes, 1.0)[:, None] ** 2
    known = np.where(seen, columns, 0.0)
    new = np.column_stack(ends) - known @ steps
    return known + new @ (weighted / np.sum(steps * weighted, axis=0)).T


def _difference(scene: Scene, model: Runs, base: Sequence[Array], step: Array) -> Array:
    """What `step` adds to yhat, whose residuals at `model` are `base`; zero where it leaves all
    bounds."""
    residuals = scene.residuals(model.at(model.theta + step))
    if residuals is None:
        return np.zeros(scene.samples)
    return np.concatenate([a - b for a, b in zip(base, residuals, strict=True)])


def _within(c: Coordinate) -> float:
    """1/standard deviation of an option that may be anywhere within its bounds; 0 of other numbers."""
    return SPREAD_EVENLY / (c.upper - c.lower) if c.kind == "option" else 0.0


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
    many, due = len(theta) > FEW, False
    while spent < rounds:
        if goal is not None and spent >= rounds - 1.0 and rounds < PATIENCE:
            cost = float(white @ white)
            if cost - goal > CLOSING * (last - goal):
                break
            rounds, last = rounds + 4, cost
        spent += 1.0
        if due:
            columns = jacobian_along(scene, model, residuals, columns, j, white, damping)
            j, fresh, due = scene.whiten_stacked(columns), True, False
        pull = np.sqrt(3.0 / (2.0 + (theta / doubts) ** 2)) / doubts
        factors = factors or triangle(j, white)
        step, promised = damped(*factors, damping, theta, lower, upper, pull, units)
        if promised < tolerance:
            if fresh or promised < 0.1 * tolerance:
                status = "converged"
                break
            columns = jacobian_along(scene, model, residuals, columns, j, white)
            j, fresh, factors = scene.whiten_stacked(columns), True, None
            continue
        trial_theta = np.clip(theta + step, lower, upper)
        candidate = model.at(trial_theta)
        tried = scene.residuals(candidate)
        gained = -np.inf
        if tried is not None:
            tried_white = scene.whiten(tried)
            gained = cost_of(white, theta) - cost_of(tried_white, trial_theta)
        if tried is not None and gained > 0:
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
            good = ratio > 0.7 and not (stale >= STALE and gained < SLOW * (white @ white))
            poor = not good and gained > tolerance
            if good or (poor and many):
                j, columns = j + np.outer(change, secant), columns + np.outer(raw, secant)
                fresh = False
            if poor:
                model, residuals, white = _resettled(scene, model, residuals, white)
                due = many  # where it costs much not after the last step, which has no use for it
            if poor and not many:
                columns = jacobian_along(scene, model, residuals, columns, j, white)
                j, fresh = scene.whiten_stacked(columns), True
        elif fresh:
            damping = max(damping * 10.0, 1e-3)
            spent -= 1.0 - ASTRAY
            if damping > 1e6:
                status = "stalled"
                break
        else:
            columns = jacobian_along(scene, model, residuals, columns, j, white, damping)
            j, fresh, factors = scene.whiten_stacked(columns), True, None
    return Fit(model, white, j, columns, status)


def _resettled(
    scene: Scene, model: Model, residuals: list[Array], white: Array
) -> tuple[Model, list[Array], Array]:
    """The model with as many sub-steps as its numbers now ask for: they stay fixed in between, since
    a step in them would show as a step in the differences."""
    other = model.resettled()
    if other.substeps == model.substeps:
        return model, residuals, white
    again = scene.residuals(other)
    if again is None:
        return model, residuals, white
    return other, again, scene.whiten(again)

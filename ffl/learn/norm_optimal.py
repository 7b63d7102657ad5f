"""The norm-optimal update of criterion (3), unconstrained in closed form or under bounds."""

from __future__ import annotations

import copy
import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from ffl.bases import Basis
from ffl.errors import InputError
from ffl.learn.constraints import Constraints, known_command
from ffl.learn.coordinates import Coordinates, orthonormal
from ffl.learn.weights import Weights, apply_weight, is_zero
from ffl.machines import linear_part
from ffl.systems import Plant
from ffl.systems.checked import checked
from ffl.systems.state_space import Array

ROUNDS = 60
ROWS_PER_ROUND = 40
NAMED = 3  # bounds that contradict each other, at most
SMALLEST = (
    1e-3  # of a quantity's peak: a violation is relative to its bound, or to this where smaller
)


@dataclass(frozen=True)
class UpdateReport:
    """How an update went.

    `status` is "optimal", "optimal_inaccurate" (`kkt_residual` above 1e-8), "settled" (of
    `AlongTrajectory`: the bounds hold, and one more round hardly lowers the criterion) or
    "infeasible" (then theta is the last one and `message` says which bounds conflict, and when).
    `kkt_residual` is that of the theta returned, relative, in the problem's own units (see
    `NormOptimal.kkt`), over the directions used: `rank` of them, those that the data see above 1e-10
    of the largest. `left_out` is the share by which the criterion lies above its minimum over all
    directions for that reason (NaN: not computed, as under bounds). `active` is the number of bounds
    that hold with equality.
    """

    seconds: float
    status: str
    kkt_residual: float
    rank: int
    active: int = 0
    message: str = ""
    left_out: float = float("nan")


@dataclass(frozen=True)
class Update:
    """Parameters and feedforward of the next trial."""

    theta: Array
    feedforward: Array
    report: UpdateReport


@dataclass(frozen=True)
class Rows:
    """One kind of bound: low <= matrix @ theta + offset <= high, row t at time t."""

    name: str
    matrix: Array
    offset: Array
    low: Array
    high: Array


class Answers(Protocol):
    """How y or u answers changes of f, to first order: SP or S, or a tangent."""

    def filter(self, feedforward: Array, /) -> Array: ...

    def filter_columns(self, feedforwards: Array, /) -> Array: ...


class NormOptimal:
    """theta_{j+1} = argmin |e_j - J (theta - theta_j)|^2_We + |Phi theta|^2_Wf + |Phi (theta -
    theta_j)|^2_Wdf, with Phi = psi(r) and J = SP Phi of the model (2018 printer paper, (2), (3)).

    Of a model with effects (an augmented.toml) it takes the linear part; `AlongTrajectory` solves
    this problem with the response about the simulated trajectory in its place.

    The matrices and their QR are made once; an update costs O(N n). `path` is "closed_form", "osqp"
    (the quadratic program of `ffl.learn.convex`) or "auto": closed form where there is no bound.
    """

    def __init__(
        self,
        model: Plant,
        basis: Basis,
        reference: ArrayLike,
        weights: Weights,
        constraints: Constraints | None = None,
        path: str = "auto",
    ) -> None:
        self.constraints = constraints or Constraints()
        self.weights, self.reference = weights, checked(reference, "reference")
        self.loop = linear_part(model).require_stable()
        self.sample_time = model.sample_time
        n = len(self.reference)
        weights.check_length(n)
        if path == "closed_form" and self.constraints.any:
            raise InputError("update = 'closed_form' has no bounds; use 'auto' or 'osqp'")
        self.path = path
        self.regressors = basis.regressors(self.reference)
        self.limits = {
            name: self.constraints.limits(name, basis.n_parameters if name == "parameters" else n)
            for name in Constraints.NAMES
            if getattr(self.constraints, name) is not None
        }
        self._respond(self.loop.process_sensitivity, self.loop.system.select([1], [1]))

    def _respond(self, output: Answers, command: Answers) -> None:
        """J = `output` Phi, and the QR of the problem with it."""
        self._answers, self.to_command = output, command
        self.response = output.filter_columns(self.regressors)
        blocks = [apply_weight(self.weights.error, self.response)]
        for weight in (self.weights.feedforward, self.weights.feedforward_change):
            if not is_zero(weight):
                blocks.append(apply_weight(weight, self.regressors))
        self.coordinates: Coordinates = orthonormal(np.vstack(blocks))

    def answering(self, output: Answers, command: Answers) -> NormOptimal:
        """The same problem where y and u answer f as these say, not as the model's loop does."""
        other = copy.copy(self)
        other._respond(output, command)
        return other

    def right_side(self, theta: Array, error: Array, before: Array) -> Array:
        """b of the least-squares problem |M theta - b|, stacked as M is."""
        target = error + self._answers.filter(self.regressors @ theta)
        parts = [apply_weight(self.weights.error, target)]
        if not is_zero(self.weights.feedforward):
            parts.append(np.zeros(len(error)))
        if not is_zero(self.weights.feedforward_change):
            parts.append(apply_weight(self.weights.feedforward_change, before))
        return np.concatenate(parts)

    def update(
        self,
        theta: Array,
        error: Array,
        command: Array | None = None,
        before: Array | None = None,
    ) -> Update:
        """The next parameters from trial j: its `theta` (n,), `error` e_j (N,) and `command` u_j.

        `before` (N,) is the feedforward from which W_df counts the change, where it is not that of
        `theta`.
        """
        start = time.perf_counter()
        theta = checked(theta, "theta", self.regressors.shape[1])
        error = checked(error, "error", len(self.reference))
        feedforward = self.regressors @ theta
        before = feedforward if before is None else before
        b = self.right_side(theta, error, before)
        c = self.coordinates.coordinates(b)
        if self.path == "osqp" or self.limits:
            return self._bounded(theta, feedforward, command, b, c, start)
        following = self.coordinates.theta(c)
        residual = self.kkt(following, b)
        report = UpdateReport(
            time.perf_counter() - start,
            self._status(residual, following, b),
            residual,
            self.coordinates.rank,
            left_out=self.coordinates.left_out(b),
        )
        return Update(following, self.regressors @ following, report)

    def _status(self, residual: float, theta: Array, b: Array) -> str:
        """ "optimal" up to 1e-8, or up to what parameters that cancel can carry in a double.

        FIR taps on a smooth reference reach 1e9 and cancel to 1: their rounding alone leaves a
        residual of eps sum |m_k theta_k| / |b|, 4e-8 in the test suite.
        """
        cancelling = float(self.coordinates.scale @ np.abs(theta)) / max(
            float(np.linalg.norm(b)), 1e-300
        )
        return "optimal" if residual <= max(1e-8, 4e-16 * cancelling) else "optimal_inaccurate"

    def kkt(
        self, theta: Array, b: Array, rows: Array | None = None, dual: Array | None = None
    ) -> float:
        """Stationarity in the problem's units: max_i |m_i^T (M theta - b) + (G^T dual)_i| over
        |m_i| |b|, the size each component's terms have before they cancel."""
        m = self.coordinates.matrix
        gradient = m.T @ (m @ theta - b)
        if rows is not None and dual is not None:
            gradient = gradient + rows.T @ dual
        size = self.coordinates.scale * max(float(np.linalg.norm(b)), 1e-300)
        return float(np.max(np.abs(gradient) / size))

    def excess(self, theta: Array, command: Array) -> float:
        """Largest violation of a bound by `theta` (n,) that comes with the command `command` (N,),
        relative to the bound; zero where all hold, infinite where something is not a number."""
        f = self.regressors @ theta
        values = {
            "feedforward": f,
            "feedforward_rate": np.diff(f, prepend=f[:1]) / self.sample_time,
            "command": command,
            "parameters": theta,
        }
        over = [np.max(_over(values[name], *limits)) for name, limits in self.limits.items()]
        largest = float(np.max(over, initial=0.0))
        return largest if np.isfinite(largest) else np.inf

    def _bounds(self, feedforward: Array, command: Array | None) -> list[Rows]:
        rows: list[Rows] = []
        n, t = len(self.reference), self.sample_time
        for name, (low, high) in self.limits.items():
            if name == "feedforward":
                rows.append(Rows(name, self.regressors, np.zeros(n), low, high))
            elif name == "feedforward_rate":
                rate = np.vstack(
                    [np.zeros(self.regressors.shape[1]), np.diff(self.regressors, axis=0)]
                )
                rows.append(Rows(name, rate / t, np.zeros(n), low, high))
            elif name == "command":
                matrix = self.to_command.filter_columns(self.regressors)
                offset = known_command(command) - self.to_command.filter(feedforward)
                rows.append(Rows(name, matrix, offset, low, high))
            else:
                eye = np.eye(self.regressors.shape[1])
                rows.append(Rows(name, eye, np.zeros(len(eye)), low, high))
        return rows

    def _bounded(
        self,
        theta: Array,
        feedforward: Array,
        command: Array | None,
        b: Array,
        c: Array,
        start: float,
    ) -> Update:
        """Row generation: solve, add the peaks of the violation, until every bound holds."""
        from ffl.learn.convex import conflict, least_violation, project

        blocks = self._bounds(feedforward, command)
        orthonormal_rows = [block.matrix @ self.coordinates.back for block in blocks]
        chosen: list[tuple[int, int, int]] = []  # block, time, side (+1 upper, -1 lower)
        g, h = np.zeros((0, len(c))), np.zeros(0)
        result = project(c, g, h)
        worst = 0.0
        for _ in range(ROUNDS):
            new, worst = _violated(blocks, orthonormal_rows, result.x, set(chosen))
            if not new:
                break
            chosen += new
            g = np.array([side * orthonormal_rows[k][t] for k, t, side in chosen])
            h = np.array([_bound(blocks[k], t, side) for k, t, side in chosen])
            result = project(c, g, h)
            if result.status == "infeasible":
                against = [chosen[row] for row in conflict(g, h)]
                excess = least_violation(c, g, h)
                message = _explain(blocks, against, excess, self.sample_time)
                report = UpdateReport(
                    time.perf_counter() - start,
                    "infeasible",
                    np.inf,
                    self.coordinates.rank,
                    0,
                    message,
                )
                return Update(theta.copy(), feedforward, report)
        following = self.coordinates.theta(result.x)
        matrix = np.array([side * blocks[k].matrix[t] for k, t, side in chosen]).reshape(
            -1, len(theta)
        )
        bound = np.array([_bound(blocks[k], t, side) for k, t, side in chosen])
        residual = self.kkt(following, b, matrix, result.multipliers)
        length = float(np.linalg.norm(b)) or 1.0
        if chosen:
            slack = matrix @ following - bound
            size = np.maximum(np.abs(bound), np.abs(matrix) @ np.abs(following) * 1e-8)
            residual = max(
                residual,
                float(np.max(slack / np.maximum(size, 1e-300), initial=0.0)),
                float(np.max(-result.multipliers * np.linalg.norm(g, axis=1), initial=0.0))
                / length,
                float(np.max(np.abs(result.multipliers * slack), initial=0.0)) / length**2,
                worst,
            )
        active = int(np.sum(result.multipliers > 0))
        report = UpdateReport(
            time.perf_counter() - start,
            self._status(residual, following, b),
            residual,
            self.coordinates.rank,
            active,
        )
        return Update(following, self.regressors @ following, report)


def _bound(block: Rows, t: int, side: int) -> float:
    return float(block.high[t] - block.offset[t] if side > 0 else block.offset[t] - block.low[t])


def _over(value: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """How far `value` lies above `high` and below `low`, relative to the bound (below zero: within)."""
    least = max(SMALLEST * float(np.abs(value).max(initial=0.0)), 1e-300)
    excesses = []
    for bound, excess in ((high, value - high), (low, low - value)):
        size = np.where(np.isfinite(bound), np.abs(bound), 1.0)  # an infinite one is never violated
        excesses.append(excess / np.maximum(size, least))
    return excesses[0], excesses[1]


def _violated(
    blocks: list[Rows], rows: list[Array], x: Array, known: set[tuple[int, int, int]]
) -> tuple[list[tuple[int, int, int]], float]:
    """Peaks of the violation that are not rows yet, the largest first, and the largest left over."""
    found: list[tuple[float, tuple[int, int, int]]] = []
    worst = 0.0
    for k, block in enumerate(blocks):
        value = rows[k] @ x + block.offset
        for side, relative in zip((1, -1), _over(value, block.low, block.high), strict=True):
            worst = max(worst, float(relative.max(initial=0.0)))
            over = relative > 1e-12
            if not over.any():
                continue
            padded = np.concatenate([[-np.inf], relative, [-np.inf]])
            peak = over & (relative >= padded[:-2]) & (relative >= padded[2:])
            found += [(relative[t], (k, int(t), side)) for t in np.nonzero(peak)[0]]
    fresh = [(size, row) for size, row in found if row not in known]
    fresh.sort(key=lambda item: -item[0])
    return [row for _, row in fresh[:ROWS_PER_ROUND]], worst


def _explain(
    blocks: list[Rows], against: list[tuple[int, int, int]], excess: float, sample_time: float
) -> str:
    """Which bounds contradict each other, and at what time: at most `NAMED` of them."""
    names = []
    for k, t, side in against[:NAMED]:
        block, which = blocks[k], "upper" if side > 0 else "lower"
        value = block.high[t] if side > 0 else block.low[t]
        where = f"parameter {t + 1}" if block.name == "parameters" else f"t = {t * sample_time:g} s"
        names.append(f"{which} bound {value:g} on {block.name} at {where}")
    if len(against) == 1:
        k, t, _ = against[0]
        why = (
            "it is left at 0, since nothing in this reference answers to it; take it out of the basis"
            if blocks[k].name == "parameters"
            else f"it is {blocks[k].offset[t]:g} there whatever they are, since the basis is at rest; "
            "widen the bound there, by one value per sample"
        )
        return f"no parameters meet the {names[0]}: {why}"
    more = f" and {len(against) - NAMED} more" if len(against) > NAMED else ""
    return (
        f"no parameters meet the bounds together: {' against '.join(names) or 'bounds contradict'}"
        f"{more}; every choice exceeds one of them by at least {excess:.3g}; widen one"
    )

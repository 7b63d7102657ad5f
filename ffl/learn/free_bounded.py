"""Norm-optimal update of the feedforward signal under bounds: an interior point in O(N) per step.

Every Newton step of a primal-dual method for a quadratic program is the same program without bounds
and with one more weight per bounded quantity and sample, so it is the Riccati recursion of
`ffl.learn.free_signal` once more: no matrix larger than the loop's order.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ffl.errors import InputError
from ffl.learn.constraints import Constraints, known_command
from ffl.learn.free_signal import FreeSignalUpdate, minimiser
from ffl.learn.norm_optimal import Update, UpdateReport
from ffl.learn.weights import Weights, as_filter
from ffl.systems import Plant
from ffl.systems.state_space import Array, StateSpace

ROUNDS = 80
TO_THE_WALL = 0.995  # of the step that would make a slack or a multiplier zero
GAP = 1e-13  # complementarity at which to stop, relative
FEASIBLE = 1e-9  # violation at which to stop, relative to the bound
OPTIMAL = 1e-8  # KKT residual that passes, relative
INFEASIBLE = 1e-6  # violation that stays, above which the bounds contradict each other
WORSE = 10.0  # times the best residual at which to stop


@dataclass(frozen=True)
class Bounded:
    """A quantity under bounds: `system` from the change of f to it, in units of `scale`; `low`,
    `high` (N,) in the same, infinite where free."""

    name: str
    system: StateSpace
    scale: float
    low: Array
    high: Array


@dataclass(frozen=True)
class Wall:
    """One side of the bounds on all quantities, side * value <= room: slack and multiplier (N, m)."""

    side: float
    room: Array
    slack: Array
    dual: Array

    @classmethod
    def of(cls, side: float, room: Array, value: Array, dual: float) -> Wall:
        """A start: slacks where the bounds hold, a tenth of the scale where they do not yet."""
        exists = np.isfinite(room)
        slack = np.where(exists, np.maximum(np.where(exists, room, 0.0) - side * value, 0.1), 1.0)
        return cls(side, room, slack, np.where(exists, dual, 0.0))

    @property
    def exists(self) -> Array:
        return np.isfinite(self.room)

    def violation(self, value: Array) -> Array:
        """side * value + slack - room, zero where there is no bound."""
        return np.where(self.exists, self.side * value + self.slack - self._finite(), 0.0)

    def pull(self, value: Array, aim: Array) -> tuple[Array, Array]:
        """(weight, weighted target) of the value's step in a Newton step towards slack * dual = aim."""
        weight = self.dual / self.slack
        over = np.maximum(self.dual, 1e-300)
        target = -self.slack - (aim - self.slack * self.dual) / over - self.violation(value)
        return weight, np.where(self.exists, self.side * weight * target, 0.0)

    def steps(self, value: Array, moved: Array, aim: Array) -> tuple[Array, Array]:
        """Steps of slack and multiplier that go with a step `moved` of the value."""
        slack = -self.violation(value) - self.side * moved
        dual = (aim - self.slack * self.dual - self.dual * slack) / self.slack
        return np.where(self.exists, slack, 0.0), np.where(self.exists, dual, 0.0)

    def after(self, length: float, steps: tuple[Array, Array]) -> Wall:
        slack, dual = steps
        return Wall(self.side, self.room, self.slack + length * slack, self.dual + length * dual)

    def _finite(self) -> Array:
        return np.where(self.exists, self.room, 0.0)


class BoundedFreeSignal(FreeSignalUpdate):
    """f_{j+1} = argmin of criterion (3) over the whole signal f with bounds on f, on its rate and on
    the command u_j + S (f - f_j) predicted from the model; units and forms as in `Constraints`.

    Where no bound is met the result is that of `FreeSignalUpdate` to the last bit. Mehrotra's
    predictor and corrector; two recursions per round, 10 to 25 rounds; the round with the least KKT
    residual is returned.
    """

    def __init__(
        self, model: Plant, reference: ArrayLike, weights: Weights, constraints: Constraints
    ) -> None:
        super().__init__(model, reference, weights)
        if constraints.parameters is not None:
            raise InputError(
                "constraints.parameters: basis kind 'free' has no parameters; bound feedforward"
            )
        self.rows = tuple(self._rows(model, constraints))
        systems = [row.system for row in self.rows]
        self.together = (
            scipy.linalg.block_diag(self.a, *[s.a for s in systems]),
            np.concatenate([self.b, *[s.b[:, 0] for s in systems]]),
            scipy.linalg.block_diag(self.c, *[s.c for s in systems]),
            np.concatenate([self.d, *[s.d[0] for s in systems]]),
        )

    def _rows(self, model: Plant, constraints: Constraints) -> Iterator[Bounded]:
        t = model.sample_time
        unit = as_filter(1.0, t)[0]
        rate = StateSpace(np.zeros((1, 1)), np.ones((1, 1)), -np.ones((1, 1)) / t, 1.0 / t, t)
        command = self.loop.system.select([1], [1])
        kinds = (("feedforward", unit), ("feedforward_rate", rate), ("command", command))
        for name, system in kinds:
            if getattr(constraints, name) is None:
                continue
            low, high = constraints.limits(name, self.n)
            if name == "feedforward_rate":  # there is no sample before the first
                low[0], high[0] = -np.inf, np.inf
            sizes = np.abs(np.concatenate([low, high]))
            scale = float(np.max(sizes[np.isfinite(sizes)], initial=0.0)) or 1.0
            scaled = StateSpace(system.a, system.b, system.c / scale, system.d / scale, t)
            yield Bounded(name, scaled, scale, low / scale, high / scale)

    def update(self, feedforward: Array, error: Array, command: Array | None = None) -> Update:
        """The next signal from trial j: its `feedforward` f_j, `error` e_j and `command` u_j."""
        start = time.perf_counter()
        offset = self._offset(feedforward, command)
        free = super().update(feedforward, error)
        change = free.feedforward - feedforward
        value = offset + self._values(change)
        low = np.column_stack([row.low for row in self.rows])
        high = np.column_stack([row.high for row in self.rows])
        size = max(self.size(error), 1e-300)
        if np.all(value <= high) and np.all(value >= low):
            return free
        # Multipliers are forces on f: as large as the pull of the error where they matter.
        dual = size / np.sqrt(self.n)
        walls = (Wall.of(1.0, high, value, dual), Wall.of(-1.0, -low, value, dual))
        bounds = sum(int(wall.exists.sum()) for wall in walls)
        criterion = np.broadcast_to(self.factors, (self.n, self.factors.shape[1]))
        best = np.inf, change, walls, value
        for _ in range(ROUNDS):
            left = self.left(feedforward, error, change)
            gap = sum(float(np.sum(w.slack * w.dual)) for w in walls)
            residual = self._kkt(feedforward, error, change, walls, value) / size
            if residual < best[0]:
                best = residual, change, walls, value
            elif best[0] <= OPTIMAL and residual > WORSE * best[0]:
                break  # slacks at rounding: further rounds lose what is there
            mu = gap / bounds
            worst = max(float(np.abs(w.violation(value)).max()) for w in walls)
            if worst < FEASIBLE and gap < GAP * size * dual * self.n:
                break
            aim = [np.zeros_like(w.slack) for w in walls]
            _, _, steps, length = self._newton(criterion, left, walls, value, aim)
            ahead = [w.after(length, s) for w, s in zip(walls, steps, strict=True)]
            centring = (sum(float(np.sum(w.slack * w.dual)) for w in ahead) / gap) ** 3
            aim = [np.where(w.exists, centring * mu - s[0] * s[1], 0.0)
                   for w, s in zip(walls, steps, strict=True)]  # fmt: skip
            moved, _, steps, length = self._newton(criterion, left, walls, value, aim)
            change = change + length * moved
            value = offset + self._values(change)
            pairs = zip(walls, steps, strict=True)
            walls = tuple(w.after(length, s) for w, s in pairs)  # type: ignore[assignment]
        left_over = max(float(np.abs(w.violation(value)).max()) for w in walls)
        residual, change = best[0], best[1]
        if residual > OPTIMAL and left_over > INFEASIBLE:
            return self._infeasible(start, feedforward, walls)
        walls = best[2]
        active = sum(int(np.sum(w.dual / size > w.slack)) for w in walls)
        return self._report(start, feedforward, change, residual, active)

    def _newton(self, criterion, left, walls, value, aims):  # type: ignore[no-untyped-def]
        """One Newton step towards slack * dual = aim: steps of f, of the values and of the walls,
        and the longest step that keeps slacks and multipliers positive."""
        pulls = [wall.pull(value, aim) for wall, aim in zip(walls, aims, strict=True)]
        weight = sum(p[0] for p in pulls)
        target = sum(p[1] for p in pulls) / np.maximum(weight, 1e-300)
        moved = minimiser(*self.together, np.hstack([criterion, weight]), np.hstack([left, target]))
        shift = self._values(moved)
        steps = [w.steps(value, shift, aim) for w, aim in zip(walls, aims, strict=True)]
        length = 1.0
        for wall, (slack, dual) in zip(walls, steps, strict=True):
            for now, step in ((wall.slack, slack), (wall.dual, dual)):
                shrinks = step < 0
                if shrinks.any():
                    wall_at = float(np.min(-now[shrinks] / step[shrinks]))
                    length = min(length, TO_THE_WALL * wall_at)
        return moved, shift, steps, length

    def _values(self, change: Array) -> Array:
        return np.column_stack([row.system.filter(change) for row in self.rows])

    def _offset(self, feedforward: Array, command: Array | None) -> Array:
        """The bounded quantities of trial j as it was, (N, m)."""
        columns = []
        for row in self.rows:
            if row.name != "command":
                columns.append(row.system.filter(feedforward))
            else:
                columns.append(known_command(command) / row.scale)
        return np.column_stack(columns)

    def _kkt(self, feedforward, error, change, walls, value) -> float:  # type: ignore[no-untyped-def]
        """Largest of stationarity (2-norm), violation and complementarity, in units of the gradient."""
        gradient = self.gradient(feedforward, error, change)
        for k, row in enumerate(self.rows):
            dual = sum(wall.side * wall.dual[:, k] for wall in walls)
            gradient = gradient + row.system.filter(dual[::-1])[::-1]
        size = max(self.size(error), 1e-300)
        over = max(float(np.max(w.side * value - w.room, initial=0.0)) for w in walls)
        products = np.sqrt(sum(float(np.sum((w.slack * w.dual) ** 2)) for w in walls))
        return max(float(np.linalg.norm(gradient)), over * size, float(products))

    def _report(self, start, feedforward, change, residual: float, active: int) -> Update:  # type: ignore[no-untyped-def]
        status = "optimal" if residual <= OPTIMAL else "optimal_inaccurate"
        seconds = time.perf_counter() - start
        following = feedforward + change
        return Update(following, following, UpdateReport(seconds, status, residual, self.n, active))

    def _infeasible(self, start: float, feedforward: Array, walls: Sequence[Wall]) -> Update:
        """The multipliers of bounds that contradict each other grow without end: those are named."""
        push = [np.abs(row.system.d[0, 0]) for row in self.rows]  # on f at the bound's own sample
        largest = max(float((wall.dual * push).max()) for wall in walls)
        found = []
        for wall in walls:
            for k, row in enumerate(self.rows):
                at = int(np.argmax(wall.dual[:, k]))
                share = float(wall.dual[at, k] * push[k]) / largest
                which = "upper" if wall.side > 0 else "lower"
                bound = wall.side * wall.room[at, k] * row.scale
                t = at * self.loop.system.sample_time
                if share > 1e-3:
                    found.append((share, f"{which} bound {bound:g} on {row.name} at t = {t:g} s"))
        names = " against ".join(name for _, name in sorted(found, reverse=True)[:3])
        message = f"no signal meets the bounds together: {names}; widen one"
        seconds = time.perf_counter() - start
        report = UpdateReport(seconds, "infeasible", np.inf, self.n, 0, message)
        return Update(feedforward, feedforward, report)

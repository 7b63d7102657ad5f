"""Norm-optimal update along the trajectory of a model with effects: convex step by step."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ffl.bases import Basis
from ffl.errors import InputError
from ffl.learn.constraints import Constraints
from ffl.learn.coordinates import orthonormal
from ffl.learn.norm_optimal import NormOptimal, Update
from ffl.learn.weights import Weights
from ffl.machines import Simulator
from ffl.systems import Plant
from ffl.systems.state_space import Array

ROUNDS = 6
PLANNED_ROUNDS = 15
PROBE = 1e-3  # of the larger of |f| and |u|: difference step; friction makes smaller ones noisy
SETTLED = 1e-3  # share of the criterion that a round must still bring
SHORTEST = 1e-3  # of a Newton step, below which the criterion does not fall along it


@dataclass(frozen=True)
class Tangent:
    """How y answers changes of f about one trajectory: `columns` (N, k) along the orthonormal `q`
    (N, k). In the place of a process sensitivity for feedforwards in the span of q."""

    q: Array
    columns: Array

    def filter(self, feedforward: Array) -> Array:
        return self.columns @ (self.q.T @ feedforward)

    def filter_columns(self, feedforwards: Array) -> Array:
        return self.columns @ (self.q.T @ feedforwards)


@dataclass(frozen=True)
class _Point:
    """Parameters, and what the model with the trial's remainder foretells for them."""

    theta: Array
    error: Array
    command: Array
    cost: float


class AlongTrajectory:
    """argmin over theta of |r - y(Phi theta) - d_j|^2_We + |Phi theta|^2_Wf + |Phi (theta -
    theta_j)|^2_Wdf with y(f) the simulated closed loop of `model`, effects and command limit
    included, and d_j = y_j - y(f_j) what of trial j the model does not say.

    Gauss-Newton: y is linearised about the trajectory of the current theta (differences along an
    orthonormal basis of Phi's columns, n simulations), the convex problem of `NormOptimal` is solved
    with that response, bounds included, and the step is halved until the criterion falls. A linear
    update does not see that the machine sticks, slips and is pulled about by its position; on ten
    printers with friction, cogging and cable force it stalls where this goes on to the noise
    (reports/missing_physics.md).

    Cost: rounds * n simulations of N samples.
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
        self.reference = np.asarray(reference, float)
        self._problem = NormOptimal(model, basis, self.reference, weights, constraints, path)
        self.regressors, self.weights = self._problem.regressors, weights
        self._q = orthonormal(self.regressors).q
        self._model, self._simulator = model, Simulator(model)

    def output(self, feedforward: Array) -> Array:
        """Noise-free y of the model with `feedforward` (N,), NaN from where it diverges."""
        return self._run(feedforward)[0]

    def update(self, theta: Array, error: Array, command: Array | None = None) -> Update:
        """The next parameters from trial j: its `theta` (n,), `error` e_j (N,) and `command` u_j."""
        y, u = self._run(self.regressors @ theta)
        if not np.all(np.isfinite(y)):
            raise InputError(
                f"update = 'trajectory': model '{self._model.name}' with its effects diverges on the "
                "feedforward of the last trial; use 'closed_form', which takes its linear part"
            )
        unsaid = (self.reference - error - y, np.zeros_like(u) if command is None else command - u)
        return self._descend(theta, unsaid, ROUNDS)

    def plan(self, theta: Array) -> Update:
        """Parameters that the model alone asks for, from `theta` (n,) on: the update where the
        machine is the model, repeated."""
        nothing = np.zeros(len(self.reference))
        return self._descend(theta, (nothing, nothing), PLANNED_ROUNDS)

    def predicted(self, theta: Array, error: Array, following: Array) -> Array:
        """r - y (N,) that the model foretells for parameters `following` after a trial with `theta`
        and `error`; without noise."""
        said = self.output(self.regressors @ following) - self.output(self.regressors @ theta)
        return error - said

    def _run(self, feedforward: Array) -> tuple[Array, Array]:
        run = self._simulator.run(
            self._model.effects,
            self.reference,
            feedforward,
            command_limit=self._model.machine.command_limit,
        )
        return run.y, run.u

    def _descend(self, theta: Array, unsaid: tuple[Array, Array], rounds: int) -> Update:
        """Gauss-Newton from `theta`; `unsaid`: what y and u hold beside the model's."""
        start = time.perf_counter()
        before = self.regressors @ theta
        here = self._at(theta, unsaid, before)
        problem, report = self._problem, None
        for _ in range(rounds):
            problem = self._problem.answering(self._tangent(here, unsaid))
            step = problem.update(here.theta, here.error, here.command, before)
            report = step.report
            moved = (
                None if report.status == "infeasible" else self._halved(here, step, unsaid, before)
            )
            if moved is None:
                break
            gained = 1.0 - moved.cost / here.cost
            here = moved
            if gained < SETTLED:
                break
        assert report is not None
        report = replace(report, seconds=time.perf_counter() - start)
        return Update(here.theta, self.regressors @ here.theta, report)

    def _at(self, theta: Array, unsaid: tuple[Array, Array], before: Array) -> _Point:
        f = self.regressors @ theta
        y, u = self._run(f)
        error = self.reference - unsaid[0] - y
        sound = bool(np.all(np.isfinite(y)))
        cost = self.weights.cost(error, f, f - before) if sound else np.inf
        return _Point(theta, error, u + unsaid[1], cost)

    def _halved(
        self, here: _Point, step: Update, unsaid: tuple[Array, Array], before: Array
    ) -> _Point | None:
        """The first of the step, its half, its quarter, ... that lowers the criterion."""
        share = 1.0
        while share > SHORTEST:
            moved = self._at(here.theta + share * (step.theta - here.theta), unsaid, before)
            if moved.cost < here.cost:
                return moved
            share *= 0.5
        return None

    def _tangent(self, here: _Point, unsaid: tuple[Array, Array]) -> Tangent:
        f = self.regressors @ here.theta
        probe = PROBE * max(float(np.linalg.norm(f)), float(np.linalg.norm(here.command)))
        y = self.reference - unsaid[0] - here.error
        columns = [(self.output(f + probe * q) - y) / probe for q in self._q.T]
        return Tangent(self._q, np.column_stack(columns))

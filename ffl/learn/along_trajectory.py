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
from ffl.learn.foretold import run_on
from ffl.learn.norm_optimal import NormOptimal, Update, UpdateReport
from ffl.learn.weights import Weights
from ffl.machines import Simulator
from ffl.systems import Plant
from ffl.systems.state_space import Array

ROUNDS = 12
PLANNED_ROUNDS = 20
# Of the larger of |f| and |u|: difference steps, from the finest on. Friction makes smaller ones noisy;
# where a machine sticks a little earlier or later, the wider ones see past the kink.
PROBES = 1e-3, 1e-2, 5e-2
SETTLED = 1e-3  # share of the criterion that a round must still bring
SHORTEST = 1e-3  # of a Newton step, below which the criterion does not fall along it
HALVINGS = 10  # of the way from there to twice as far, where a bound lies between
BENDS = 5  # corrections of a step for the command's bend along it
ELSEWHERE = 3  # descents from elsewhere at most, each from what is better than the last one's end
CLEARLY = (
    0.8  # of the criterion where a descent ended: what is better elsewhere is more than noise makes
)
LONG = 0.2  # of the criterion where a descent began: what may have passed by something better
FEASIBLE = 1e-9  # violation of a bound that passes for none, relative to the bound


@dataclass(frozen=True)
class Tangent:
    """How y or u answers changes of f about one trajectory: `columns` (N, k) along the orthonormal
    `q` (N, k). In the place of SP or S for feedforwards in the span of q."""

    q: Array
    columns: Array

    def filter(self, feedforward: Array) -> Array:
        return self.columns @ (self.q.T @ feedforward)

    def filter_columns(self, feedforwards: Array) -> Array:
        return self.columns @ (self.q.T @ feedforwards)


@dataclass(frozen=True)
class _Point:
    """Parameters, and what the model with the trial's remainder foretells for them; `excess` is the
    largest violation of a bound there, relative to the bound."""

    theta: Array
    error: Array
    command: Array
    cost: float
    excess: float

    @property
    def feasible(self) -> bool:
        return self.excess <= FEASIBLE

    def better_than(self, other: _Point) -> bool:
        """Bounds first, then the criterion."""
        if self.feasible and other.feasible:
            return self.cost < other.cost
        return not other.feasible and self.excess < other.excess


@dataclass(frozen=True)
class _Trial:
    """What a descent starts from: f_j, and what y_j and u_j hold beside the model's."""

    before: Array
    unsaid: tuple[Array, Array]


class AlongTrajectory:
    """argmin over theta of |r - y(Phi theta) - d_j|^2_We + |Phi theta|^2_Wf + |Phi (theta -
    theta_j)|^2_Wdf with y(f) the simulated closed loop of `model`, effects and command limit
    included, and d_j = y_j - y(f_j) what of trial j the model does not say; under bounds, that on the
    command on u(Phi theta) + u_j - u(f_j).

    Gauss-Newton: y and u are linearised about the trajectory of the current theta (differences along
    an orthonormal basis of Phi's columns, n simulations), the convex problem of `NormOptimal` is
    solved with that response, bounds included, and the step is halved until the criterion falls and
    the bounds hold for what is simulated. From a theta that breaks them the violation falls first;
    where the command bends along the step, so that it leaves its bounds, the bend is taken into them
    and the step solved again. A linear update does not see that the machine sticks, slips and is
    pulled about by its position; on ten printers with friction, cogging and cable force it stalls
    where this goes on to the noise (reports/missing_physics.md).

    The report is that of the theta returned: its KKT residual is |M (theta* - theta)| / |b| with
    theta* the solution of the problem linearised about theta, zero where theta solves that itself.
    It is 1e-3 rather than 1e-8 where dry friction bends the criterion, and up to 0.06 where a bound on the
    command holds as well: status "settled", no step along a linearisation about theta, by fine or by wide
    differences, brings more. That is a minimum nearby, not always the least: of a stage with friction and
    four limits on its command a search without derivatives found 0 to 3 % less.

    Where a long descent has ended it goes on from what is clearly better elsewhere (`_elsewhere`).

    `lead` (M,): the reference of the samples before the first, from rest; f holds its first value there,
    and nothing of them is judged.
    Cost: rounds * n simulations of N + M samples, three times that in the last.
    """

    def __init__(
        self,
        model: Plant,
        basis: Basis,
        reference: ArrayLike,
        weights: Weights,
        constraints: Constraints | None = None,
        lead: ArrayLike = (),
    ) -> None:
        self.reference = np.asarray(reference, float)
        self._whole = np.concatenate([np.asarray(lead, float), self.reference])
        self._problem = NormOptimal(model, basis, self.reference, weights, constraints)
        self.regressors, self.weights = self._problem.regressors, weights
        self._stated = basis.stated
        self._q = orthonormal(self.regressors).q
        self._model, self._simulator = model, Simulator(model)
        self._about = b""  # the feedforward that the tangents known are about
        self._known: dict[float, tuple[Tangent, Tangent]] = {}  # by the difference step

    def output(self, feedforward: Array) -> Array:
        """Noise-free y of the model with `feedforward` (N,), NaN from where it diverges."""
        return self._run(feedforward)[0]

    def update(
        self,
        theta: Array,
        error: Array,
        command: Array | None = None,
        applied: Array | None = None,
        load: Array | None = None,
    ) -> Update:
        """The next parameters from trial j: its `theta` (n,), `error` e_j (N,) and `command` u_j; `applied`
        (N,) the feedforward that it ran with, where it is not that of `theta`, `load` (N,) what pushed
        beside the command in it alone."""
        y, u = self._run(self.regressors @ theta if applied is None else applied, load)
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

    def predicted(
        self,
        theta: Array,
        error: Array,
        following: Array,
        applied: Array | None = None,
        load: Array | None = None,
    ) -> Array:
        """r - y (N,) that the model foretells for parameters `following` after a trial with `theta`
        and `error`, `applied` and `load` as of `update`; without noise."""
        before = self._run(self.regressors @ theta if applied is None else applied, load)[0]
        return error - (self.output(self.regressors @ following) - before)

    def _run(self, feedforward: Array, load: Array | None = None) -> tuple[Array, Array]:
        run = run_on(self._simulator, self._model, self._whole, feedforward, load)
        lead = len(self._whole) - len(self.reference)
        return run.y[lead:], run.u[lead:]

    def _descend(self, theta: Array, unsaid: tuple[Array, Array], rounds: int) -> Update:
        """Gauss-Newton from `theta`; `unsaid`: what y and u hold beside the model's."""
        start = time.perf_counter()
        trial = _Trial(self.regressors @ theta, unsaid)
        begun = self._at(theta, trial)
        here, status = self._down(begun, trial, rounds)
        # From where an update has ended the next one has a short way: what holds it there was looked for.
        long = not np.any(theta) or _clearer(here, begun, LONG)
        for _ in range(ELSEWHERE if long else 0):
            there = self._elsewhere(begun, here, trial)
            if there is here:
                break
            here, status = self._down(there, trial, rounds)
        problem, step = self._linearised(here, trial)
        seconds = time.perf_counter() - start
        if not here.feasible:
            return Update(theta.copy(), trial.before, self._infeasible(here, step, seconds))
        b = problem.right_side(here.theta, here.error, trial.before)
        away = problem.coordinates.matrix @ (step.theta - here.theta)
        residual = max(
            step.report.kkt_residual,
            float(np.linalg.norm(away)) / max(float(np.linalg.norm(b)), 1e-300),
            here.excess,
        )
        status = "optimal" if residual <= 1e-8 else status
        report = replace(step.report, seconds=seconds, status=status, kkt_residual=residual)
        return Update(here.theta, self.regressors @ here.theta, report)

    def _down(self, here: _Point, trial: _Trial, rounds: int) -> tuple[_Point, str]:
        """(Where Gauss-Newton comes to from `here`, whether it settled there.)"""
        for _ in range(rounds):
            before = here
            for probe in PROBES:
                problem, step = self._linearised(before, trial, probe)
                moved = self._moved(before, problem, step, trial)
                here = moved if moved is not None and moved.better_than(here) else here
                if not _settled(before, here):
                    break
            if _settled(before, here):
                return here, "settled"
        return here, "optimal_inaccurate"

    def _elsewhere(self, begun: _Point, here: _Point, trial: _Trial) -> _Point:
        """What is clearly better than `here`, where a descent ended: the linear part's answer to where it
        `begun`, what the effects' stated numbers come to in one step, or `here`
        without half of one parameter; else `here`. (Twice a friction stops the machine short at each
        reversal by as much as none does: a minimum, of 200 times the least criterion.)"""
        linear = self._problem.update(begun.theta, begun.error, begun.command, trial.before)
        starts = [] if linear.report.status == "infeasible" else [self._at(linear.theta, trial)]
        known = np.isfinite(self._stated)
        if known.any():
            there = self._at(np.where(known, self._stated, here.theta), trial)
            moved = self._moved(there, *self._linearised(there, trial), trial)
            starts += [there] if moved is None else [moved]
        starts += [self._at(here.theta - 0.5 * part, trial) for part in np.diag(here.theta)]
        best = here
        for point in starts:
            best = point if point.better_than(best) and _clearer(point, here) else best
        return best

    def _infeasible(self, here: _Point, step: Update, seconds: float) -> UpdateReport:
        message = step.report.message or (
            f"no parameters were found that meet the bounds on {' and '.join(self._problem.limits)} "
            "on the model with its effects: the nearest exceed one by "
            f"{100 * here.excess:.3g} % of it; widen it"
        )
        return replace(
            step.report,
            seconds=seconds,
            status="infeasible",
            kkt_residual=np.inf,
            active=0,
            message=message,
        )

    def _at(self, theta: Array, trial: _Trial) -> _Point:
        f = self.regressors @ theta
        y, u = self._run(f)
        error, command = self.reference - trial.unsaid[0] - y, u + trial.unsaid[1]
        sound = bool(np.all(np.isfinite(y)))
        cost = self.weights.cost(error, f, f - trial.before) if sound else np.inf
        excess = self._problem.excess(theta, command) if sound else np.inf
        return _Point(theta, error, command, cost, excess)

    def _moved(
        self, here: _Point, problem: NormOptimal, step: Update, trial: _Trial
    ) -> _Point | None:
        """The better of what is reached along the step with the command's bend taken into its bounds and
        along the step as it is: a bend that is large may turn the first uphill."""
        if step.report.status == "infeasible":
            return None
        bent = self._bent(here, problem, step, trial)
        steps = [step] if bent is step else [bent, step]
        reached = [p for s in steps if (p := self._along(here, s, trial)) is not None]
        best: _Point | None = None
        for point in reached:
            best = point if best is None or point.better_than(best) else best
        return best

    def _along(self, here: _Point, step: Update, trial: _Trial) -> _Point | None:
        """The first of the step, its half, its quarter, ... that is better, or what comes after it for as
        long as that is better still; from there up to a bound that twice as far would break."""

        def at(share: float) -> _Point:
            return self._at(here.theta + share * (step.theta - here.theta), trial)

        best, reached, beyond, share = None, 0.0, False, 1.0
        while share > SHORTEST:
            moved = at(share)
            if moved.better_than(best or here):
                best, reached = moved, share
            elif best is not None:
                break
            else:
                beyond = not moved.feasible
            share *= 0.5
        if best is None or not (beyond and best.feasible):
            return best
        more = reached
        for _ in range(HALVINGS):
            more *= 0.5
            moved = at(reached + more)
            if moved.better_than(best):
                best, reached = moved, reached + more
        return best

    def _bent(self, here: _Point, problem: NormOptimal, step: Update, trial: _Trial) -> Update:
        """The step with the command's bend along it, what its tangent leaves out, in its bounds."""
        if "command" not in problem.limits:
            return step
        for _ in range(BENDS):
            there = self._at(step.theta, trial)
            if there.feasible or not np.isfinite(there.excess):
                break
            moved = self.regressors @ (step.theta - here.theta)
            bend = there.command - here.command - problem.to_command.filter(moved)
            again = problem.update(here.theta, here.error, here.command + bend, trial.before)
            if again.report.status == "infeasible":
                break
            step = again
        return step

    def _linearised(
        self, here: _Point, trial: _Trial, probe: float = PROBES[0]
    ) -> tuple[NormOptimal, Update]:
        """The convex problem about the trajectory of `here`, and its solution. Without any command
        the linear part answers: there is no scale for a difference, and friction would hold it."""
        f = self.regressors @ here.theta
        problem, tangents = self._problem, self._tangents(f, probe)
        if tangents is not None:
            problem = problem.answering(*tangents)
        return problem, problem.update(here.theta, here.error, here.command, trial.before)

    def _tangents(self, f: Array, share: float) -> tuple[Tangent, Tangent] | None:
        """How y and u of the model answer about its trajectory under `f`, None without any command. Those
        of the last `f` are kept: a trial begins where the update before it ended."""
        about = f.tobytes()
        if about != self._about:
            self._about, self._known = about, {}
        if share in self._known:
            return self._known[share]
        y, u = self._run(f)
        probe = share * max(float(np.linalg.norm(f)), float(np.linalg.norm(u)))
        if probe == 0.0:
            return None
        runs = [self._run(f + probe * q) for q in self._q.T]
        output = Tangent(self._q, np.column_stack([(run[0] - y) / probe for run in runs]))
        command = Tangent(self._q, np.column_stack([(run[1] - u) / probe for run in runs]))
        self._known[share] = output, command
        return output, command


def _clearer(point: _Point, other: _Point, share: float = CLEARLY) -> bool:
    """Whether the criterion at `point` is below this `share` of what it is at `other`."""
    return not (other.feasible and point.feasible) or point.cost < share * other.cost


def _settled(before: _Point, here: _Point) -> bool:
    """Whether a round from `before` to `here` brought next to nothing."""
    return here is before or (before.feasible and 1.0 - here.cost / before.cost < SETTLED)

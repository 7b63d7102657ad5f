"""The one trial loop: run, measure the error, learn the next feedforward."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.random import Generator, SeedSequence

from ffl.bases import Basis, Combination, FreeSignal, SumBasis
from ffl.bases.base import UNSTATED
from ffl.errors import InputError
from ffl.learn.along_trajectory import AlongTrajectory
from ffl.learn.constraints import Constraints
from ffl.learn.free_bounded import BoundedFreeSignal
from ffl.learn.free_signal import FreeSignalUpdate
from ffl.learn.norm_optimal import NormOptimal, Update, UpdateReport
from ffl.learn.weights import Weights
from ffl.machines import is_linear
from ffl.recordings import Recording
from ffl.systems import Plant
from ffl.systems.state_space import Array

PATHS = ("auto", "closed_form", "osqp", "riccati", "trajectory")


class Machine(Protocol):
    """Whatever runs a trial, simulated or real."""

    def run(self, reference: Array, feedforward: Array, rng: Generator) -> Recording: ...


@dataclass(frozen=True)
class LearningTask:
    """What is to be learned: the model that learns and the machine that runs are two things."""

    model: Plant
    machine: Machine
    basis: Basis
    reference: Array
    weights: Weights
    constraints: Constraints = field(default_factory=Constraints)
    update: str = "auto"

    def updater(self) -> NormOptimal | AlongTrajectory | FreeSignalUpdate:
        """The update with its matrices made; raises `InputError` where the task is inconsistent.

        "auto": `AlongTrajectory` where the model has effects beyond its linear part, else
        `NormOptimal`, in closed form where there is no bound.
        """
        if self.update not in PATHS:
            raise InputError(f"update = '{self.update}': unknown; known: {', '.join(PATHS)}")
        require_sample_time(self.basis, self.model)
        free = isinstance(self.basis, FreeSignal)
        if free != (self.update == "riccati") and (self.update != "auto"):
            raise InputError(
                f"update = '{self.update}' does not fit: 'riccati' is for basis kind 'free', and "
                "that basis has no other"
            )
        if self.update == "trajectory" or (
            not free and self.update == "auto" and not is_linear(self.model)
        ):
            return AlongTrajectory(
                self.model, self.basis, self.reference, self.weights, self.constraints
            )
        if not free:
            return NormOptimal(
                self.model, self.basis, self.reference, self.weights, self.constraints, self.update
            )
        if self.constraints.any:
            return BoundedFreeSignal(self.model, self.reference, self.weights, self.constraints)
        return FreeSignalUpdate(self.model, self.reference, self.weights)


def require_sample_time(basis: Basis, model: Plant) -> None:
    """Raises `InputError` where a `basis` that counts in seconds was made for another sample time than the
    model's; one that counts in samples may leave it out."""
    for part in basis.parts if isinstance(basis, SumBasis) else (basis,):
        if isinstance(part, Combination):
            require_sample_time(part.basis, model)
        wanted = model.sample_time
        stated = getattr(part, "sample_time", wanted)  # a basis of one's own may have none
        if abs(stated / wanted - 1.0) > 1e-9 and not (part.in_samples and stated == UNSTATED):
            raise InputError(
                f"basis {type(part).__name__} has sample_time = {stated:g} s, model '{model.name}' "
                f"{wanted:g} s; make it with sample_time = {wanted:g}"
            )


@dataclass(frozen=True)
class Trial:
    """One trial: what was applied, what came back, and the update that had led to it.

    `error` = reference - measured output over all samples, `error_norm` its 2-norm (output units),
    `cost` criterion (3) with the change from the trial before (zero change for the first).
    """

    number: int
    recording: Recording
    theta: Array
    feedforward: Array
    error: Array
    cost: float
    update: UpdateReport | None

    @property
    def error_norm(self) -> float:
        return float(np.linalg.norm(self.error))

    @property
    def feedforward_norm(self) -> float:
        return float(np.linalg.norm(self.feedforward))


def trial_rng(seed: SeedSequence, number: int) -> Generator:
    """The noise of trial `number` depends on the run's seed and the number alone."""
    child = SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, number))
    return np.random.default_rng(child)


def learn(
    task: LearningTask, trials: int, seed: SeedSequence, after: Trial | None = None
) -> Iterator[Trial]:
    """Yields the trials one by one, `trials` in all; theta starts at zero (feedback only).

    `after` goes on from a trial already done, with the same numbers to the last bit as a loop that
    was never interrupted. Source: 2018 printer paper, sections II-C and IV.
    """
    if trials < 1 or int(trials) != trials:
        raise InputError(f"learn: trials = {trials}: give a whole number from 1 on")
    if not isinstance(seed, SeedSequence):
        raise InputError(
            f"learn: seed = {seed!r}: give a numpy SeedSequence, SeedSequence({seed!r})"
        )
    updater = task.updater()
    free = isinstance(updater, FreeSignalUpdate)
    n = len(task.reference)
    last = after
    for number in range(1 if after is None else after.number + 1, trials + 1):
        report: UpdateReport | None = None
        if last is None:
            theta = np.zeros(n if free else task.basis.n_parameters)
            feedforward = np.zeros(n)
            before = feedforward
        else:
            following: Update
            if isinstance(updater, FreeSignalUpdate):
                following = updater.update(last.feedforward, last.error, last.recording.u)
            else:
                following = updater.update(last.theta, last.error, last.recording.u)
            theta, feedforward, report = following.theta, following.feedforward, following.report
            before = last.feedforward
        recording = task.machine.run(task.reference, feedforward, trial_rng(seed, number))
        error = task.reference - recording.y
        cost = task.weights.cost(error, feedforward, feedforward - before)
        last = Trial(number, recording, theta, feedforward, error, cost, report)
        yield last

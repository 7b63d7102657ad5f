"""The circle closed: linear learning stalls, the missing physics is named, learning goes on.

A machine with effects that its model leaves out learns with a linear basis until it stalls. The
effects (found by a diagnosis of those trials, or given, as a bound of what a diagnosis can bring)
enter the model and the feedforward, and learning goes on from the stalled parameters, in two ways:

held     the compensation keeps the effects' own numbers, the linear basis alone goes on learning;
learned  the compensation's weights are learned with the rest, from those numbers on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator, SeedSequence

from ffl.bases import Basis, Compensation, SumBasis
from ffl.campaign.config import Campaign
from ffl.learn import LearningTask, Trial, learn, trial_rng
from ffl.learn.trial_loop import Machine
from ffl.machines import SimulatedMachine
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array

FRICTION, COGGING, CABLE = (0.10, 0.20), (0.03, 0.08), (0.02, 0.05)  # of the peak motor force
PITCH = 0.032  # m, pole pitch of a linear motor

Found = Callable[[Plant, Sequence[Recording]], tuple[EffectSpec, ...]]


@dataclass(frozen=True)
class Compensated:
    """A machine that adds a fixed feedforward to every trial's."""

    machine: Machine
    compensation: Array

    def run(self, reference: Array, feedforward: Array, rng: Generator) -> Recording:
        return self.machine.run(reference, feedforward + self.compensation, rng)


@dataclass(frozen=True)
class Way:
    """Error norms of one way of going on; `second` on the reference never learned; `promised` the
    norms of the same trials on the augmented model as machine."""

    norms: tuple[float, ...]
    second: float
    promised: tuple[float, ...]


@dataclass(frozen=True)
class Story:
    """One machine: its `true` effects, those `found`; error norms (2-norm, output units)."""

    seed: int
    true: tuple[EffectSpec, ...]
    found: tuple[EffectSpec, ...]
    linear: tuple[float, ...]
    linear_second: float
    feedback_second: float
    linear_promised: tuple[float, ...]
    held: Way
    learned: Way

    @property
    def stall(self) -> float:
        """Median of the last three linear trials: some machines do not settle but wander."""
        return last(self.linear)

    def drop(self, way: str) -> float:
        """1 - error after/stall."""
        return 1.0 - last(getattr(self, way).norms) / self.stall

    def extrapolation(self, way: str) -> float:
        """1 - error after/error with the stalled feedforward, on the second reference."""
        return 1.0 - float(getattr(self, way).second) / self.linear_second


def last(norms: Sequence[float]) -> float:
    return float(np.median(norms[-3:]))


def draw_effects(seed: int, peak_force: float, stroke: float) -> tuple[EffectSpec, ...]:
    """Coulomb friction and cogging at the motor, and a cable's pull over `stroke`, uniform in the
    shares of the peak motor force that real printers have."""
    rng = np.random.default_rng(seed)
    friction, cogging, cable = (peak_force * rng.uniform(*r) for r in (FRICTION, COGGING, CABLE))
    side = {"side": "motor"}
    phase = float(rng.uniform(-np.pi, np.pi))
    wave = {"amplitude": float(cogging), "period": PITCH, "phase": phase}
    return (
        EffectSpec("coulomb_friction", {"level": float(friction)}, side),
        EffectSpec("cogging", wave, side),
        EffectSpec("linear_stiffness", {"stiffness": float(cable / stroke)}, side),
    )


def story(
    campaign: Campaign,
    effects: tuple[EffectSpec, ...],
    seed: int = 0,
    found: Found | None = None,
    before: int = 8,
    after: int = 10,
) -> Story:
    """Linear learning with the campaign's first run for `before` trials, then `after` more with what
    `found` says of their recordings (None: the true effects, a bound)."""
    run, model = campaign.runs[0], campaign.model
    machine = SimulatedMachine(replace(campaign.machine, effects=effects))
    linear = LearningTask(
        model, machine, run.basis, campaign.reference, run.weights, run.constraints
    )
    noise = SeedSequence(campaign.seed, spawn_key=(seed,))
    trials = list(learn(linear, before, noise))
    named = effects if found is None else found(model, [t.recording for t in trials])
    augmented = replace(model, effects=named)
    # The promise of the augmented model: the same road with the model itself as the machine.
    imagined = SimulatedMachine(replace(augmented, machine=campaign.machine.machine))
    idealised = SimulatedMachine(replace(model, machine=campaign.machine.machine))
    imagined_trials = list(learn(replace(linear, machine=imagined), before, noise))
    basis = Compensation(augmented)
    second = campaign.second_reference
    assert second is not None
    ways = {}
    for held in (True, False):
        go = _held if held else _learned
        task, start, again = go(linear, augmented, basis, trials[-1], machine)
        there, first, _ = go(linear, augmented, basis, imagined_trials[-1], imagined)
        done = list(learn(task, before + after, noise, start))
        promised = list(learn(there, before + after, noise, first))
        after_second = machine.run(second, again(second, done[-1].theta), trial_rng(noise, 0))
        ways["held" if held else "learned"] = Way(
            _norms(done), float(np.linalg.norm(second - after_second.y)), _norms(promised)
        )
    spent = machine.run(
        second, run.basis.regressors(second) @ trials[-1].theta, trial_rng(noise, 0)
    )
    alone = machine.run(second, np.zeros(len(second)), trial_rng(noise, 0))
    return Story(
        seed,
        effects,
        named,
        _norms(trials),
        float(np.linalg.norm(second - spent.y)),
        float(np.linalg.norm(second - alone.y)),
        _norms(list(learn(replace(linear, machine=idealised), before, noise))),
        **ways,
    )


def _norms(trials: Sequence[Trial]) -> tuple[float, ...]:
    return tuple(trial.error_norm for trial in trials)


Again = Callable[[Array, Array], Array]


def _held(
    linear: LearningTask, model: Plant, basis: Compensation, stalled: Trial, machine: Machine
) -> tuple[LearningTask, Trial, Again]:
    force = basis.regressors(linear.reference) @ basis.theta
    task = replace(linear, model=model, machine=Compensated(machine, force))
    own: Basis = linear.basis

    def again(reference: Array, theta: Array) -> Array:
        return own.regressors(reference) @ theta + basis.regressors(reference) @ basis.theta

    return task, _without_experience(task, stalled, stalled.theta), again


def _learned(
    linear: LearningTask, model: Plant, basis: Compensation, stalled: Trial, machine: Machine
) -> tuple[LearningTask, Trial, Again]:
    both = SumBasis([linear.basis, basis])
    task = replace(linear, model=model, machine=machine, basis=both)

    def again(reference: Array, theta: Array) -> Array:
        return both.regressors(reference) @ theta

    theta = np.concatenate([stalled.theta, basis.theta])
    return task, _without_experience(task, stalled, theta), again


def _without_experience(task: LearningTask, stalled: Trial, theta: Array) -> Trial:
    """The stalled trial run once more with the compensation in it: what the first update of the new
    kind learns from. It counts as the trial it repeats."""
    feedforward = task.basis.regressors(task.reference) @ theta
    rng = np.random.default_rng(stalled.number)
    recording = task.machine.run(task.reference, feedforward, rng)
    error = task.reference - recording.y
    return replace(stalled, recording=recording, theta=theta, feedforward=feedforward, error=error)

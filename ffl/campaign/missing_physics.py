"""The circle closed: linear learning stalls, the missing physics is named, learning goes on.

A machine with effects that its model leaves out learns with a linear basis until it stalls. Its
slow scans, which the campaign's `[diagnosis]` asks for, are diagnosed (`diagnosed`; or the effects'
names and places are given, as a bound of what a diagnosis can bring). The augmented plant is
calibrated on the recordings, a feedforward is planned on it and run, and learning goes on along the
augmented model's trajectory. While a trial misses its promise, its recording calibrates once more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import SeedSequence

from ffl.bases import Compensation, SumBasis
from ffl.campaign.config import Campaign
from ffl.diagnose.contest.calibrate import Calibration, calibrate
from ffl.diagnose.contest.large import large_effects
from ffl.learn import AlongTrajectory, LearningTask, NormOptimal, learn, trial_rng
from ffl.machines import SimulatedMachine, linear_part
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array

FRICTION, COGGING, CABLE = (0.10, 0.20), (0.03, 0.08), (0.02, 0.05)  # of the peak motor force
PITCH = 0.032  # m, pole pitch of a linear motor
TEACHERS = (1, 3, 5, 8)  # linear trials that calibrate: far apart on the way to the stall
KEPT_PROMISE = 1.5  # times the promise: a trial above it calibrates the model once more
CALIBRATIONS = 4
SETTLED = 7  # last trials whose median is "after": about detents noise changes it by a half
COURSES = 48  # of learning on from the plan, each with its own noise: their median, to 2 or 3 %

Found = Callable[[Plant, Sequence[Recording], Sequence[Recording]], Plant]


@dataclass(frozen=True)
class Story:
    """One machine: its `true` effects, those `found`; error norms (2-norm, output units).

    `linear` the trials of linear learning, `linear_promised` the same where the machine is the
    linear model; `after` the trials with the physics in model and basis, `promised` what the
    calibrated model as machine (noise, encoder and command limit included) gives for the same
    number of trials; `second` the error with the last parameters on a reference never learned,
    `second_promised` the same on the model, `linear_second` with those of the stall. `again` and
    `promised_again` (courses, SETTLED): the last trials of courses from the plan on, each with its own
    noise, on the machine and on the model.
    """

    seed: int
    true: tuple[EffectSpec, ...]
    found: tuple[EffectSpec, ...]
    augmented: Plant
    calibrations: tuple[Calibration, ...]
    linear: tuple[float, ...]
    linear_promised: tuple[float, ...]
    linear_second: float
    after: tuple[float, ...]
    promised: tuple[float, ...]
    second: float
    second_promised: float
    again: Array
    promised_again: Array

    @property
    def stall(self) -> float:
        """Median of the last three linear trials: some machines do not settle but wander."""
        return last(self.linear)

    @property
    def drop(self) -> float:
        """1 - error after/stall."""
        return 1.0 - last(self.after, SETTLED) / self.stall

    @property
    def extrapolation(self) -> float:
        """1 - error after/error with the stalled feedforward, on the second reference."""
        return 1.0 - self.second / self.linear_second

    @property
    def promise_gap(self) -> float:
        """Machine's error norm over the promised one, less 1: medians over all courses."""
        return float(np.median(self.again) / np.median(self.promised_again)) - 1.0

    @property
    def promise_doubt(self) -> float:
        """Standard error of `promise_gap`, courses drawn with replacement."""
        rng = np.random.default_rng(0)
        ratios = [
            np.median(_drawn(self.again, rng)) / np.median(_drawn(self.promised_again, rng))
            for _ in range(400)
        ]
        return float(np.std(ratios))


def _drawn(table: Array, rng: np.random.Generator) -> Array:
    """Rows with replacement."""
    return table[rng.integers(len(table), size=len(table))]


def last(norms: Sequence[float], count: int = 3) -> float:
    return float(np.median(norms[-count:]))


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
    after: int = 9,
    courses: int = COURSES,
) -> Story:
    """Linear learning with the campaign's first run for `before` trials, then `after` more with what
    `found` makes of the recordings (model, fitted, held out: an augmented plant); None: names and
    places are given and the numbers a fifth off, the bound of what a diagnosis can bring. Learning on
    from the plan is run `courses` times more, on the machine and on the augmented model."""
    run, model = campaign.runs[0], campaign.model
    machine = SimulatedMachine(replace(campaign.machine, effects=effects))
    task = LearningTask(model, machine, run.basis, campaign.reference, run.weights)
    noise = SeedSequence(campaign.seed, spawn_key=(seed,))
    trials = list(learn(task, before, noise))
    idealised = SimulatedMachine(replace(model, machine=campaign.machine.machine))
    second = campaign.second_reference
    assert second is not None
    stalled = machine.run(second, run.basis.regressors(second) @ trials[-1].theta, _rng(noise, 0))
    scans, judges = (_scans(campaign, machine, noise, k) for k in (0, 1))
    told = replace(model, machine=campaign.machine.machine)
    named = found(told, scans, judges) if found else replace(told, effects=_given(effects, seed))
    teachers = [trials[k - 1].recording for k in TEACHERS if k <= before] + scans
    first = calibrate(named, scans or teachers).plant
    learned = _go_on(campaign, first, machine, teachers, noise, after)
    imagined = SimulatedMachine(learned.plant)
    promised = _trials(learned.update, learned.first, imagined, after, noise, 2**16)
    theta = learned.trials[-1][0]
    carried = learned.basis.regressors(second) @ theta
    return Story(
        seed,
        effects,
        named.effects,
        learned.plant,
        tuple(learned.calibrations),
        tuple(t.error_norm for t in trials),
        tuple(t.error_norm for t in learn(replace(task, machine=idealised), before, noise)),
        float(np.linalg.norm(second - stalled.y)),
        tuple(norm for _, norm in learned.trials),
        tuple(norm for _, norm in promised),
        float(np.linalg.norm(second - machine.run(second, carried, _rng(noise, 1)).y)),
        float(np.linalg.norm(second - imagined.run(second, carried, _rng(noise, 2)).y)),
        _again(learned, machine, after, courses, noise, 2**18),
        _again(learned, imagined, after, courses, noise, 2**19),
    )


def diagnosed(
    model: Plant, recordings: Sequence[Recording], held_out: Sequence[Recording]
) -> Plant:
    """The model with the effects that the diagnosis of large effects finds in recordings from rest."""
    return replace(model, effects=large_effects(model, recordings, held_out).plant.effects)


def _rng(noise: SeedSequence, number: int) -> np.random.Generator:
    return trial_rng(noise, 2**20 + number)


def _given(effects: tuple[EffectSpec, ...], seed: int) -> tuple[EffectSpec, ...]:
    """Levels a fifth off, periods by 1 %, phases by 0.2 rad (standard deviations)."""
    rng = np.random.default_rng([seed, 1])
    out = []
    for e in effects:
        numbers = {}
        for key, value in e.parameters.items():
            off = float(rng.standard_normal())
            width = 0.01 if key == "period" else 0.2
            numbers[key] = value + width * off if key == "phase" else value * np.exp(width * off)
        out.append(EffectSpec(e.name, numbers, e.options))
    return tuple(out)


def _scans(
    campaign: Campaign, machine: SimulatedMachine, noise: SeedSequence, kind: int
) -> list[Recording]:
    """The campaign's recordings for the diagnosis, with feedback only, so that they begin at rest:
    those to fit (kind 0) or to hold out (1)."""
    chosen = campaign.diagnosis[kind] if campaign.diagnosis else ()
    return [
        machine.run(r, np.zeros(len(r)), _rng(noise, 16 + 2 * k + kind))
        for k, r in enumerate(chosen)
    ]


@dataclass(frozen=True)
class _Learned:
    plant: Plant
    basis: SumBasis
    update: AlongTrajectory
    first: Array
    calibrations: list[Calibration]
    trials: list[tuple[Array, float]]


def _go_on(
    campaign: Campaign,
    augmented: Plant,
    machine: SimulatedMachine,
    teachers: list[Recording],
    noise: SeedSequence,
    count: int,
) -> _Learned:
    """Calibrate, plan, run; again while the trial misses its promise; then learn on."""
    done: list[tuple[Array, float]] = []
    calibrations: list[Calibration] = []
    while True:
        calibrations.append(calibrate(augmented, teachers))
        augmented = calibrations[-1].plant
        basis, update, theta = plan(campaign, augmented)
        imagined = _run(update, theta, SimulatedMachine(augmented), noise, 2**17 + len(done))
        recording, norm = _run(update, theta, machine, noise, 2**10 + len(done))
        done.append((theta, norm))
        kept = norm < KEPT_PROMISE * imagined[1]
        if kept or len(calibrations) == CALIBRATIONS or len(done) == count:
            break
        teachers = [*teachers, recording]
    rest = _trials(update, theta, machine, count - len(done), noise, 2**11, recording)
    return _Learned(augmented, basis, update, theta, calibrations, done + rest)


def plan(campaign: Campaign, augmented: Plant) -> tuple[SumBasis, AlongTrajectory, Array]:
    """Basis, update and the parameters that the augmented model asks for: from its linear part's
    own feedforward and the effects' numbers on, along its trajectory."""
    run = campaign.runs[0]
    compensation = Compensation(augmented)
    basis = SumBasis([run.basis, compensation])
    update = AlongTrajectory(augmented, basis, campaign.reference, run.weights)
    bare = linear_part(augmented)
    alone = NormOptimal(bare, run.basis, campaign.reference, run.weights)
    error = campaign.reference - bare.loop.reference_to_output.filter(campaign.reference)
    start = alone.update(np.zeros(run.basis.n_parameters), error).theta
    theta = update.plan(np.concatenate([start, compensation.stated])).theta
    return basis, update, theta


def _run(
    update: AlongTrajectory, theta: Array, machine: SimulatedMachine, noise: SeedSequence, key: int
) -> tuple[Recording, float]:
    r = update.reference
    recording = machine.run(r, update.regressors @ theta, trial_rng(noise, key))
    return recording, float(np.linalg.norm(r - recording.y))


def _trials(
    update: AlongTrajectory,
    theta: Array,
    machine: SimulatedMachine,
    count: int,
    noise: SeedSequence,
    key: int,
    after: Recording | None = None,
) -> list[tuple[Array, float]]:
    """Parameters and error norms of `count` trials from `theta` on, or from its recording."""
    out: list[tuple[Array, float]] = []
    recording = after
    for number in range(count):
        if recording is not None:
            theta = update.update(theta, update.reference - recording.y, recording.u).theta
        recording, norm = _run(update, theta, machine, noise, key + number)
        out.append((theta, norm))
    return out


def _again(
    learned: _Learned,
    machine: SimulatedMachine,
    count: int,
    courses: int,
    noise: SeedSequence,
    key: int,
) -> Array:
    """Error norms (courses, SETTLED) of the last of `count` trials from the plan on."""
    runs = [
        _trials(learned.update, learned.first, machine, count, noise, key + count * k)
        for k in range(courses)
    ]
    return np.array([[norm for _, norm in run[-SETTLED:]] for run in runs])

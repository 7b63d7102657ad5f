"""Where a recording began in motion: the plant's state at its first sample, under the model at hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from typing import Protocol, runtime_checkable

import numpy as np

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.whitening import Whitener
from ffl.diagnose.recorded.resting import Pull, at_speed, springs_back, winds
from ffl.diagnose.recorded.trials import Trial
from ffl.effects import EFFECTS
from ffl.effects.drift import SETTLES
from ffl.errors import InputError
from ffl.machines.simulator import Simulation
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

SECONDS = 1.0  # what the start still shows in
SETTLED = 30.0  # time constants after which a drift is over
PRIORS = (0.1, 1.0, 10.0)  # 1/doubts: a step that leads too far is tried shorter
MOST = 8  # steps: directions that the first second shows faintly come in slowly
TRAVELS = (-3.0, -1.0, -0.3, -0.1, 0.0, 0.1, 0.3, 1.0, 3.0)  # times the reach of a contact
NEAR = (0.55, 0.75, 1.35, 1.8)  # times the best of these
CLEARER = 4.0  # sum of squares by which another start at rest must be better
ADRIFT = 8.0  # sum of squares per state of the plant that a start in motion must take off
DONE = 0.1  # of the sum of squares in units of the noise: what one more step must bring


class Follows(Protocol):
    """What has a say in how a recording began: a model, or one with maps beside it."""

    @property
    def base(self) -> Base: ...
    @property
    def acting(self) -> tuple[EffectSpec, ...]: ...
    def follow(self, trial: Trial) -> Simulation: ...


@runtime_checkable
class Pulls(Protocol):
    """Who also pulls without a name, at standstill."""

    @property
    def pulls(self) -> tuple[Pull, ...]: ...


def _winds(model: Follows) -> bool:
    pulls = model.pulls if isinstance(model, Pulls) else ()
    return winds(model.base.simulator, model.acting, pulls)


def with_starts(scene: Scene, model: Follows, rounds: int = MOST) -> Scene:
    """The scene with the starts of recordings that begin in motion fitted under `model`, in at most
    `rounds` steps each, and those at rest with springs wound up or not, as they show it; the scene
    itself where no start is open, or the model is of no machine."""
    if not _open(scene, model):
        return scene
    trials = []
    try:
        for trial, whitener in zip(scene.trials, scene.whiteners, strict=True):
            trial = _taken_for_resting(model, trial)
            if trial.at_rest:
                trial = _adrift(model, _stood(model, trial, whitener), whitener)
            else:
                trial = _started(model, trial, whitener, rounds)
            trials.append(trial)
    except InputError:  # there is no such machine: no fit goes there either
        return scene
    if all(a is b for a, b in zip(trials, scene.trials, strict=True)):
        return scene
    return replace(scene, trials=tuple(trials))


def _started(model: Follows, trial: Trial, whitener: Whitener, rounds: int) -> Trial:
    for _ in range(rounds):
        trial, gained = _improved(model, trial, whitener)
        if gained < DONE:
            break
    return trial


def _adrift(model: Follows, trial: Trial, whitener: Whitener) -> Trial:
    """The trial, or as it begins in motion where its first second says so: nothing holds a machine with
    a dead zone or play where its reference stands still."""
    wound = _winds(model)
    if trial.adrift is None or (wound and not at_speed(trial.y)):
        return trial  # what winds springs up, or lets them go, is told apart by `_stood`
    start, doubt = trial.adrift
    other = trial.start, trial.doubt
    moving = replace(
        trial, start=start, doubt=doubt, at_rest=False, loaded=False, travel=0.0, adrift=other
    )
    moving = _started(model, moving, whitener, MOST)
    costs = [_cost(model, one.head(_begun(one)), whitener) for one in (trial, moving)]
    return moving if costs[1] < costs[0] - ADRIFT * model.base.simulator.n_plant else trial


def _taken_for_resting(model: Follows, trial: Trial) -> Trial:
    """The trial as it was read at rest, if it was: another model took it to move, and may be wrong."""
    if trial.at_rest or trial.adrift is None:
        return trial
    (start, doubt), other = trial.adrift, (trial.start, trial.doubt)
    wound = springs_back(model.base.simulator)
    return replace(
        trial, start=start, doubt=doubt, at_rest=True, loaded=wound, travel=0.0, adrift=other
    )


def _open(scene: Scene, model: Follows) -> bool:
    """Whether the model has a say in how a recording began."""
    if any(not trial.at_rest or trial.adrift is not None for trial in scene.trials):
        return True
    return _reach(model) > 0 or _winds(model)


def _stood(model: Follows, trial: Trial, whitener: Whitener) -> Trial:
    """The trial with springs and contacts wound up before the first sample, or let go there: what its
    first second says. A machine that came to rest after a move is the one, a simulation the other."""
    head = trial.head(_begun(trial))

    def cost(start: tuple[bool, float]) -> float:
        return _cost(model, replace(head, loaded=start[0], travel=start[1]), whitener)

    as_is = (trial.loaded, trial.travel)
    both = (False, True) if _winds(model) else (trial.loaded,)
    travels = [trial.travel, *(_reach(model) * share for share in TRAVELS)]
    starts = list(dict.fromkeys([as_is, *product(both, travels)]))
    costs = [cost(start) for start in starts]
    loaded, travel = starts[int(np.argmin(costs))]
    near = [(loaded, travel * factor) for factor in NEAR] if travel else []
    starts, costs = starts + near, costs + [cost(start) for start in near]
    best = int(np.argmin(costs))
    if not costs[best] < costs[0] - CLEARER:
        return trial
    return replace(trial, loaded=starts[best][0], travel=starts[best][1])


def _begun(trial: Trial) -> int:
    """Samples in which a start still shows."""
    return min(len(trial), max(200, round(SECONDS / trial.sample_time)))


def _cost(model: Follows, trial: Trial, whitener: Whitener) -> float:
    """Sum of squares that the trial leaves; infinite where the simulation leaves all bounds."""
    run = model.follow(trial)
    white = np.inf if run.diverged else trial.weighed(whitener(trial.y - run.y))
    return float(np.sum(white**2))


def _reach(model: Follows) -> float:
    return max((EFFECTS[s.name].reach(s.parameters) for s in model.acting), default=0.0)


def _recalled(model: Follows, trial: Trial) -> float:
    """How far from the first command the one before may have been where an open-loop drive still shows
    it, input units; 0 where none is remembered. (A controller's command moves little within a lag.)"""
    lags = any(EFFECTS[s.name].remembers_command for s in model.acting)
    shows = lags and model.base.plant.controller is None
    return float(np.sqrt(np.mean(trial.u**2))) if shows else 0.0


def _improved(model: Follows, trial: Trial, whitener: Whitener) -> tuple[Trial, float]:
    """One Gauss-Newton step on the plant's states, on the travel that its contacts remember and on the
    command that its drive does, with the doubt as prior, and what it takes off the sum of squares."""
    n = model.base.simulator.n_plant
    order = np.flatnonzero(np.diag(trial.doubt) > 0)
    at = [k for k in range(n) if k < len(trial.start)]
    spread = _spread(trial, model)
    whole, trial = trial, trial.head(_begun(trial))
    run = model.follow(trial)
    if run.diverged or not len(order):
        return whole, 0.0
    # Innovations of a filter that starts with doubt would hide the start: judge without it.
    sure = whitener.steady
    reach, command = _reach(model), _recalled(model, whole)
    beside = np.array([reach, command])[[reach > 0, command > 0]]
    size = len(at) + len(beside)

    def moved(trial: Trial, step: Array) -> Trial:
        start = trial.start.copy()
        start[at] += step[: len(at)] * spread[at]
        more = iter(beside * step[len(at) :])
        travel = trial.travel + float(next(more)) if reach > 0 else trial.travel
        held = trial.before + float(next(more)) if command > 0 else trial.held
        return replace(trial, start=start, travel=travel, held=held)

    columns = []
    for unit in np.eye(size):
        other = model.follow(moved(trial, 0.1 * unit))
        if other.diverged:
            return whole, 0.0
        columns.append((other.y - run.y) / 0.1)
    j = trial.weighed(sure(np.column_stack(columns)))
    e = trial.weighed(sure(trial.y - run.y))
    for prior in PRIORS:
        stacked = np.vstack([j, prior * np.eye(size)])
        step = np.linalg.lstsq(stacked, np.append(e, np.zeros(size)), rcond=None)[0]
        step[len(at) :] = np.clip(step[len(at) :], -1.0, 1.0)  # further on it bends
        after = model.follow(moved(trial, step))
        if after.diverged:
            continue
        gained = float(e @ e) - float(np.sum(trial.weighed(sure(trial.y - after.y)) ** 2))
        if gained > 0:
            return moved(whole, step), gained
    return whole, 0.0


def _spread(trial: Trial, model: Follows) -> np.ndarray:
    """Standard deviation of each state of the start, in the simulator's order."""
    values = np.sqrt(np.maximum(np.diag(trial.doubt), 0.0))
    n = model.base.simulator.n_states
    out = np.zeros(n)
    out[: min(n, len(values))] = values[:n]
    small = 1e-9 * max(float(np.abs(trial.start).max(initial=0.0)), 1e-12)
    return np.maximum(out, small)


def with_clocks(scene: Scene, model: Model, from_trial: int) -> Scene:
    """The scene with the unknown clock offsets of trials `from_trial` onwards fitted to the model's
    drift, of which each recording may show a later part, and to its periodic disturbance, whose phase in
    each recording is free, frequency and amplitude are not: half a period more or less is little of a
    settling. What the plant file states began at another time: then all trials are. As it is where there
    is no such machine."""
    if not scene.free_clocks:
        return scene
    names = {e.name for e in model.acting}
    if {"drift", "periodic_disturbance"} & {e.name for e in model.stated}:
        from_trial = 0
    try:
        if "drift" in names:
            scene = _warmed(scene, _without(model, "periodic_disturbance"), from_trial)
        if "periodic_disturbance" in names:
            scene = _in_phase(scene, model, from_trial)
    except InputError:  # a mass that leaves none at its point: no fit goes there either
        return scene
    return scene


def _without(model: Model, name: str) -> Model:
    """The model without the effect of that name, found or stated."""
    found, stated = (
        tuple(e for e in specs if e.name != name) for specs in (model.effects, model.stated)
    )
    return replace(model, effects=found, given=stated)


def _in_phase(scene: Scene, model: Model, from_trial: int) -> Scene:
    spec = next(e for e in model.acting if e.name == "periodic_disturbance")
    period = 1.0 / float(spec.parameters["frequency"])
    quiet = _without(model, spec.name)

    def shift(group: Sequence[tuple[Trial, Whitener]]) -> float:
        tables = []
        for trial, whitener in group:
            plain = quiet.follow(trial).y
            sine = model.follow(trial).y - plain
            quarter = replace(trial, start_time=trial.start_time + 0.25 * period)
            cosine = model.follow(quarter).y - plain
            tables.append(trial.weighed(whitener(np.column_stack([sine, cosine, trial.y - plain]))))
        table = np.concatenate(tables)
        if not np.all(np.isfinite(table)):
            return 0.0
        a, b = np.linalg.lstsq(table[:, :2], table[:, 2], rcond=None)[0]
        return float(np.arctan2(b, a) / (2 * np.pi)) * period

    return _shifted(scene, shift, from_trial)


def _shifted(
    scene: Scene, shift: Callable[[Sequence[tuple[Trial, Whitener]]], float], from_trial: int
) -> Scene:
    """With the clocks of recordings turned on by what `shift` says of all pieces of one; those of which a
    piece is before `from_trial` as they are."""
    groups: list[list[tuple[Trial, Whitener]]] = []
    for k, (trial, whitener) in enumerate(zip(scene.trials, scene.whiteners, strict=True)):
        if k and trial.goes_on:
            groups[-1].append((trial, whitener))
        else:
            groups.append([(trial, whitener)])
    trials: list[Trial] = []
    for group in groups:
        later = shift(group) if len(trials) >= from_trial else 0.0
        trials += [replace(t, start_time=t.start_time + later) if later else t for t, _ in group]
    return replace(scene, trials=tuple(trials))


def _warmed(scene: Scene, model: Model, from_trial: int) -> Scene:
    """With what is left of the settling, g in 1 - g exp(-t/T), 0 to 1, as each recording shows it: to
    first order y is linear in it, between a recording begun at t = 0 and one begun long after."""
    spec = next(e for e in model.acting if e.name == "drift")
    if spec.options.get("kind", SETTLES) != SETTLES:
        return scene
    settling = float(spec.parameters["time_constant"])

    def shift(group: Sequence[tuple[Trial, Whitener]]) -> float:
        first, tables = group[0][0].start_time, []
        for trial, whitener in group:
            late = model.follow(replace(trial, start_time=SETTLED * settling)).y
            early = model.follow(replace(trial, start_time=trial.start_time - first)).y
            tables.append(trial.weighed(whitener(np.column_stack([early - late, trial.y - late]))))
        table = np.concatenate(tables)
        if not np.all(np.isfinite(table)):
            return 0.0
        left = float(table[:, 0] @ table[:, 1]) / max(float(table[:, 0] @ table[:, 0]), 1e-300)
        left = min(max(left, np.exp(-SETTLED)), 1.0)
        return -settling * float(np.log(left)) - first

    return _shifted(scene, shift, from_trial)

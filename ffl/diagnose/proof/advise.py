"""Which experiment tells the survivors apart, or sharpens what was found: simulated before it is run.

Two rival hypotheses are run through every candidate experiment (`experiments`), scaled until the
command stays within what the recordings show. The separation is the whitened difference of their
outputs beyond what the rival's own numbers, as uncertain as the recordings leave them, can imitate:

    separation^2 = d' (I + J C J')^-1 d,    d = W (y_a - y_b),

J the derivatives of W y_b by its numbers and C their covariance. It is in standard deviations of the
noise; half its square is the log-likelihood ratio to be expected. An experiment that takes one of the two
far from where the machine has been seen is none: there neither knows anything.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from ffl.diagnose.contest.posterior import probabilities
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import Fit
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.maps.freemodel import FreeModel
from ffl.diagnose.maps.outcome import Contest
from ffl.diagnose.noise.whitening import Whitener
from ffl.diagnose.proof.experiments import (
    Design,
    Limits,
    closed_loop_designs,
    limits,
    open_loop_designs,
)
from ffl.diagnose.recorded.resting import rest_under
from ffl.diagnose.recorded.trials import Trial
from ffl.effects import EFFECTS
from ffl.machines.simulator import Simulation, Simulator
from ffl.systems.state_space import Array

ENOUGH = 5.0  # standard deviations that tell two hypotheses apart
SHRINKS = 6  # halvings of an experiment whose command leaves the range seen
ROOM = 1.05  # of the range of the command seen
DRIFTS = 1e-12  # of the largest singular value of a plant: the least of one that integrates
DOUBT = 0.03  # probability of a rival from which it is worth an experiment
MANY = 100.0  # times, or standard deviations: how much more nobody can foretell
SAME = 0.1  # standard deviations below which two hypotheses are one machine
REACH = 2.0  # of the ranges seen of y and u: a rival that an experiment takes further runs away
SHARPER = 1.1  # fold: an experiment that takes no more off a standard error is not worth its run
SHARP = 0.05  # relative standard error above which a parameter is worth an experiment
UNSEEN = 1e60  # spread that stands for infinite: of numbers that the data do not see at all


@dataclass(frozen=True)
class Experiment:
    """A reference file's content: t (s), r (output), f (input), each (N,); why it was chosen.

    `separation`: between the two `rivals`, in standard deviations of the noise; for a parameter the
    factor by which its standard error is to fall.
    """

    text: str
    t: Array
    r: Array
    f: Array
    rivals: tuple[str, str]
    separation: float
    tried: tuple[tuple[str, float], ...]

    @property
    def advice(self) -> str:
        a, b = self.rivals
        if not b:
            fold = f"{self.separation:.3g}-fold"
            if self.separation > MANY:  # as good as unknown until then
                fold = f"more than {MANY:.0f}-fold"
            return (
                f"to sharpen {a}: run {self.text} (experiment.csv); its standard error is expected to "
                f"fall {fold}"
            )
        if self.idle:
            return (
                f"{a} or {b}: with the numbers fitted here both make the same motion, within the noise, in "
                "every experiment within the range seen; either will do there"
            )
        if self.separation < 1.0:
            return (
                f"{a} or {b}: no experiment within the range seen tells them apart (the best, "
                f"{self.text}, by {self.separation:.2g} standard deviations); go beyond that range"
            )
        enough = "" if self.separation >= ENOUGH else f"; repeat it {self.repeats} times"
        apart = f"{self.separation:.3g}" if self.separation <= MANY else f"more than {MANY:.0f}"
        return (
            f"{a} or {b}: run {self.text} (experiment.csv); the two are expected to differ by "
            f"{apart} standard deviations of the noise{enough}"
        )

    @property
    def idle(self) -> bool:
        """It would tell nothing: what was fitted to the two rivals is one machine."""
        return bool(self.rivals[1]) and self.separation < SAME

    @property
    def repeats(self) -> int:
        """Runs that make the separation sure: it grows with their root."""
        return int(np.ceil((ENOUGH / self.separation) ** 2))


def separate(
    scene: Scene, one: Model | FreeModel, other: Fit, names: tuple[str, str]
) -> Experiment | None:
    """The experiment by which `one` and `other` differ most."""
    found: list[tuple[float, Design, Trial]] = []
    lim = limits(other.model, scene.trials)
    for design, trial in _designs(scene, other.model):
        pair = [_runs(each, trial, design) for each in (one, other.model)]
        if not all(run is not None and _near(run, lim) for run in pair):
            continue
        first, second = (run.y for run in pair if run is not None)
        whiten = Whitener.of(scene.loop, scene.noise)
        d = whiten(first - second)
        j = whiten(_slopes(other.model, trial, design, second))
        found.append((_beyond(d, j, other.covariance), design, trial))
    return _best(found, names)


def sharpen(scene: Scene, fit: Fit, index: int, name: str) -> Experiment | None:
    """The experiment that shrinks the standard error of coordinate `index` most."""
    found: list[tuple[float, Design, Trial]] = []
    inner = _root(fit.covariance)
    before = np.linalg.norm(inner[index])
    if not before > 0:
        return None
    for design, trial in _designs(scene, fit.model):
        run = _runs(fit.model, trial, design)
        if run is None or design.heavier:
            continue
        j = Whitener.of(scene.loop, scene.noise)(_slopes(fit.model, trial, design, run.y))
        r = np.asarray(np.linalg.qr(np.vstack([j @ inner, np.eye(inner.shape[1])]), "r"))
        left = scipy.linalg.solve_triangular(r.T, inner[index], lower=True)
        after = float(np.linalg.norm(left))
        found.append((float(before / max(after, 1e-300)), design, trial))
    return _best(found, (name, ""))


def _best(found: Sequence[tuple[float, Design, Trial]], names: tuple[str, str]):  # type: ignore[no-untyped-def]
    if not found:
        return None
    value, design, trial = max(found, key=lambda item: item[0])
    tried = tuple((d.text, v) for v, d, _ in sorted(found, key=lambda item: -item[0]))
    return Experiment(design.text, trial.t, trial.reference, trial.feedforward, names, value, tried)


# --- running a design -----------------------------------------------------------------------------


def _designs(scene: Scene, model: Model) -> Iterable[tuple[Design, Trial]]:
    """Candidates with the trial that runs them, the command within what was seen."""
    lim = limits(model, scene.trials)
    step = scene.trials[0].sample_time
    closed = scene.loop.controller is not None
    for design in (closed_loop_designs if closed else open_loop_designs)(lim, step):
        trial = _within(model, design, lim, step, closed)
        if trial is not None:
            yield design, trial


def _within(model: Model, design: Design, lim: Limits, step: float, closed: bool) -> Trial | None:
    """The trial of a design, slowed down (in closed loop) or made smaller until its command fits."""
    signal = design.reference
    for _ in range(SHRINKS):
        trial = _trial(model, signal, lim, step, closed)
        run = model.simulate(trial)
        if not run.diverged and _fits(run.u, lim):
            return trial
        if closed and len(signal) * step < 1.5 * lim.duration:
            n = int(1.2 * len(signal))
            signal = np.interp(np.linspace(0, len(signal) - 1, n), np.arange(len(signal)), signal)
        else:
            signal = 0.7 * signal
    return None


def _fits(u: Array, lim: Limits) -> bool:
    return _inside(u, lim.command, ROOM)


def _near(run: Simulation, lim: Limits) -> bool:
    """Whether a run stays about where the machine has been seen. (A map of a command by its heat, grown
    beyond what it was fitted to, made the loop run away, and 4e13 standard deviations of difference.)"""
    return _inside(run.y, (lim.low, lim.high), REACH) and _inside(run.u, lim.command, REACH)


def _inside(signal: Array, seen: tuple[float, float], share: float) -> bool:
    middle, half = 0.5 * sum(seen), 0.5 * (seen[1] - seen[0]) * share
    return bool(np.all(np.abs(signal - middle) <= half))


def _trial(model: Model, signal: Array, lim: Limits, step: float, closed: bool) -> Trial:
    n, simulator = len(signal), model.base.simulator
    zero = np.zeros(n)
    if closed:
        reference, command = lim.middle + signal, zero
        start = simulator.at_rest(lim.middle)
    else:
        reference, command = zero, 0.5 * sum(lim.command) + signal
        first = float(command[0])
        start = rest_under(simulator, first, first, _rests_at(simulator, first, lim))
    return Trial(
        "experiment",
        0.0,
        step,
        reference,
        command,
        None,
        zero,
        zero,
        start,
        np.zeros((0, 0)),
        True,
        simulator.mechanics,
    )


def _rests_at(simulator: Simulator, command: float, lim: Limits) -> float:
    """Where an open-loop plant rests under a constant command; the middle of the travel if it drifts."""
    m, n = simulator.mechanics, simulator.mechanics.own
    values = np.linalg.svd(m.a[:n, :n], compute_uv=False)
    if not n or values[-1] < DRIFTS * values[0]:
        return lim.middle
    return -command * float(m.c[:n] @ np.linalg.solve(m.a[:n, :n], m.b[:n]))


def _runs(model: Model | FreeModel, trial: Trial, design: Design) -> Simulation | None:
    if isinstance(model, FreeModel):
        found = FreeModel(_heavier(model.model, design), model.parts).simulate(trial)
        return None if found is None else found[0]
    run = _heavier(model, design).simulate(trial)
    return None if run.diverged else run


def _heavier(model: Model, design: Design) -> Model:
    if not design.heavier or "mass" not in {c.name for c in model.base.corrections}:
        return model
    mass = (1.0 + model.corrections.get("mass", 0.0)) + design.heavier
    return replace(model, corrections={**model.corrections, "mass": mass - 1.0})


def _slopes(model: Model, trial: Trial, design: Design, base: Array) -> Array:
    """d y/d theta by one-sided differences, (N, p)."""
    theta, columns = model.theta, []
    for k, c in enumerate(model.coordinates):
        step = -c.step if theta[k] + c.step > c.upper else c.step
        moved = theta.copy()
        moved[k] += step
        other = _runs(model.at(moved), trial, design)
        columns.append(np.zeros_like(base) if other is None else (other.y - base) / step)
    return np.column_stack(columns) if columns else np.zeros((len(base), 0))


def _root(covariance: Array) -> Array:
    """A with A A' = covariance."""
    if not len(covariance):
        return np.zeros((0, 0))
    spread = np.maximum(np.sqrt(np.maximum(np.diag(covariance), 0.0)), 1e-150)
    unseen = ~(spread < UNSEEN)  # as good as free
    spread = np.where(unseen, UNSEEN, spread)
    covariance = np.where(np.logical_or.outer(unseen, unseen), 0.0, covariance)
    correlation = covariance / np.outer(spread, spread) + np.diag(unseen.astype(float))
    values, vectors = np.linalg.eigh(correlation)
    return spread[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


def _beyond(d: Array, j: Array, covariance: Array) -> float:
    """sqrt(d' (I + J C J')^-1 d), by the residual of least squares with the numbers' prior."""
    table = j @ _root(covariance)
    k = table.shape[1]
    q, _ = np.linalg.qr(np.vstack([table, np.eye(k)]))
    stacked = np.append(d, np.zeros(k))
    return float(np.linalg.norm(stacked - q @ (q.T @ stacked)))


# --- which one ------------------------------------------------------------------------------------


def plan(
    scene: Scene, standing: Fit, outcome: Outcome, nameless: Contest, told: Collection[int]
) -> Experiment | None:
    """The experiment that the answer needs most: against the rival in doubt, for a map against the
    best name, else for the number known worst, of the effects that are `told`, by their places. None for
    what comes at times of its own, bursts and commands lost: no reference calls it."""
    names = standing.model.names
    winner = nameless.winner
    if nameless.verdict == "unnamed" and winner is None and not told:
        return None
    if nameless.verdict == "unnamed" and winner is not None:
        rival = standing if names else _runner_up(outcome) or standing
        label = " + ".join(rival.model.names) or "nothing missing"
        return separate(scene, winner.free, rival, (f"the map of {winner.name}", label))
    for name in [name for index, name in enumerate(names) if index in told]:
        rivals = probabilities(name, outcome.contenders)
        near = max((n for n in rivals if n != name), key=lambda n: rivals[n], default=None)
        if near is not None and rivals[near] > DOUBT:
            best = max((j for n, j in outcome.contenders[name] if n == near), key=lambda j: j.score)
            return separate(scene, standing.model, best.fit, (name, near))
    if not names:
        second = _runner_up(outcome)
        if second is None:
            return None
        return separate(scene, standing.model, second, ("nothing missing", second.model.names[-1]))
    return _vaguest(scene, standing, told)


def _runner_up(outcome: Outcome) -> Fit | None:
    """The best hypothesis of the last round that was not believed."""
    rivals = [r for r in outcome.steps[-1].rivals if np.isfinite(r.score)] if outcome.steps else []
    return max(rivals, key=lambda r: r.score).fit if rivals else None


def _vaguest(scene: Scene, standing: Fit, told: Collection[int]) -> Experiment | None:
    worst, index = SHARP, -1
    for k, (c, spread) in enumerate(zip(standing.model.coordinates, standing.spread, strict=True)):
        if c.kind != "effect" or c.effect not in told or c.place is not None:
            continue
        if standing.model.names[c.effect] == "drift":
            continue  # it goes by the clock alone: a longer recording tells more, another reference not
        parameter = EFFECTS[standing.model.names[c.effect]].parameter(c.name)
        value = 1.0 if c.log else abs(float(standing.model.theta[k]))
        if parameter.is_place:
            value = standing.model.base.travel if parameter.unit == "x" else 1.0
        if value > 0 and spread / value > worst and np.isfinite(spread):
            worst, index = float(spread / value), k
    if index < 0:
        return None
    c = standing.model.coordinates[index]
    best = sharpen(scene, standing, index, f"{standing.model.names[c.effect]}.{c.name}")
    return best if best is not None and best.separation > SHARPER else None

"""The proof: free-running simulation of held-out recordings, before and after, beside the noise."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.maps.freemodel import FreeModel
from ffl.diagnose.noise.imitate import Imitation, imitated
from ffl.diagnose.noise.noise import Paths
from ffl.diagnose.predict.as_sent import as_sent, is_drive
from ffl.diagnose.recorded.commands import limit_of
from ffl.diagnose.recorded.trials import Trial, start_of
from ffl.effects import EFFECTS
from ffl.machines.simulator import Simulation, Simulator
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

BLOCKS = 20  # of a recording, drawn with replacement
LOUDER = 2.0  # times all that is left: an estimate of noise beyond it has taken physics for noise


@dataclass(frozen=True)
class Overlay:
    """One held-out recording: measured, and simulated before and after."""

    name: str
    t: Array
    y: Array
    u: Array
    y_before: Array
    u_before: Array
    y_after: Array
    u_after: Array


@dataclass(frozen=True)
class Proof:
    """Held-out figures; `interval`: 95 % of nrmse_after - nrmse_before by paired block bootstrap;
    `untold`: no noise can be told from what is left, which `noise_floor` then is; `observed`: the runs
    were led by an observer."""

    recordings: tuple[str, ...]
    nrmse_before: float
    nrmse_after: float
    noise_floor: float
    u_nrmse_before: float | None
    u_nrmse_after: float | None
    u_noise_floor: float | None
    interval: tuple[float, float]
    overlays: tuple[Overlay, ...]
    nrmse_with_map: float | None = None  # of the map that has no name, where that is the answer
    u_nrmse_with_map: float | None = None  # the same of the command, where that is compared at all
    untold: bool = False
    observed: bool = False

    @property
    def improves(self) -> bool:
        """Whether y is nearer to what was recorded than before, or u is."""
        pairs = ((self.nrmse_before, self.nrmse_after), (self.u_nrmse_before, self.u_nrmse_after))
        return any(None not in (b, a) and a < b for b, a in pairs)  # type: ignore[operator]

    @property
    def left(self) -> float:
        """The error of y with all that the answer has, the map included."""
        return self.nrmse_after if self.nrmse_with_map is None else self.nrmse_with_map

    @property
    def within_noise(self) -> bool:
        """Whether what is left is no more than what noise alone would leave, by its own estimate."""
        return not self.untold and self.left <= self.noise_floor

    @property
    def withdrawn(self) -> Proof:
        """The proof of an answer that claims nothing: after is before, what a map draws apart. Noise by
        which what was withdrawn had explained itself, louder than all that is left, is none."""
        drawn = self.nrmse_with_map is not None
        unheard = self.noise_floor >= LOUDER * self.nrmse_before
        overlays = self.overlays
        if not drawn:
            overlays = tuple(replace(o, y_after=o.y_before, u_after=o.u_before) for o in overlays)
        return replace(
            self,
            nrmse_after=self.nrmse_before,
            u_nrmse_after=self.u_nrmse_before,
            interval=(0.0, 0.0),
            overlays=overlays,
            noise_floor=self.nrmse_before if unheard else self.noise_floor,
            untold=self.untold or unheard,
        )


def nrmse(measured: Sequence[Array], simulated: Sequence[Array]) -> float:
    """RMS(y - yhat)/RMS(y - mean(y)) over all recordings together."""
    top = sum(float(np.sum((a - b) ** 2)) for a, b in zip(measured, simulated, strict=True))
    bottom = sum(float(np.sum((a - a.mean()) ** 2)) for a in measured)
    return float(np.sqrt(top / bottom)) if bottom > 0 else float("inf")


def run_plant(plant: Plant, trial: Trial, observed: bool = False) -> Simulation:
    """The plant file's plant, effects included, from the recording's own start; `observed`: its controller
    is an observer, which leads it behind what bends the command."""
    simulator, effects = Simulator(plant), plant.effects
    if observed and (sent := as_sent(trial, effects, observed)) is not None:
        trial, effects = (
            sent,
            tuple(spec for spec in effects if not is_drive(EFFECTS[spec.name], observed)),
        )
    return simulator.run(
        effects,
        trial.reference,
        trial.feedforward,
        force=trial.load,
        start=start_of(simulator, effects, trial),
        start_time=trial.start_time,
        command_limit=limit_of(plant),
        **trial.before_it,
    )


def with_map(proof: Proof, held: Scene, maps: FreeModel) -> Proof:
    """The proof with maps beside the model as what is drawn after; unchanged where they run away."""
    runs = [maps.simulate(trial) for trial in held.trials]
    if any(run is None for run in runs):
        return proof
    return with_runs(proof, held.trials, [run[0] for run in runs if run])


def with_runs(proof: Proof, trials: Sequence[Trial], after: Sequence[Simulation]) -> Proof:
    """The proof with runs of what has no name as what is drawn after."""
    overlays = tuple(
        replace(o, y_after=run.y, u_after=run.u)
        for o, run in zip(proof.overlays, after, strict=True)
    )
    error = nrmse([t.recorded.y for t in trials], [run.y for run in after])
    sent = None
    if proof.u_nrmse_after is not None:
        sent = nrmse([t.recorded.u for t in trials], [run.u for run in after])
    return replace(proof, overlays=overlays, nrmse_with_map=error, u_nrmse_with_map=sent)


def prove(
    held: Scene,
    before: Sequence[Simulation],
    after: Sequence[Simulation],
    judged: Scene,
    rng: Generator,
    plant: Plant,
    observed: bool = False,
) -> Proof:
    """`before`: runs of the plant as stated, `after`: runs of the augmented `plant` as its file gives
    them, one per held-out recording. The noise floor is what noise as `judged` sees it leaves: on a
    plant with effects by runs with noise drawn, on a linear one by its transfer functions.
    `observed`: the controller is an observer's, so u is none of its business."""
    trials = [t.recorded for t in held.trials]
    y = [t.y for t in trials]
    u = [t.u for t in trials]
    paths = _paths(held)
    density = judged.noise.density(paths)
    variance = float(np.mean(density))
    alike: list[Imitation] = []
    bent = plant.effects or any(trial.asked is not None for trial in trials)
    if bent and not observed and not held.plain:
        alike = imitated(plant, trials, judged.noise, rng)
    if alike:
        variance = _mean_square(one.y for one in alike)
    samples = sum(len(t) for t in trials)
    scale = float(np.sqrt(sum(float(np.sum((a - a.mean()) ** 2)) for a in y) / samples))
    controller = None if observed else held.loop.controller
    u_floor = None
    u_before = u_after = None
    if controller is not None and all(np.all(np.isfinite(a)) for a in u):
        u_before = nrmse(u, [s.u for s in before])
        u_after = nrmse(u, [s.u for s in after])
        c = np.abs(controller.output.response(paths.frequencies)) ** 2
        u_scale = float(np.sqrt(sum(float(np.sum((a - a.mean()) ** 2)) for a in u) / samples))
        u_variance = _mean_square(one.u for one in alike) if alike else float(np.mean(c * density))
        u_floor = float(np.sqrt(u_variance)) / u_scale if u_scale > 0 else None
    overlays = tuple(
        Overlay(t.name, t.t, t.y, t.u, a.y, a.u, b.y, b.u)
        for t, a, b in zip(trials, before, after, strict=True)
    )
    errors = [(t.y - a.y, t.y - b.y) for t, a, b in zip(trials, before, after, strict=True)]
    floor = float(np.sqrt(variance)) / scale if scale > 0 else 0.0
    left = nrmse(y, [s.y for s in after])
    untold = floor >= LOUDER * left
    return Proof(
        tuple(t.name for t in trials),
        nrmse(y, [s.y for s in before]),
        left,
        left if untold else floor,
        u_before,
        u_after,
        u_floor,
        _interval(errors, scale, rng),
        overlays,
        untold=untold,
        observed=observed,
    )


def _mean_square(draws: Iterable[list[Array]]) -> float:
    every = np.concatenate([e for one in draws for e in one])
    return float(np.mean(every**2))


def _paths(scene: Scene) -> Paths:
    n = 4096
    frequencies = (np.arange(n) + 0.5) / n * 0.5 / scene.loop.system.sample_time
    return Paths.of(scene.loop, frequencies)


def _interval(
    errors: Sequence[tuple[Array, Array]], scale: float, rng: Generator, draws: int = 400
) -> tuple[float, float]:
    """Blocks of a twentieth of a recording, drawn with replacement, the same for both models; each counts
    by its samples, as in the figures themselves."""
    blocks = [
        (len(rows), np.sum(a[rows] ** 2), np.sum(b[rows] ** 2))
        for a, b in errors
        for rows in np.array_split(np.arange(len(a)), min(BLOCKS, len(a)))
    ]
    samples, first, second = np.array(blocks).T
    if not (np.all(np.isfinite(first)) and np.all(np.isfinite(second))):
        return (float("-inf"), float("inf"))
    index = rng.integers(len(first), size=(draws, len(first)))
    whole = samples[index].sum(axis=1)
    left = [np.sqrt(one[index].sum(axis=1) / whole) for one in (first, second)]
    low, high = np.quantile(left[1] - left[0], [0.025, 0.975]) / scale
    return float(low), float(high)

"""What the contest is held on: recordings, model and noise, made ready."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffl.diagnose.contest.judging import raw_error
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import SLOWEST, Noise, fit_noise
from ffl.diagnose.noise.plain import too_loud, weighed
from ffl.diagnose.recorded.clip import clipping, shown
from ffl.diagnose.recorded.commands import passing, reached
from ffl.diagnose.recorded.holds import HELD, moves
from ffl.diagnose.recorded.signs import looks_folded
from ffl.diagnose.recorded.trials import Trial, blocks, prepared, stretches
from ffl.diagnose.recorded.unfold import RECTIFIED, folded_scenes, learned_anew
from ffl.diagnose.screen.angles import with_angles
from ffl.recordings import Recording, shared_clock
from ffl.systems.plant import EffectSpec, Plant

BELIEF = 4.0  # the plant file's noise is known to about 50 %
LONG = 60_000  # samples in all: with more the contest looks at stretches of the recordings
BLIND = "the output turns back at zero: the sensor is blind to the sign"
BEGUN = (
    "where the recordings began along the way is not recorded, and was read from a force that comes again "
    "every {:.5g} {} s of it: a phase that is told is that of the first recording"
)
FOLD = 0.5  # of the squared error: what a sign-blind sensor must leave at most
NO_WORSE = 1.1  # times it, where the recordings that are fitted, or that judge, show no folds
ANEW = 0.9  # of what it leaves before the stated linear part: then that is learned anew
LOUDEST = 3.0  # times the stated noise: louder than an engineer can have been mistaken by
GUESS = 1e-3  # of the command's size: force noise where none is stated
SHAKES = 50.0  # times that guess: no machine that is shaken by more is diagnosed by its moves


@dataclass(frozen=True)
class Comparison:
    """The plant that the recordings are compared with, fitted and judging ones; `observed`: its controller
    is an observer, whose reference is y; `slowest`: lowest corner of coloured noise, Hz: the observer takes
    slower noise for physics, which it leads past; `folded`: y as it was before a sensor that is blind to
    its sign."""

    model: Plant
    recordings: Sequence[Recording]
    validation: Sequence[Recording]
    observed: bool = False
    slowest: float = SLOWEST
    folded: bool = False


@dataclass(frozen=True)
class Ground:
    """What the contest is held on: fitted recordings in `scene`, judging ones in `held`, in stretches where
    they are long (`cut`); the model alone, and as `told`, with what is seen directly in what was recorded;
    `prior`: noise as the plant file states it; `stands`: the spec of a sensor that clips, if one does."""

    seen: Comparison
    recordings: Sequence[Recording]
    validation: Sequence[Recording]
    scene: Scene
    held: Scene
    nominal: Model
    told: Model
    prior: Noise
    stands: EffectSpec | None
    cut: bool

    def trials(self, listed: Sequence[Recording]) -> tuple[Trial, ...]:
        made = _ready(self.nominal.base, self.prior, listed, self.seen.folded)
        return shown(made, self.stands, self.seen.model)

    @property
    def learned_anew(self) -> bool:
        """The linear part is not the plant file's: its states are others."""
        return self.told.base is not self.nominal.base


def _ready(
    base: Base, prior: Noise, listed: Sequence[Recording], folded: bool
) -> tuple[Trial, ...]:
    made = prepared(base.simulator, listed, prior.sensor)
    return tuple(replace(trial, folded=folded) for trial in made)


def ground_of(seen: Comparison, notes: list[str], say: Callable[[str], None]) -> Ground | None:
    """Recordings, model and noise as the contest takes them; None where the model runs away on them."""
    model, recordings, validation = seen.model, seen.recordings, seen.validation
    everything = [*recordings, *validation]
    travel = max(float(np.ptp(r.y)) for r in everything)
    until = max(float(np.abs(r.t).max()) for r in everything)
    limit, left = reached(model, everything), passing(everything)
    base = Base.of(model, travel, until, limit, seen.observed, left)
    base = replace(base, learned=max(float(np.ptp(r.y)) for r in recordings))
    prior, floor = _prior(model, base, recordings)
    if not validation:
        recordings, validation = blocks(recordings)
        notes.append("no validation recording was given: the last 30 % of each recording judged")
    recordings, validation = (
        [move for r in group for move in moves(model, r)] for group in (recordings, validation)
    )
    if sum(map(len, (*recordings, *validation))) < sum(map(len, everything)):
        notes.append(HELD)
    short, short_held = stretches(recordings, LONG), stretches(validation, LONG)
    trials, judging = (_ready(base, prior, group, seen.folded) for group in (short, short_held))
    scene = Scene(base.loop, trials, prior, floor, not shared_clock(everything))
    if seen.observed:
        scene = replace(scene, slowest=seen.slowest, observed=True)
    elif model.machine.states_noise:
        scene = replace(scene, loudest=prior.scaled(LOUDEST))
    elif model.controller is not None:
        scene = replace(scene, guess=_loudest(model, prior))
    nominal = Model(base)
    residuals = scene.residuals(nominal)
    if residuals is None:
        return None
    scene = replace(scene, noise=_first_noise(scene, residuals, prior))
    held = replace(scene, trials=judging)
    stands = None if seen.folded else clipping(model, everything)
    direct = RECTIFIED if seen.folded else stands
    told = nominal if direct is None else nominal.with_proven(direct)
    folds = _through_folds(nominal, scene, held, recordings, (short, short_held))
    if folds is not None:
        told, scene, held = folds
        if told.base is base:
            say(BLIND)
        else:
            say("the output turns back at zero: the linear part is learned through its folds")
            notes.append(
                "linear part identified anew, from |y|: the model's own was fitted to folds"
            )
    if model.controller is None and not scene.plain and too_loud(scene, nominal):
        plain = Noise(scene.noise.sensor, 1e-6 * scene.noise.force)
        scene = weighed(replace(scene, noise=plain, plain=True), nominal)
        held = replace(held, noise=plain, plain=True)
    if scene.plain:  # a model that runs free is told by its limit: beyond it, or short of it
        stands = None
    scene, held = (replace(s, trials=shown(s.trials, stands, model)) for s in (scene, held))
    cut = len(short) > len(recordings) or len(short_held) > len(validation)
    if not cut and (begun := with_angles(scene, held, told)) is not None:
        scene, held, period = begun
        notes.append(BEGUN.format(period, model.output_unit))
    return Ground(seen, recordings, validation, scene, held, nominal, told, prior, stands, cut)


def _through_folds(
    nominal: Model,
    scene: Scene,
    held: Scene,
    recordings: Sequence[Recording],
    short: tuple[Sequence[Recording], Sequence[Recording]],
) -> tuple[Model, Scene, Scene] | None:
    """Model and scenes before a sensor that is blind to the sign, where recordings look folded and are:
    the linear part as it is stated, or learned anew where that was fitted to folds."""
    base = nominal.base
    if not looks_folded(base.plant, recordings):
        return None
    straight = raw_error(scene, nominal), raw_error(held, nominal)
    ways = []
    for plant in (base.plant, learned_anew(base.plant, short[0])):
        if plant is not None:
            own = base if plant is base.plant else base.like(plant)
            model = Model(own).with_proven(RECTIFIED)
            first, second = folded_scenes(plant, scene, *short)
            left = raw_error(first, model), raw_error(second, model)
            shares = [a / max(b, 1e-300) for a, b in zip(left, straight, strict=True)]
            if min(shares) < FOLD and max(shares) < NO_WORSE:
                ways.append((sum(left), (model, weighed(first, model), second)))
    least = min((error for error, _ in ways), default=0.0)
    return next((way for error, way in ways if ANEW * error <= least), None)


def _prior(model: Plant, base: Base, recordings: Sequence[Recording]) -> tuple[Noise, float]:
    """Noise as the plant file states it, or guessed from the roughness of y; least sensor noise."""
    floor = model.machine.encoder_resolution / np.sqrt(12.0)
    rough = np.median([np.std(np.diff(r.y, 2)) / np.sqrt(6.0) for r in recordings])
    sensor = model.machine.sensor_noise or float(rough)
    size = np.median([np.std(r.u[np.isfinite(r.u)]) if np.isfinite(r.u).any() else 1.0
                      for r in recordings])  # fmt: skip
    force = model.machine.force_noise or GUESS * float(size)
    sensor = float(np.hypot(sensor, floor)) or 1e-9 * float(np.ptp(recordings[0].y))
    return Noise(sensor, force or 1e-9), float(floor)


def _loudest(model: Plant, prior: Noise) -> Noise:
    """White noise louder than any there can be in a closed loop whose plant file does not state it."""
    force = LOUDEST if model.machine.force_noise else SHAKES
    return Noise(LOUDEST * prior.sensor, force * prior.force)


def _first_noise(scene: Scene, residuals: Sequence[np.ndarray], prior: Noise) -> Noise:
    """The least noise that the recordings show: a lower envelope over time and frequency."""
    belief = BELIEF if scene.trials else 0.0
    return fit_noise(
        scene.loop, residuals, prior, quantile=0.2, coloured=False, floor=scene.floor, belief=belief
    )

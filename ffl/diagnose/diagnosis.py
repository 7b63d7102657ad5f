"""Find the missing physics: the chain of steps from recordings to a proven model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from ffl.diagnose.contest.by_own_noise import by_own_noise
from ffl.diagnose.contest.chance import without_chance
from ffl.diagnose.contest.judging import judge, raw_error
from ffl.diagnose.contest.line import across_the_line, against_the_refused, released
from ffl.diagnose.contest.plainest import plainest
from ffl.diagnose.contest.restraint import restrained
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.search import contest
from ffl.diagnose.contest.stated import let_free
from ffl.diagnose.contest.timing import late_otherwise
from ffl.diagnose.contest.unneeded import without_unneeded
from ffl.diagnose.hypothesis.harmonics import without_faint
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.heard import with_modes_heard
from ffl.diagnose.noise.noise import SLOWEST, Noise, fit_noise
from ffl.diagnose.noise.plain import too_loud, weighed
from ffl.diagnose.predict.dry_in_noise import with_dry_friction
from ffl.diagnose.predict.freely import with_free_runs
from ffl.diagnose.predict.loose_head import with_loose_head
from ffl.diagnose.predict.observer import (
    decay_for,
    decay_of,
    led,
    moving,
    needs_observer,
    with_firm_observer,
    with_observer,
)
from ffl.diagnose.predict.parting import clearer, parts
from ffl.diagnose.predict.rattling import with_rattling
from ffl.diagnose.proof.conclude import SHORTEST, conclude, faulty, too_short, unlike
from ffl.diagnose.recorded import sound
from ffl.diagnose.recorded.clip import clipping, shown
from ffl.diagnose.recorded.commands import as_limited, passing, reached
from ffl.diagnose.recorded.glitches import without_glitches, without_turns
from ffl.diagnose.recorded.holds import HELD, moves
from ffl.diagnose.recorded.mistaken import mistakes
from ffl.diagnose.recorded.signs import looks_folded, unfolded
from ffl.diagnose.recorded.starts import with_starts
from ffl.diagnose.recorded.trials import Trial, blocks, commanded, prepared, stretches
from ffl.diagnose.recorded.unfold import RECTIFIED, folded_scenes, learned_anew
from ffl.diagnose.result import Diagnosis
from ffl.diagnose.transmission.transmission import transmission
from ffl.errors import InputError
from ffl.recordings import Recording, shared_clock
from ffl.recordings.repeats import repeat_findings
from ffl.systems.plant import Plant

THRESHOLD = 25.0  # score that one more effect must bring (look-elsewhere: see reports)
BELIEF = 4.0  # the plant file's noise is known to about 50 %
LONG = 60_000  # samples in all: with more the contest looks at stretches of the recordings
BLIND = "the output turns back at zero: the sensor is blind to the sign"
FOLD = 0.5  # of the squared error: what a sign-blind sensor must leave at most
NO_WORSE = 1.1  # times it, where the recordings that are fitted, or that judge, show no folds
ANEW = 0.9  # of what it leaves before the stated linear part: then that is learned anew
LOUDEST = 3.0  # times the stated noise: louder than an engineer can have been mistaken by
GUESS = 1e-3  # of the command's size: force noise where none is stated
SHAKES = 50.0  # times that guess: no machine that is shaken by more is diagnosed by its moves


def diagnose(
    model: Plant,
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    *,
    rng: Generator | None = None,
    progress: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Locates, names, models and proves what `model` leaves out of `recordings`.

    `validation` judges and is never fitted; without it the last 30 % of every recording does, and
    the answer says so. A second encoder (`y_load`) is compared with y by itself, beside all that is said of
    y. Raises `InputError` for recordings that cannot be used at all.
    """
    if not recordings:
        raise InputError("diagnose: no recording given; give at least one")
    between = transmission(model, recordings, validation)
    found = _diagnose_output(
        model,
        recordings,
        validation,
        rng or np.random.default_rng(0),
        progress or (lambda line: None),
    )
    return found if found.soundness.faults else replace(found, transmission=between)


def _diagnose_output(
    model: Plant,
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    rng: Generator,
    say: Callable[[str], None],
) -> Diagnosis:
    """What the model leaves out of y."""
    _require_stable(model)
    _require_others(recordings, validation)
    _require_once([*recordings, *validation])
    everything, turned = without_turns(model, [*recordings, *validation])
    everything = [commanded(model, r) for r in everything]
    everything, glitches = without_glitches(model, everything)
    everything, notes = sound.injected_as_sent(model, everything)
    notes = [*turned, *glitches, *notes]
    recordings, validation = everything[: len(recordings)], everything[len(recordings) :]
    health = sound.soundness(model, everything)
    notes += health.notes
    health = replace(health, faults=mistakes(model, everything, health.faults))
    if health.faults:
        return faulty(model, health)
    shortest = min(len(r) for r in everything)
    if shortest < SHORTEST:
        return too_short(model, health, shortest)
    recordings, validation = (
        [as_limited(model, r) for r in group] for group in (recordings, validation)
    )
    observed = needs_observer(model)
    if model.controller is None:
        try:
            model.require_stable()
        except InputError as error:
            notes.append(f"{error}, or, where the machine does not run away, mend that pole's sign")
    if observed:
        _require_command(everything)
    say("checking the recordings: sound")

    def named(seen: Comparison, notes: list[str]) -> Diagnosis:
        return _named(model, seen, health, notes, rng, say)

    if observed:
        notes.append(
            "the controller is unknown and the plant integrates: predicted through an observer, not in "
            "free run"
        )
        decay = decay_for(recordings)
        leading, slow = with_observer(model, decay), decay / (2 * np.pi)
        seen = Comparison(leading, led(moving(recordings)), led(moving(validation)), True, slow)
        return named(seen, notes)
    found = named(Comparison(model, recordings, validation), list(notes))
    if not parts(found):
        return found
    say("free runs leave structure: looked at once more, led by an observer")
    firm = with_firm_observer(model)
    slow = max(SLOWEST, decay_of(firm) / (2 * np.pi))
    seen = Comparison(firm, led(recordings), led(validation), True, slow)
    return clearer(found, named(seen, list(notes)), rng)


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


def _named(
    stated: Plant,
    seen: Comparison,
    health: sound.Soundness,
    notes: list[str],
    rng: Generator,
    say: Callable[[str], None],
) -> Diagnosis:
    """What `stated` leaves out of the recordings, as they are `seen`."""
    model, recordings, validation = seen.model, seen.recordings, seen.validation
    everything = [*recordings, *validation]
    signed = None if seen.folded else unfolded(model, everything)
    if signed is not None:
        say(BLIND)
        first, last = signed[: len(recordings)], signed[len(recordings) :]
        seen = replace(seen, recordings=first, validation=last, folded=True)
        return _named(stated, seen, health, notes, rng, say)
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

    def ready(listed: Sequence[Recording]) -> tuple[Trial, ...]:
        made = prepared(base.simulator, listed, prior.sensor)
        return tuple(replace(trial, folded=seen.folded) for trial in made)

    trials, judging = ready(short), ready(short_held)
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
        return unlike(model, health, "the model's simulation diverges on these recordings")
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
    outcome = contest(scene, held, told, THRESHOLD, progress=say)
    if scene.work.done:
        notes.append(
            f"the search was ended after {scene.work.runs} simulations: more may be missing"
        )
    outcome = with_rattling(scene, held, outcome, told, prior, say)
    outcome = with_loose_head(scene, held, outcome, told, prior, say)
    outcome = with_free_runs(scene, held, outcome, prior, THRESHOLD, say)
    outcome = with_dry_friction(scene, held, outcome, told, prior)
    standing, held = outcome.standing, outcome.held or held
    if standing.predicted:
        say(f"{standing.name}: foretells sample by sample what no free run does")
    elif len(short) > len(recordings) or len(short_held) > len(validation):
        notes.append(f"more than {LONG} samples: named from stretches, fitted and judged on all")
        say("fitting what was named to all samples")
        trials = shown(ready(recordings), stands, model)
        judging = shown(ready(validation), stands, model)
        scene, held = replace(standing.scene, trials=trials), replace(held, trials=judging)
        scene = with_starts(scene, standing.model)
        held = with_starts(held.like(scene), standing.model)
        standing = judge(scene, held, standing.model, rounds=5)
    if not standing.predicted:
        names = standing.model.names
        standing = across_the_line(standing.scene, held, standing)
        standing, outcome = against_the_refused(held, standing, outcome)
        standing, outcome = late_otherwise(held, standing, outcome, names)
        standing, outcome = plainest(held, standing, outcome)
        standing = without_chance(held, without_faint(held, standing))
        standing = without_unneeded(held, let_free(held, standing))
    standing = with_modes_heard(held, standing)
    if not standing.predicted:
        standing = released(by_own_noise(held, restrained(held, standing)))
    held = with_starts(held.like(standing.scene), standing.model)
    own = held.trials
    if told.base is not base:  # the states of the model's own linear part are others
        own = prepared(base.simulator, validation, prior.sensor)
    run = nominal.follow if held.observed else nominal.simulate
    before = [run(trial) for trial in own]
    if told.base is not base:
        nominal = told.without(0)
    return conclude(stated, nominal, before, held, standing, outcome, health, notes, rng)


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


def _require_command(recordings: Sequence[Recording]) -> None:
    for r in recordings:
        if not np.all(np.isfinite(r.u)):
            raise InputError(
                f"{r.source}: no command u and no [controller] in the plant file; give one of them"
            )


def _require_others(recordings: Sequence[Recording], validation: Sequence[Recording]) -> None:
    for v in validation:
        for r in recordings:
            if np.array_equal(v.y, r.y):
                raise InputError(
                    f"{v.source}: judges what was fitted to the same samples ({r.source}); validate with "
                    "another recording, or leave --validate out: then the last 30 % judge"
                )


def _require_once(recordings: Sequence[Recording]) -> None:
    """No block of samples written twice: the machine would jump back to where it was."""
    for r in recordings:
        for finding in repeat_findings(r):
            raise InputError(f"{r.source}: {finding.text}")


def _require_stable(model: Plant) -> None:
    """Refuses a loop that runs away; a pole on the circle that nothing drives (an integrator on the
    reference alone) may stay."""
    poles = model.loop.poles
    if model.controller is not None and len(poles) and np.abs(poles).max() > 1.0 + 1e-9:
        model.require_stable()


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

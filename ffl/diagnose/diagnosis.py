"""Find the missing physics: the chain of steps from recordings to a proven model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
import scipy.stats
from numpy.random import Generator

from ffl.diagnose import sound, where
from ffl.diagnose.advise import Experiment, plan
from ffl.diagnose.clip import clipping
from ffl.diagnose.corrections import corrections
from ffl.diagnose.fit import Scene
from ffl.diagnose.judging import Judged, judge, raw_error
from ffl.diagnose.line import across_the_line, slight
from ffl.diagnose.model import Base, Model
from ffl.diagnose.noise import Noise, fit_noise
from ffl.diagnose.observer import decay_for, led, moving, needs_observer, with_observer
from ffl.diagnose.picture import MapPicture, picture
from ffl.diagnose.plain import too_loud, weighed
from ffl.diagnose.posterior import probabilities
from ffl.diagnose.prove import prove, run_plant, with_map
from ffl.diagnose.result import Diagnosis, Finding, Number
from ffl.diagnose.search import Outcome, Step, contest
from ffl.diagnose.starts import with_starts
from ffl.diagnose.states import linear_share, states
from ffl.diagnose.trials import commanded, prepare, stretches
from ffl.diagnose.unfold import RECTIFIED, folded_scenes, looks_folded, unfolded
from ffl.diagnose.unnamed import Contest, compare
from ffl.diagnose.verdict import verdict
from ffl.effects import EFFECTS
from ffl.errors import InputError
from ffl.machines.simulator import Simulation
from ffl.recordings import Recording, shared_clock
from ffl.systems.plant import Plant
from ffl.systems.plant_file import plant_from_dict, plant_to_dict

THRESHOLD = 25.0  # score that one more effect must bring (look-elsewhere: see reports)
BELIEF = 4.0  # the plant file's noise is known to about 50 %
LONG = 60_000  # samples in all: with more the contest looks at stretches of the recordings
FOLD = 0.5  # of the held-out squared error: what a sign-blind sensor must leave at most
LOUDEST = 3.0  # times the stated noise: louder than an engineer can have been mistaken by
SHORTEST = 200  # samples: fewer cannot tell physics from noise
WORSE = 1.2  # times the held-out nrmse before: names that leave more are not said
UNLIKE = 0.5  # nrmse of the best model above which it is another machine


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
    the answer says so. Raises `InputError` for recordings that cannot be used at all.
    """
    rng = rng or np.random.default_rng(0)
    say = progress or (lambda line: None)
    if not recordings:
        raise InputError("diagnose: no recording given; give at least one")
    _require_stable(model)
    _require_others(recordings, validation)
    everything = [commanded(model, r) for r in (*recordings, *validation)]
    everything, notes = sound.injected_as_sent(model, everything)
    recordings, validation = everything[: len(recordings)], everything[len(recordings) :]
    health = sound.soundness(model, everything)
    if health.faults:
        return _faulty(model, health)
    shortest = min(len(r) for r in everything)
    if shortest < SHORTEST:
        return _too_short(model, health, shortest)
    say("checking the recordings: sound")
    stated = model
    if needs_observer(model):
        _require_command(everything)
        notes.append(
            "the controller is unknown and the plant integrates: predicted through an observer, not in "
            "free run"
        )
        decay = decay_for(recordings)
        model = with_observer(model, decay)
        recordings, validation = led(moving(recordings)), led(moving(validation))
        everything = [*recordings, *validation]
    base = Base.of(model, max(float(np.ptp(r.y)) for r in everything))
    prior, floor = _prior(model, base, recordings)
    if not validation:
        recordings, validation = _blocks(recordings)
        notes.append("no validation recording was given: the last 30 % of each recording judged")
    short, short_held = stretches(recordings, LONG), stretches(validation, LONG)
    trials = tuple(prepare(base.simulator, r, prior.sensor) for r in short)
    judging = tuple(prepare(base.simulator, r, prior.sensor) for r in short_held)
    scene = Scene(model.loop, trials, prior, floor, not shared_clock(everything))
    if stated is not model:
        scene = replace(scene, slowest=decay / (2 * np.pi))
    if stated is model and model.machine.sensor_noise and model.machine.force_noise:
        scene = replace(scene, loudest=prior.scaled(LOUDEST))
    nominal = Model(base)
    residuals = scene.residuals(nominal)
    if residuals is None:
        return _unlike(model, health, "the model's simulation diverges on these recordings")
    scene = replace(scene, noise=_first_noise(scene, residuals, prior))
    held = replace(scene, trials=judging)
    stands = clipping(model, everything)
    told = (
        nominal
        if stands is None
        else replace(nominal, effects=(stands,), proven=frozenset({stands.name}))
    )
    if looks_folded(model, recordings) and (other := unfolded(model, short, short_held)):
        say("the output turns back at zero: the linear part is learned through a sign-blind sensor")
        folded, folded_held = folded_scenes(other, scene, short, short_held)
        anew = Model(Base.of(other, base.travel), effects=(RECTIFIED,))
        if raw_error(folded_held, anew) < FOLD * raw_error(held, nominal):
            scene, held, told = weighed(folded, anew), folded_held, anew
            notes.append(
                "linear part identified anew, from |y|: the model's own was fitted to folds"
            )
    if model.controller is None and not scene.plain and too_loud(scene, nominal):
        plain = Noise(scene.noise.sensor, 1e-6 * scene.noise.force)
        scene = weighed(replace(scene, noise=plain, plain=True), nominal)
        held = replace(held, noise=plain, plain=True)
    outcome = contest(scene, held, told, THRESHOLD, progress=say)
    standing, held = outcome.standing, outcome.held or held
    if len(short) > len(recordings) or len(short_held) > len(validation):
        notes.append(f"more than {LONG} samples: named from stretches, fitted and judged on all")
        say("fitting what was named to all samples")
        trials = tuple(prepare(base.simulator, r, prior.sensor) for r in recordings)
        judging = tuple(prepare(base.simulator, r, prior.sensor) for r in validation)
        scene, held = replace(standing.scene, trials=trials), replace(held, trials=judging)
        scene = with_starts(scene, standing.model)
        held = with_starts(replace(held, noise=scene.noise), standing.model)
        standing = judge(scene, held, standing.model, rounds=5)
    standing = across_the_line(standing.scene, held, standing)
    own = held.trials
    if told.base is not base:  # the states of the model's own linear part are others
        own = tuple(prepare(base.simulator, r, prior.sensor) for r in validation)
    before = [nominal.simulate(trial) for trial in own]
    if told.base is not base:
        nominal = told.without(0)
    return _conclude(stated, nominal, before, held, standing, outcome, health, notes, rng)


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
    force = model.machine.force_noise or 1e-3 * float(size)
    sensor = float(np.hypot(sensor, floor)) or 1e-9 * float(np.ptp(recordings[0].y))
    return Noise(sensor, force or 1e-9), float(floor)


def _first_noise(scene: Scene, residuals: Sequence[np.ndarray], prior: Noise) -> Noise:
    """The least noise that the recordings show: a lower envelope over time and frequency."""
    belief = BELIEF if scene.trials else 0.0
    return fit_noise(
        scene.loop, residuals, prior, quantile=0.2, coloured=False, floor=scene.floor, belief=belief
    )


def _blocks(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """The first 70 % of every recording, and the rest."""
    cuts = [int(0.7 * len(r)) for r in recordings]
    pairs = list(zip(recordings, cuts, strict=True))
    return [r[:cut] for r, cut in pairs], [r[cut:] for r, cut in pairs]


# --- the answer -----------------------------------------------------------------------------------


def _conclude(
    model: Plant,
    nominal: Model,
    before: Sequence[Simulation],
    held: Scene,
    standing: Judged,
    outcome: Outcome,
    health: sound.Soundness,
    notes: list[str],
    rng: Generator,
) -> Diagnosis:
    nameless = compare(outcome.standing.scene, outcome.held or held, nominal, standing.model, rng)
    maps = nameless.alone.free if nameless.verdict == "unnamed" and nameless.alone else None
    fitted = replace((maps.model if maps else standing.model).plant(), name=model.name)
    running = plant_from_dict(plant_to_dict(fitted))
    observed = model.controller is None and fitted.controller is not None
    augmented = replace(running, controller=None) if observed else running
    after = [run_plant(running, trial) for trial in held.trials]
    quiet = nameless.winner.scene if nameless.winner else standing.scene
    proof = prove(replace(held, noise=quiet.noise), before, after, quiet, rng, running, observed)
    if maps:
        proof = with_map(proof, held, maps)
    effects = standing.model.effects
    said, place = verdict(model, standing, nameless)
    told = [i for i, spec in enumerate(effects) if not slight(spec, model)]
    if effects and not told and nameless.verdict == "named":
        said, place = "nothing_missing", where.Place("", "", ())
    unlike = proof.nrmse_after > UNLIKE and (proof.nrmse_with_map or np.inf) > UNLIKE
    if effects and not proof.nrmse_after < WORSE * proof.nrmse_before and said != "unnamed":
        said = "inconclusive"
        place = where.Place("", "what was fitted does not hold on the held-out recordings", ())
    if unlike:
        said = "inconclusive"
        place = where.Place("plant", "the model as a whole: it is unlike the machine recorded", ())
    raw = quiet.residuals(nominal) or []
    maps_before = where.maps(quiet, quiet.whiten(raw)) if raw else ()
    left = (maps.residuals(quiet) if maps else quiet.residuals(standing.model)) or []
    maps_after = where.maps(quiet, quiet.whiten(left)) if left else ()
    if said != "nothing_missing":
        motions = [nominal.simulate(trial).motion() for trial in quiet.trials]
        place = replace(
            place,
            frequency_band_hz=where.band(maps_before),
            time_s=where.stretches(maps_before),
            linear_share=linear_share(quiet, raw) if raw else None,
            states=states(quiet.whiten(raw), motions) if raw else (),
        )
    experiment = None
    if said != "nothing_missing" and not unlike and not observed:
        with suppress(InputError):  # limits too narrow for any move or wave
            experiment = plan(standing.scene, standing.fit, outcome, nameless)
    findings = tuple(
        _finding(standing, index, outcome, model, said == "explained") for index in told
    )
    return Diagnosis(
        plant=model,
        augmented=augmented,
        verdict=said,
        place=place,
        findings=findings if said not in ("unnamed", "inconclusive") else (),
        corrections=() if maps or said == "inconclusive" else corrections(standing),
        proof=proof,
        advice=_advice(said, place, experiment),
        experiment=experiment,
        soundness=health,
        steps=tuple(outcome.steps),
        judged=standing,
        maps_before=maps_before,
        maps_after=maps_after,
        notes=tuple(notes),
        nameless=nameless,
        pictures=_pictures(nameless),
        forces=where.forces(standing.scene, standing.model) if effects and not maps else None,
    )


def _pictures(nameless: Contest) -> tuple[MapPicture, ...]:
    winner = nameless.winner
    if winner is None:
        return ()
    said = dict(enumerate(nameless.formulas))
    drawn = [
        picture(winner.scene, winner.free, k, said.get(k)) for k in range(len(winner.free.parts))
    ]
    return tuple(p for p in drawn if p is not None)


def _finding(
    standing: Judged, index: int, outcome: Outcome, plant: Plant, complete: bool
) -> Finding:
    spec = standing.model.effects[index]
    effect = EFFECTS[spec.name]
    spreads = dict(zip(standing.model.coordinates, standing.fit.spread, strict=True))
    numbers = {}
    for name, value in spec.parameters.items():
        unit = effect.parameter(name).unit_in(plant)
        error = None
        for c, spread in spreads.items():
            if c.kind == "effect" and c.effect == index and c.name == name and c.place is None:
                error = float(spread * value if c.log else spread)
        numbers[name] = Number(value, unit, error)
    shares = probabilities(spec.name, outcome.contenders, complete)
    own = shares.pop(spec.name)
    others = sorted(shares.items(), key=lambda item: -item[1])
    return Finding(
        spec.name,
        effect.component,
        numbers,
        spec.options,
        own,
        _p_value(spec.name, outcome.steps),
        effect.says(effect.check(spec), plant),
        tuple((name, p) for name, p in others if p > 1e-3)[:4],
    )


def _round_of(name: str, steps: list[Step]) -> Step | None:
    for step in steps:
        if step.accepted is not None and step.accepted.model.names[-1] == name:
            return step
    return None


def _p_value(name: str, steps: list[Step]) -> float | None:
    """Likelihood ratio of the fitted recordings, for the free numbers it added."""
    step = _round_of(name, steps)
    if step is None or step.accepted is None:
        return None
    ratio = 2.0 * (step.accepted.fitted - step.before.fitted)
    freedom = max(1, step.accepted.freedom - step.before.freedom)
    return float(max(scipy.stats.chi2.sf(max(ratio, 0.0), freedom), 1e-300))


def _advice(said: str, place: where.Place, experiment: Experiment | None) -> tuple[str, ...]:
    if said == "inconclusive" and "unlike" in place.where:
        return ("identify a linear model of this machine first: ffl identify linear",)
    if said == "inconclusive" and "hold" in place.where:
        return (
            "fit and judge by recordings over the same range, or begin with ffl identify linear",
        )
    out = [] if experiment is None else [experiment.advice]
    if said == "inconclusive":
        out.append(
            "what is left is louder than the noise that the plant file states, and nothing of the "
            "catalogue explains it: record standstill for the noise, and slow moves with reversals"
        )
    if said == "unnamed" and experiment is None:
        out.append(
            "record the same move twice: what comes back is the machine, what does not is not"
        )
    return tuple(out)


# --- what ends early ------------------------------------------------------------------------------


def _ended(model: Plant, health: sound.Soundness, where_: str, component: str, advice: str):  # type: ignore[no-untyped-def]
    return Diagnosis(
        plant=model,
        augmented=model,
        verdict="inconclusive",
        place=where.Place(component, where_, ()),
        findings=(),
        corrections=(),
        proof=None,
        advice=(advice,),
        soundness=health,
        steps=(),
        judged=None,
    )


def _faulty(model: Plant, health: sound.Soundness) -> Diagnosis:
    fault = health.faults[0]
    component = {"controller": "controller", "shift": "timing"}.get(fault.kind, "sensor")
    return _ended(
        model,
        health,
        f"{fault.recording}: {fault.where}",
        component,
        f"{fault.where}: {fault.mend}",
    )


def _too_short(model: Plant, health: sound.Soundness, samples: int) -> Diagnosis:
    return _ended(
        model, health, "the length of the recording", "environment",
        f"{samples} samples cannot tell physics from noise: record at least {SHORTEST}, some seconds "
        "of motion with reversals",
    )  # fmt: skip


def _unlike(model: Plant, health: sound.Soundness, why: str) -> Diagnosis:
    return _ended(
        model, health, why, "plant",
        "identify a linear model of this machine first: ffl identify linear",
    )  # fmt: skip

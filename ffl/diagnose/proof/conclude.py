"""What a contest comes to: verdict, place, numbers, proof and advice, as one result."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.posterior import none_of_them
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.corrections import as_gain, beside_maps, corrections, times_as_much
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.maps.freemodel import Running
from ffl.diagnose.maps.picture import MapPicture, picture
from ffl.diagnose.maps.unnamed import Contest, compare
from ffl.diagnose.proof.advise import Experiment, plan
from ffl.diagnose.proof.findings import finding
from ffl.diagnose.proof.names import named
from ffl.diagnose.proof.prove import Proof, prove, run_plant, with_map
from ffl.diagnose.proof.unvisited import unvisited
from ffl.diagnose.proof.verdict import (
    BEYOND,
    LOUD,
    LOUDER,
    UNDECIDED,
    foretold,
    in_their_state,
    is_unlike,
    loudness,
    refuted,
    rounding,
    verdict,
)
from ffl.diagnose.recorded import sound, where
from ffl.diagnose.recorded.mistaken import too_large
from ffl.diagnose.recorded.starts import with_starts
from ffl.diagnose.recorded.states import linear_share, states
from ffl.diagnose.recorded.warmth import with_warmth
from ffl.diagnose.result import Diagnosis
from ffl.effects import EFFECTS
from ffl.effects.linear_mechanics import as_seen
from ffl.errors import InputError
from ffl.machines.simulator import Simulation
from ffl.systems.plant import Plant
from ffl.systems.plant_file import plant_from_dict, plant_to_dict

SHORTEST = 200  # samples: fewer cannot tell physics from noise
# Times the held-out nrmse before: names that leave more are not said. Where no noise is stated, all that
# is left passes for noise, and names that leave no less have shown nothing.
WORSE = 1.2
RIGHTED = 0.5  # of the held-out error: what a right unit leaves at most
IMPLAUSIBLE = 5.0  # times a mass or a gain: no machine is so far from its model, but a unit may be
MOST = (
    0.5  # of the nrmse before: where no noise is stated, nobody knows that more than this is noise
)
DELAY = "input_delay"
LOGGED = (
    "a u that was logged as much before y looks the same where no controller is stated: see that both "
    "columns have one clock"
)
NOTICED = 0.9  # of the nrmse before: an error that is lowered by less needs no word
PARTED = 3.0  # times the nrmse of the model alone


def conclude(
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
    """The result: `model` as its file states it, `nominal` with its runs `before` on the held-out
    recordings `held`, the contest's `outcome` and the hypothesis `standing` after it."""
    turned = replace(standing.fit, model=within_a_turn(standing.model))
    standing = replace(standing, fit=turned)
    rounded = not standing.predicted and rounding(standing)
    if standing.predicted or rounded:  # nothing that is left says what is still missing
        all_there_is = "named" if standing.predicted or standing.model.effects else "nothing"
        nameless = Contest(all_there_is, None, None, 0.0, 0.0, None)
    else:
        scene = outcome.standing.scene.like(standing.scene)
        judging = (outcome.held or held).like(scene)
        nameless = compare(scene, judging, nominal, standing.fit, rng)
        first = outcome.steps[0].before if outcome.steps else standing
        if nameless.verdict == "nothing" and len(first.model.effects) < len(standing.model.effects):
            return conclude(model, nominal, before, held, first, outcome, health, notes, rng)
    maps = nameless.alone.free if nameless.verdict == "unnamed" and nameless.alone else None
    lost = nameless.lost
    bare = maps.model if maps else lost.fit.model if lost else standing.model
    if nameless.verdict == "unnamed" and standing.model.effects and not (maps or lost):
        bare = nominal  # bursts alone
    fitted = replace(as_seen(bare.plant(), len(bare.effects)), name=model.name)
    running = plant_from_dict(plant_to_dict(fitted))
    observed = held.observed
    augmented = replace(running, controller=model.controller) if observed else running
    after = [run_plant(running, trial, observed) for trial in held.trials]
    quiet = nameless.winner.scene if nameless.winner else standing.scene
    if lost:
        quiet = quiet.like(lost.fitted.scene)
    held = held.like(quiet)
    proof = prove(held, before, after, quiet, rng, running, observed)
    if maps:
        begun = with_starts(held, Running(maps))  # the start too was another's, who stands no more
        proof = with_map(proof, with_warmth(begun, maps), maps)
        share = (proof.nrmse_with_map or 0.0) / max(proof.noise_floor, 1e-300)
        if share > BEYOND:
            notes.append(
                f"the map leaves {share:.2g} times what noise alone would: it is not the whole of it"
            )
    effects = standing.model.effects
    trusted = not standing.predicted and not nameless.led
    runs = proof.nrmse_after / proof.noise_floor if trusted and proof.noise_floor > 0 else 1.0
    said, place = verdict(model, standing, nameless, runs)
    if rounded and said == "partly_explained":
        said = "explained"
    told, sizeless = named(standing, model, said != "partly_explained")
    if effects and not told and not sizeless and nameless.verdict == "named":
        said, place = "nothing_missing", where.Place("", "", ())
    if sizeless:
        said = said if told else "unnamed"
    left_over = loudness(model, standing)
    if told and said == "partly_explained" and left_over > LOUDER:
        notes.append(
            f"what is left is {left_over:.2g} times as loud as the plant file's noise can make it"
        )
    if said == "partly_explained":
        beyond = unvisited(standing.model.names, quiet.trials, held.trials, model.output_unit)
        notes += [beyond] if beyond else []
    another = trusted and is_unlike(proof.nrmse_after, proof.nrmse_with_map)
    another = another and not 0.0 < left_over <= LOUD  # noise may be most there is
    noisy = WORSE if model.machine.states_noise else 1.0
    worse = trusted and not proof.nrmse_after < noisy * proof.nrmse_before
    if standing.predicted and "backlash" in standing.model.names:
        said, note = foretold(said, proof)
        notes.append(note)
    worse = worse or _parted(standing, proof)
    seen = {e.name for e in effects} <= standing.model.proven  # directly, in what was recorded
    if effects and worse and said != "unnamed":
        said, place = ("partly_explained", place) if seen else refuted(nameless)
    if said == "explained" and effects and trusted and not proof.improves:
        said = "partly_explained"
        notes.append("free runs of the held-out recordings are no better for what was named")
    unsure = trusted and not model.machine.states_noise
    if said == "explained" and unsure and proof.nrmse_after > MOST * proof.nrmse_before:
        said = "partly_explained"
        notes.append(
            "no noise is stated, and nobody knows that as much as is left is noise: state sensor_noise "
            "and force_noise in [machine]"
        )
    elif said == "explained" and unsure and (loud := loudness(model, standing, True)) > LOUDER:
        said = "partly_explained"
        notes.append(
            f"what is left is {loud:.2g} times as loud as the stated sensor_noise can make it; no "
            "force_noise is stated, and nobody knows that the rest is noise: state it in [machine]"
        )
    if another:
        said = "inconclusive"
        place = where.Place("plant", "the model as a whole: it is unlike the machine recorded", ())
    off = times_as_much(standing) if said != "unnamed" else 1.0
    implausible = not 1.0 / IMPLAUSIBLE < off < IMPLAUSIBLE
    # A wrong unit is most of the mismatch; a mass that runs off and leaves it stands for nothing.
    mistaken = implausible and not (trusted and proof.nrmse_after > RIGHTED * proof.nrmse_before)
    if mistaken:
        place = where.Place(
            "plant", f"the plant's gain or a unit: {off:.4g} times as much per u", ()
        )
    elif implausible:
        place = where.Place("", "what was fitted is no machine, and explains nothing", ())
    said = "inconclusive" if implausible else said
    if said == "inconclusive" or (said == "unnamed" and proof.nrmse_after > proof.nrmse_before):
        # Nothing is claimed, no file holds it. (In one stood a dead zone of 43 N m and 62 % less mass.)
        augmented, proof = model, proof.withdrawn
    elif sizeless:
        stands = " and ".join(sizeless)
        notes.append(
            f"{stands} in augmented.toml: no size of its own is told, it stands in for another"
        )
    if DELAY in {standing.model.effects[index].name for index in told} and not model.controller:
        notes.append(LOGGED)
    raw = replace(quiet, trials=tuple(t.recorded for t in quiet.trials)).residuals(nominal) or []
    maps_before = where.maps(quiet, quiet.whiten(raw)) if raw else ()
    explained = lost.fitted.scene if lost else quiet
    left = (quiet.residuals(maps) if maps else explained.residuals(bare)) or []
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
        place = in_their_state(place, nameless, place.states)
    experiment = None
    if said != "nothing_missing" and not another and not observed:
        with suppress(InputError):  # limits too narrow for any move or wave
            heard = () if said == "unnamed" else told
            experiment = plan(standing.scene, standing.fit, outcome, nameless, heard)
    moved = corrections(standing) if bare is standing.model else ()
    # The formula is said of that machine, also where the map alone stands and no file holds it.
    if maps:
        moved = beside_maps(bare)
    elif said == "inconclusive":
        moved = ()
    gain = as_gain(standing) if told and said != "inconclusive" and bare is standing.model else None
    if gain is not None:
        notes.append(
            "mass, damping and stiffness are off by one and the same share: one number says as much, the "
            f"gain of the drive, {100.0 * gain:+.3g} %"
        )
    lowered = proof.nrmse_after < NOTICED * proof.nrmse_before
    if said == "nothing_missing" and lowered and not moved:
        notes.append(
            "the numbers of the linear part were moved together, none by three of its standard errors: "
            "what they lower the error to is augmented.toml's"
        )
    findings = tuple(
        finding(standing, index, outcome, model, none_of_them(said == "explained", left_over))
        for index in told
    )
    return Diagnosis(
        plant=model,
        augmented=augmented,
        verdict=said,
        place=place,
        findings=findings if said not in ("unnamed", "inconclusive") else (),
        corrections=moved,
        proof=proof,
        advice=(too_large(off),) if mistaken else _advice(said, place, experiment, model),
        experiment=experiment,
        soundness=health,
        steps=tuple(outcome.steps),
        judged=standing,
        maps_before=maps_before,
        maps_after=maps_after,
        notes=tuple(notes),
        nameless=nameless,
        pictures=_pictures(nameless),
        forces=where.forces(standing.scene, standing.model)
        if effects and bare is standing.model
        else None,
    )


def within_a_turn(model: Model) -> Model:
    """The same machine with the phases that were found told between -pi and pi, its free numbers by the
    same coordinates: errors are in their units."""
    theta = model.theta.copy()
    for k, c in enumerate(model.coordinates):
        if (
            c.kind == "effect"
            and EFFECTS[model.effects[c.effect].name].parameter(c.name).unit == "rad"
        ):
            theta[k] = math.remainder(theta[k], 2.0 * math.pi)
    return model if np.array_equal(theta, model.theta) else model.at(theta)


def _pictures(nameless: Contest) -> tuple[MapPicture, ...]:
    winner = nameless.winner
    if winner is None:
        return ()
    said = dict(enumerate(nameless.formulas))
    drawn = [
        picture(winner.scene, winner.free, k, said.get(k)) for k in range(len(winner.free.parts))
    ]
    return tuple(p for p in drawn if p is not None)


def _other_model(model: Plant) -> str:
    """What to try where the model is unlike the machine; not once more what it came from."""
    if not model.is_identified:
        return "identify a linear model of this machine first: ffl identify linear"
    return (
        "the model was identified from a recording that its form does not fit, feedback or strong "
        'physics in it: state what is known instead (mass or inertia as form = "czpk", and the '
        "[controller]), or identify from small motion, or without the controller"
    )


def _advice(
    said: str, place: where.Place, experiment: Experiment | None, model: Plant
) -> tuple[str, ...]:
    if said == "inconclusive" and "unlike" in place.where:
        return (_other_model(model),)
    if said == "inconclusive" and "hold" in place.where:
        begin = "record one wave at half and at full size: what does not scale is the physics"
        if not model.is_identified:
            begin = "begin with ffl identify linear"
        return (f"fit and judge by recordings over the same range, or {begin}",)
    out = [] if experiment is None else [experiment.advice]
    if said == "inconclusive" and not place.where.startswith(UNDECIDED):
        out.append(
            "what is left is louder than the noise that the plant file states, and nothing of the "
            "catalogue explains it: record standstill for the noise, and slow moves with reversals"
        )
    if said == "unnamed" and experiment is None:
        out.append(
            "record the same move twice: what comes back is the machine, what does not is not"
        )
    return tuple(out)


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


def faulty(model: Plant, health: sound.Soundness) -> Diagnosis:
    fault = health.faults[0]
    component = {"controller": "controller", "shift": "timing"}.get(fault.kind, "sensor")
    return _ended(
        model,
        health,
        f"{fault.recording}: {fault.where}",
        component,
        f"{fault.where}: {fault.mend}",
    )


def too_short(model: Plant, health: sound.Soundness, samples: int) -> Diagnosis:
    return _ended(
        model, health, "the length of the recording", "environment",
        f"{samples} samples cannot tell physics from noise: record at least {SHORTEST}, some seconds "
        "of motion with reversals",
    )  # fmt: skip


def _parted(standing: Judged, proof: Proof) -> bool:
    """Free runs of what was told by prediction are far off: those of a play may be, of a friction they are
    not. (A limit and a friction left 27 times what nothing did of a stage that friction held.)"""
    told = standing.predicted and "backlash" not in standing.model.names
    return told and proof.nrmse_after > PARTED * proof.nrmse_before


def unlike(model: Plant, health: sound.Soundness, why: str) -> Diagnosis:
    return _ended(
        model, health, why, "plant", _other_model(model)
    )  # fmt: skip

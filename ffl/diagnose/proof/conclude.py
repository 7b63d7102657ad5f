"""What a contest comes to: verdict, place, numbers, proof and advice, as one result."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.posterior import none_of_them
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.amounts import effect_values
from ffl.diagnose.hypothesis.corrections import as_gain, beside_maps, corrections
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.maps.freemodel import FreeModel, Running
from ffl.diagnose.maps.outcome import Contest
from ffl.diagnose.maps.picture import MapPicture, over_time, picture
from ffl.diagnose.maps.unnamed import compare
from ffl.diagnose.proof.advise import plan
from ffl.diagnose.proof.counsel import advice_of, other_model
from ffl.diagnose.proof.findings import finding
from ffl.diagnose.proof.prove import Proof, prove, run_plant, with_map, with_runs
from ffl.diagnose.proof.rules import Ended, Said, verdict_of
from ffl.diagnose.proof.verdict import BEYOND, in_their_state, rounding
from ffl.diagnose.recorded import sound, where
from ffl.diagnose.recorded.compared import stated_delay
from ffl.diagnose.recorded.mistaken import too_large
from ffl.diagnose.recorded.starts import with_starts
from ffl.diagnose.recorded.states import linear_share, states
from ffl.diagnose.recorded.warmth import with_warmth
from ffl.diagnose.result import Diagnosis, Finding, ModelCorrection
from ffl.effects import EFFECTS
from ffl.effects.linear_mechanics import as_seen
from ffl.errors import InputError
from ffl.machines.simulator import Simulation
from ffl.systems.plant import Plant
from ffl.systems.plant_file import plant_from_dict, plant_to_dict
from ffl.systems.state_space import Array

SHORTEST = 200  # samples: fewer cannot tell physics from noise
DELAY = "input_delay"
LOGGED = (
    "a u that was logged as much before y looks the same where no controller is stated: see that both "
    "columns have one clock"
)
EVEN = 0.5  # probability that it is a map elsewhere, where that explains as much
STRAIGHT = 1e-6  # of a formula's largest value: what is off by less is a proportion
NOTICED = 0.9  # of the nrmse before: an error that is lowered by less needs no word
HARDLY = 0.8  # of the nrmse: a map that leaves more takes hardly anything off
UNDONE = 0.3  # of a force by speed: what is left of it beside a damping that undoes it, at most


@dataclass(frozen=True)
class Stands:
    """What the answer's file and runs are made of: what stands in the contest, and the contest with the
    nameless where that was asked."""

    judged: Judged
    contest: Contest
    nominal: Model

    @property
    def maps(self) -> FreeModel | None:
        alone = self.contest.alone
        return alone.free if self.contest.verdict == "unnamed" and alone else None

    @property
    def bare(self) -> Model:
        """The model without maps."""
        if self.maps:
            return self.maps.model
        if self.contest.lost:
            return self.contest.lost.fit.model
        bursts_alone = self.contest.verdict == "unnamed" and self.judged.model.effects
        return self.nominal if bursts_alone else self.judged.model

    @property
    def named(self) -> bool:
        """It is what stands in the contest, and nothing without a name is in its place."""
        return self.bare is self.judged.model

    @property
    def scene(self) -> Scene:
        """The fitted recordings under the noise that is left."""
        winner, lost = self.contest.winner, self.contest.lost
        scene = winner.scene if winner else self.judged.scene
        return scene.like(lost.fitted.scene) if lost else scene

    def residuals(self) -> list[Array]:
        """What is left of the fitted recordings, commands that did not arrive taken as lost."""
        lost = self.contest.lost
        if self.maps or not lost:
            return self.scene.residuals(self.maps or self.bare) or []
        return lost.fitted.scene.residuals(self.bare) or []

    def plant(self, name: str) -> Plant:
        """As a plant file gives it, to the last bit."""
        bare = self.bare
        fitted = replace(as_seen(bare.plant(), len(bare.effects)), name=name)
        return plant_from_dict(plant_to_dict(fitted))


def conclude(
    model: Plant,
    nominal: Model,
    before: Sequence[Simulation],
    held: Scene,
    standing: Judged,
    outcome: Outcome,
    health: sound.Soundness,
    notes: Sequence[str],
    rng: Generator,
) -> Diagnosis:
    """The result: `model` as its file states it, `nominal` with its runs `before` on the held-out
    recordings `held`, the contest's `outcome` and the hypothesis `standing` after it."""
    turned = replace(standing.fit, model=within_a_turn(standing.model))
    standing = replace(standing, fit=turned)
    rounded = not standing.predicted and rounding(standing)
    if standing.predicted or rounded:  # nothing that is left says what is still missing
        there = "named" if standing.predicted or standing.model.effects else "nothing"
        nameless = Contest(there, None, None, 0.0, 0.0, None)
    else:
        scene = outcome.standing.scene.like(standing.scene)
        judging = (outcome.held or held).like(scene)
        nameless = compare(scene, judging, nominal, standing.fit, rng)
        first = outcome.steps[0].before if outcome.steps else standing
        if nameless.verdict == "nothing" and len(first.model.effects) < len(standing.model.effects):
            return conclude(model, nominal, before, held, first, outcome, health, notes, rng)
    stands = Stands(standing, nameless, nominal)
    fitted = stands.plant(model.name)
    proof, short = _proved(stands, fitted, held, before, rng)
    held, quiet = held.like(stands.scene), stands.scene
    ended = Ended(model, standing, nameless, proof, rounded, quiet.trials, held.trials)
    said = verdict_of(ended)
    stated = replace(fitted, controller=model.controller)  # not that which led it, or none
    worse = proof.nrmse_after > proof.nrmse_before
    if withdrawn := said.nothing_claimed or (said.verdict == "unnamed" and worse):
        # No file holds it. (In one stood a dead zone of 43 N m and 62 % less mass.)
        stated, proof = model, proof.withdrawn
    moved = _corrections(stands, said)
    notes = [*notes, *short, *said.notes, *_remarks(stands, said, withdrawn, proof, moved, model)]
    raw = replace(quiet, trials=tuple(t.recorded for t in quiet.trials)).residuals(nominal) or []
    maps_before = where.maps(quiet, quiet.whiten(raw)) if raw else ()
    left = stands.residuals()
    place = said.place
    if said.verdict != "nothing_missing":
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
    if said.verdict != "nothing_missing" and not ended.unlike and not held.observed:
        with suppress(InputError):  # limits too narrow for any move or wave
            heard = () if said.verdict == "unnamed" else said.told
            experiment = plan(standing.scene, standing.fit, outcome, nameless, heard)
    mistaken = said.nothing_claimed and ended.mistaken
    advice = advice_of(said.verdict, place, experiment, model)
    findings: tuple[Finding, ...] = ()
    if said.verdict != "unnamed" and not said.nothing_claimed:
        elsewhere = none_of_them(said.verdict == "explained", ended.loud, ended.far)
        elsewhere = max(elsewhere, EVEN if nameless.elsewhere else 0.0)
        findings = tuple(finding(standing, k, outcome, model, elsewhere) for k in said.told)
    seen = stands.named and standing.model.effects
    return Diagnosis(
        plant=model,
        augmented=stated,
        verdict=said.verdict,
        place=place,
        findings=findings,
        corrections=moved,
        proof=proof,
        advice=(too_large(ended.times),) if mistaken else advice,
        experiment=None if experiment is not None and experiment.idle else experiment,
        soundness=health,
        steps=tuple(outcome.steps),
        judged=standing,
        maps_before=maps_before,
        maps_after=where.maps(quiet, quiet.whiten(left)) if left else (),
        notes=tuple(notes),
        nameless=nameless,
        pictures=_pictures(stands),
        forces=where.forces(standing.scene, standing.model) if seen else None,
    )


def _proved(
    stands: Stands, fitted: Plant, held: Scene, before: Sequence[Simulation], rng: Generator
) -> tuple[Proof, list[str]]:
    """The proof of the `fitted` plant on the held-out recordings, and what it says of a map."""
    after = [run_plant(fitted, trial, held.observed) for trial in held.trials]
    judging, maps = held.like(stands.scene), stands.maps
    proof = prove(judging, before, after, stands.scene, rng, fitted, held.observed)
    if (same := stands.contest.repeats) is not None:
        runs = [stands.bare.simulate(trial) for trial in same.loaded(judging.trials)]
        return with_runs(proof, judging.trials, runs), []
    if maps is None:
        return proof, []
    begun = with_starts(judging, Running(maps))  # the start too was another's, who stands no more
    proof = with_map(proof, with_warmth(begun, maps), maps)
    left = proof.nrmse_with_map or 0.0
    share = left / max(proof.noise_floor, 1e-300)
    if share <= BEYOND:
        return proof, []
    notes = [f"the map leaves {share:.2g} times what noise alone would: it is not the whole of it"]
    if left > HARDLY * proof.nrmse_after:
        notes.append(
            "it takes hardly anything off: where it acts, and by what, is no more than a guess"
        )
    return proof, notes


def _corrections(stands: Stands, said: Said) -> tuple[ModelCorrection, ...]:
    """Numbers of the linear part; those of a formula are said beside it, also where no file holds them."""
    if stands.maps:
        return beside_maps(stands.bare)
    return corrections(stands.judged) if stands.named and not said.nothing_claimed else ()


def _remarks(
    stands: Stands,
    said: Said,
    withdrawn: bool,
    proof: Proof,
    moved: Sequence[ModelCorrection],
    model: Plant,
) -> Iterator[str]:
    """What a reader of the numbers ought to know of them."""
    if said.sizeless and not withdrawn:
        yield (
            f"{' and '.join(said.sizeless)} in augmented.toml: no size of its own is told, it stands in "
            "for another"
        )
    names = {stands.judged.model.effects[index].name for index in said.told}
    if DELAY in names and not model.controller:
        yield LOGGED
    if said.told and not said.nothing_claimed and stands.contest.elsewhere:
        yield (
            f"a map explains as much as {' and '.join(names)} ({stands.contest.elsewhere}): these "
            "recordings cannot tell which of the two it is"
        )
    able = said.told and not said.nothing_claimed and stands.named
    if able and (gain := as_gain(stands.judged)) is not None:
        yield (
            "all that the plant file has of mass, damping and stiffness is off by one and the same "
            f"share: one number says as much, the gain of the drive or the unit of u, {100.0 * gain:+.3g} %"
        )
    if said.verdict == "unnamed" and stands.maps and (undone := _undone(stands)):
        yield undone
    if said.verdict == "unnamed" and (lead := ahead(stands.contest)) is not None:
        late = stated_delay(model) * model.sample_time >= lead
        yield (
            f"y is {1e3 * lead:.3g} ms ({lead / model.sample_time:.2g} samples) ahead of what the model "
            "makes of u, whatever the motion: the columns were read at other moments of a sample, or u "
            "behind a filter; move y by so much"
        ) + ", or take it out of the delay in the plant file" * late
    lowered = proof.nrmse_after < NOTICED * proof.nrmse_before
    if said.verdict == "nothing_missing" and lowered and not moved:
        yield (
            "the numbers of the linear part were moved together, none by three of its standard errors: "
            "what they lower the error to is augmented.toml's"
        )


def ahead(contest: Contest) -> float | None:
    """By how many seconds y is early, where one map in proportion to the speed at the sensor is all that
    is found: to first order y(t + lead) = y + lead dy/dt."""
    winner = contest.winner
    if winner is None or len(winner.parts) != 1 or contest.variables != ("velocity",):
        return None
    said = contest.formulas[0] if contest.formulas else None
    if winner.parts[0].place.port != "output" or said is None or said.grid is None:
        return None
    assert said.values is not None  # over the grid
    lead = float(said.values @ said.grid) / float(said.grid @ said.grid)
    straight = np.abs(said.values - lead * said.grid).max() <= STRAIGHT * np.abs(said.values).max()
    return lead if straight and lead > 0.0 else None


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


def _pictures(stands: Stands) -> tuple[MapPicture, ...]:
    nameless = stands.contest
    if nameless.repeats is not None:
        return (over_time(nameless.repeats, stands.nominal.simulator),)
    winner = nameless.winner
    if winner is None:
        return ()
    said = dict(enumerate(nameless.formulas))
    drawn = [
        picture(winner.scene, winner.free, k, said.get(k)) for k in range(len(winner.free.parts))
    ]
    return tuple(p for p in drawn if p is not None)


def _undone(stands: Stands) -> str | None:
    """What a formula adds in proportion to the speed and a damping fitted beside it takes back. (Of a
    brake on a part of the way came one there that pushes 10.92 v everywhere, and 130 % more damping.)"""
    damping = stands.bare.corrections.get("damping")
    pushes = sum(f.pushes for f in stands.contest.formulas)
    if damping is None or not pushes:
        return None
    holds = effect_values(stands.bare, "damping")["coefficient"]
    if abs(pushes - holds) > UNDONE * abs(pushes):
        return None
    return (
        f"of the formula {pushes:.4g} velocity and the damping fitted beside it undo one another, to "
        f"{pushes - holds:+.2g} velocity: what is missing is the rest of the formula, beside the damping "
        "of the plant file"
    )


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
    components = {"controller": "controller", "shift": "timing", "machine": "plant"}
    component = components.get(fault.kind, "sensor")
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


def unlike(model: Plant, health: sound.Soundness, why: str) -> Diagnosis:
    return _ended(
        model, health, why, "plant", other_model(model)
    )  # fmt: skip

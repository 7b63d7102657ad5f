"""Find the missing physics: the chain of steps from recordings to a proven model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from ffl.diagnose.contest.bristles import as_bristle
from ffl.diagnose.contest.by_own_noise import by_own_noise
from ffl.diagnose.contest.chance import without_chance
from ffl.diagnose.contest.judging import Judged, judge
from ffl.diagnose.contest.line import across_the_line, against_the_refused, released
from ffl.diagnose.contest.plainest import plainest
from ffl.diagnose.contest.restraint import restrained
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.search import contest
from ffl.diagnose.contest.stated import let_free
from ffl.diagnose.contest.timing import late_otherwise
from ffl.diagnose.contest.unneeded import without_unneeded
from ffl.diagnose.ground import BLIND, LONG, Comparison, Ground, ground_of
from ffl.diagnose.hypothesis.harmonics import without_faint
from ffl.diagnose.noise.heard import with_modes_heard
from ffl.diagnose.noise.noise import SLOWEST
from ffl.diagnose.other_machine import of_another_machine
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
from ffl.diagnose.predict.parting import clearer, hunts, opened, parts
from ffl.diagnose.predict.rattling import with_rattling
from ffl.diagnose.proof.conclude import SHORTEST, conclude, faulty, too_short, unlike
from ffl.diagnose.recorded import sound
from ffl.diagnose.recorded.commands import as_limited
from ffl.diagnose.recorded.glitches import without_glitches, without_turns
from ffl.diagnose.recorded.mistaken import mistakes
from ffl.diagnose.recorded.others import with_others
from ffl.diagnose.recorded.repeating import repeating
from ffl.diagnose.recorded.signs import unfolded
from ffl.diagnose.recorded.starts import with_starts
from ffl.diagnose.recorded.trials import commanded, prepared
from ffl.diagnose.result import Diagnosis
from ffl.diagnose.time_base import off_clock
from ffl.diagnose.transmission.transmission import transmission
from ffl.errors import InputError
from ffl.recordings import Recording
from ffl.recordings.repeats import repeat_findings
from ffl.systems.plant import Plant

NEARLY_ALL = (
    0.05  # of what is left of recordings that judge: what a disturbance that repeats leaves
)
THRESHOLD = 25.0  # score that one more effect must bring (look-elsewhere: see reports)


ASKED = "what else was recorded was asked as well whether it drives the machine: {}"


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
    referred = any("r" not in r.missing and np.ptp(r.r) > 0.0 for r in everything)
    everything = [commanded(model, r) for r in everything]
    everything, glitches = without_glitches(model, everything)
    everything, notes = sound.injected_as_sent(model, everything)
    notes = [*turned, *glitches, *notes]
    everything, others = with_others(everything)
    notes += [ASKED.format(", ".join(others))] if others else []
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
        notes.append(_why_led(referred))
        return named(_led(model, recordings, validation), notes)
    found = named(Comparison(model, recordings, validation), list(notes))
    if hunts(found):
        say("free runs of this loop may part: looked at once more along the command as recorded")
        bare = replace(model, controller=None)
        seen = Comparison(bare, opened(recordings), opened(validation))
        if needs_observer(bare):
            seen = _led(bare, recordings, validation)
        return clearer(found, named(seen, list(notes)), rng)
    if not parts(found):
        return found
    say("free runs leave structure: looked at once more, led by an observer")
    firm = with_firm_observer(model)
    slow = max(SLOWEST, decay_of(firm) / (2 * np.pi))
    seen = Comparison(firm, led(recordings), led(validation), True, slow)
    return clearer(found, named(seen, list(notes)), rng)


def _why_led(referred: bool) -> str:
    """Why no free runs are shown, and what would allow them; `referred`: r was recorded."""
    way = (
        "that is usual in open loop; where a controller made u, a [controller] in the plant file and r in "
        "the recordings allow free runs"
    )
    if referred:
        way = (
            "r was recorded, but the plant file has no [controller] that makes u of it: with one the loop "
            "itself could be run freely"
        )
    return (
        "the plant integrates, and a free run from u alone drifts away: it was led along y by an observer "
        f"({way})"
    )


def _led(
    model: Plant, recordings: Sequence[Recording], validation: Sequence[Recording]
) -> Comparison:
    """Where the command was measured and the plant integrates."""
    decay = decay_for(recordings)
    leading, slow = with_observer(model, decay), decay / (2 * np.pi)
    return Comparison(leading, led(moving(recordings)), led(moving(validation)), True, slow)


def _named(
    stated: Plant,
    seen: Comparison,
    health: sound.Soundness,
    notes: list[str],
    rng: Generator,
    say: Callable[[str], None],
) -> Diagnosis:
    """What `stated` leaves out of the recordings, as they are `seen`."""
    fitted = len(seen.recordings)
    everything = [*seen.recordings, *seen.validation]
    signed = None if seen.folded else unfolded(seen.model, everything)
    if signed is not None:
        say(BLIND)
        seen = replace(seen, recordings=signed[:fitted], validation=signed[fitted:], folded=True)
    ground = ground_of(seen, notes, say)
    if ground is None:
        return unlike(seen.model, health, "the model's simulation diverges on these recordings")
    outcome = _contested(ground, notes, say)
    standing, held = outcome.standing, outcome.held or ground.held
    if standing.predicted:
        say(f"{standing.name}: foretells sample by sample what no free run does")
        standing = with_modes_heard(held, standing)
    else:
        if ground.cut:
            notes.append(
                f"more than {LONG} samples: named from stretches, fitted and judged on all"
            )
            say("fitting what was named to all samples")
            standing, held = _on_all_samples(ground, standing, held)
        standing, outcome = _looked_at_again(held, standing, outcome)
    if stated.controller is None and (fault := off_clock(ground, standing, say)):
        return faulty(stated, replace(health, faults=(fault,)))
    if fault := of_another_machine(ground, standing, say):
        return faulty(stated, replace(health, faults=(fault,)))
    held = with_starts(held.like(standing.scene), standing.model)
    nominal, own = ground.nominal, held.trials
    if ground.learned_anew:
        own = prepared(nominal.base.simulator, ground.validation, ground.prior.sensor)
    run = nominal.follow if held.observed else nominal.simulate
    before = [run(trial) for trial in own]
    if ground.learned_anew:
        nominal = ground.told.without(0)
    return conclude(stated, nominal, before, held, standing, outcome, health, notes, rng)


def _contested(ground: Ground, notes: list[str], say: Callable[[str], None]) -> Outcome:
    """Who stands after free runs, and after what is told by prediction alone."""
    scene, held, told, prior = ground.scene, ground.held, ground.told, ground.prior
    alone = judge(scene, held, told)
    same = repeating(scene, held, alone.model)
    if same is not None and same.left < NEARLY_ALL and same.sweeps:
        say("every recording has the same disturbance at the same time: no effect is looked for")
        return Outcome(alone, [], held, {})
    outcome = contest(scene, held, told, THRESHOLD, progress=say)
    if scene.work.done:
        notes.append(
            f"the search was ended after {scene.work.runs} simulations: more may be missing"
        )
    outcome = with_rattling(scene, held, outcome, told, prior, say)
    outcome = with_loose_head(scene, held, outcome, told, prior, say)
    outcome = with_free_runs(scene, held, outcome, prior, THRESHOLD, say)
    return with_dry_friction(scene, held, outcome, told, prior)


def _on_all_samples(ground: Ground, standing: Judged, held: Scene) -> tuple[Judged, Scene]:
    """What was named from stretches, fitted and judged on every sample, and what judges."""
    scene = replace(standing.scene, trials=ground.trials(ground.recordings))
    held = replace(held, trials=ground.trials(ground.validation))
    scene = with_starts(scene, standing.model)
    held = with_starts(held.like(scene), standing.model)
    return judge(scene, held, standing.model, rounds=5), held


def _looked_at_again(held: Scene, standing: Judged, outcome: Outcome) -> tuple[Judged, Outcome]:
    """What stands by free runs, after what the rounds of the contest could not ask of it."""
    names = standing.model.names
    standing = across_the_line(standing.scene, held, standing)
    standing, outcome = against_the_refused(held, standing, outcome)
    standing, outcome = late_otherwise(held, standing, outcome, names)
    standing, outcome = plainest(held, standing, outcome)
    standing, outcome = as_bristle(held, standing, outcome)
    standing = without_chance(held, without_faint(held, standing))
    standing = without_unneeded(held, let_free(held, standing))
    standing = with_modes_heard(held, standing)
    return released(by_own_noise(held, restrained(held, standing))), outcome


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

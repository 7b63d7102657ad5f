"""Backlash where the loop rattles, named by prediction instead of free-running simulation.

The contest judges by free runs. Around a coupling with play two free runs of one machine part (see
`switching`), so there the right answer with the right numbers leaves as much as none at all. Here
the play is fitted to what the switching filter leaves from sample to sample, the linear model's
corrections, mass ratio and contact damping beside it, and its likelihood stands against that of what
the contest came to: both are log p(y | r) of the same samples. Effects of the drive and of the scale that
the contest named are taken out of the recordings, their numbers free like the others.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.dry import DRY
from ffl.diagnose.contest.earning import SHARE
from ffl.diagnose.contest.evenly import of_no_mass
from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.line import SURE
from ffl.diagnose.contest.rounds import Outcome, Step
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.amounts import LINE, NAMES, claims, effect_values, netted, sizes
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import Place, places_of
from ffl.diagnose.maps.freeform import free_form
from ffl.diagnose.noise.noise import GUESSED, Noise, partly_coloured
from ffl.diagnose.noise.unrest import without_unrest
from ffl.diagnose.predict.balance import humming
from ffl.diagnose.predict.dry_forms import formed, plainly
from ffl.diagnose.predict.foretold import Foretold, Told, refitted
from ffl.diagnose.predict.joining import (
    Company,
    charged,
    clocked,
    contending,
    exchanged,
    in_place,
    in_step,
    joined,
    lost_to,
    needed,
    proven,
)
from ffl.diagnose.predict.moving import doubted, gap_at, masses, vague
from ffl.diagnose.predict.plain_spring import untightened
from ffl.diagnose.predict.play import (
    GLANCE,
    GRIDS,
    LOOK,
    LOOSENESS,
    PROMISES,
    Hypothesis,
    able,
    closed,
    regridded,
    settled,
    shortened,
)
from ffl.diagnose.predict.starting import started
from ffl.diagnose.recorded.trials import Trial
from ffl.diagnose.screen.candidate import Candidate
from ffl.effects.drift import SETTLES
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

QUIET = 2  # levels spared where what is left is no louder than stated noise
DAMPERS = (0.03, 0.1, 0.2, 0.4)  # of the command: what a damper on one side of a play may take
CLEAR = 60.0  # log-likelihood, fitted and held out, over what the contest came to
ROUGH = 25.0  # log-likelihood by which moments of contact make it so
BEHIND = 1000.0  # log-likelihood by which a play that is still to be fitted may be
# The same, of what its gap brings beside the same company. (Beside a drift that was begun with as a load
# 0.16, and right; beside liquid that sloshed 0.41, and nothing came of it.)
HOPE = 0.25
COMPANY = 0.5  # of what a gap brings: it may be behind by, as long as nobody else is beside it
HELD = tuple(0.125 * k for k in range(1, 13))  # of the mean command: a load to begin with
ZONES = tuple(0.125 * k for k in range(1, 9))  # of its width: a dead zone beside such a load
LEAST = 4.0 * ROUGH  # that a constant force, or a mass beyond the line, must bring
UNEXPLAINED = 2.0  # of the mean square of stated noise: what no named effect has left
PARTED = 0.01  # of the mismatch: less than free runs that part leave of it
SETTLED = 0.3  # of the longest recording: the time constant a force that settles begins with
SLIGHT = 0.01  # of the mass: what stands in for nobody
BELIEVED = 3.0  # times the noise of the plant file: louder is structure that is left


def with_rattling(
    scene: Scene,
    held: Scene | None,
    outcome: Outcome,
    told: Model,
    prior: Noise,
    say: Callable[[str], None] = lambda line: None,
) -> Outcome:
    """`outcome`, or, where a play in the coupling foretells fitted and held-out recordings clearly
    better than all that the contest named, that play with what the contest named of the drive and the
    scale; `told`: the model with no effect, `prior`: noise as the plant file states it."""
    if held is None or told.acting:
        return outcome
    if not all(np.all(np.isfinite(trial.u)) for trial in (*scene.trials, *held.trials)):
        return outcome
    standing = outcome.standing
    scene = replace(scene, noise=partly_coloured(prior))  # the contest's noise holds the rattle
    scene = clocked(scene, standing.scene.trials)
    held = clocked(held, (outcome.held or held).trials)
    left = scene.residuals(standing.model)
    if left is not None and followed(scene, left, told):
        return outcome
    loud = left is None or unexplained(scene, left, told, prior)
    rigid = len(told.base.simulator.mechanics.modes) == 1
    if not loud and (standing.model.effects or rigid):
        return outcome
    say("a play between motor and load is looked for from sample to sample")
    if rigid and _mapped(replace(standing.scene, noise=prior), outcome.held or held, told):
        return outcome
    levels: Sequence[float] = LOOSENESS if loud else LOOSENESS[QUIET:]
    scene, sines = humming(scene, told)
    named = standing.model.effects
    begun, levels = started(scene, told, named, sines, levels, GRIDS if loud else 1)
    if begun is None or (not loud and begun.scaled(scene.trials)[0] < standing.fitted):
        return outcome
    if hopeless(begun, scene, standing, lambda: beyond_prediction(begun, scene)[0]):
        return outcome
    if not brings(begun, scene):
        return outcome
    say("  a gap foretells what is left: fitted, and who is missing beside it?")
    found = settled(begun, scene, levels)
    brought = beyond_prediction(found, scene)[0]
    if brought < PROMISES or behind(found, scene, standing, COMPANY * brought):
        return outcome
    found = burdened(needed(found, scene.trials), scene)
    company = accompanied(found, scene, held.trials)
    scene = clocked(scene, company.trials)
    if behind(company.found, scene, standing):
        return outcome
    fewer = len(company.found.model.coordinates) < len(found.model.coordinates)
    behind_by = found.worth(scene.trials) - company.found.worth(scene.trials)
    if behind_by < (LEAST if fewer else 0.0):  # a plainer form need not foretell more
        found = settled(company.found, scene, LOOSENESS[1:])
    found = regridded(found, scene)
    found = massless(found, scene, refitted, ROUGH)
    company, found = plainly(company, crossed(found, scene, held.trials), scene.trials)

    def told_of(other: Hypothesis) -> Judged | None:
        other, fitted = other.in_its_noise(scene.trials)
        louder = max(other.noise.sensor / scene.noise.sensor, other.noise.force / scene.noise.force)
        on = replace(held, trials=in_step(other, held.trials, 0)) if scene.free_clocks else held
        return other.judged(scene, on, fitted, max(1.0, louder / BELIEVED))

    judged = told_of(found)
    if judged is None:
        return outcome
    before = replace(standing, held_out=held.like(standing.scene).by_free_run(standing.model))
    ahead = judged.held_out - before.held_out
    gains = (judged.score - before.score - ahead, ahead, *beyond_prediction(found, scene, held))
    if min(gains) < CLEAR:
        return outcome
    name = (*before.model.names, "nothing")[0]
    judged = replace(judged, fit=doubted(judged.fit, found, scene.trials, ROUGH))
    if vague(judged.model, judged.spread, judged.fit.covariance):
        return outcome
    step = Step(before, (), (judged,), judged)
    kept = {k: v for k, v in outcome.contenders.items() if k in judged.model.names}
    contenders = {
        "backlash": [("backlash", judged), (name, before)],
        **kept,
        **contending(company, found, judged, told_of),
    }
    return Outcome(judged, [*outcome.steps, step], outcome.held, contenders)


def brings(begun: Hypothesis, scene: Scene) -> bool:
    """Whether the gap foretells better than none where all other numbers are free in either: beside a model
    whose numbers are slightly off a grid of gaps always holds a better one."""
    trials = shortened(scene, GLANCE)
    bare = closed(begun, trials)
    bare = refitted(bare, trials, fixed=(gap_at(bare.model),))  # its start was further off
    return refitted(begun, trials).worth(trials) > bare.worth(trials) + PROMISES


def accompanied(
    found: Hypothesis, scene: Scene, judging: Sequence[Trial] = ()
) -> Company[Hypothesis]:
    """`found` with who else is missing beside it, on fewer samples; `judging`: recordings that nothing is
    fitted to. (A gain by position beside a play was told as 4.9 % more mass.)"""
    short = tuple(shortened(scene, LOOK))
    judging = tuple(shortened(replace(scene, trials=tuple(judging)), LOOK)) if judging else ()

    def again(point: Hypothesis, trials: Sequence[Trial]) -> Hypothesis:
        return settled(point, replace(scene, trials=tuple(trials)), LOOSENESS[1:])

    def further(company: Company[Hypothesis]) -> list[Candidate]:
        return dampers(company.found, scene)

    company = Company(*settling(found, short, judging, again, scene.free_clocks), judging=judging)
    came = joined(company, scene, able, again, further, barer)
    stayed = proven(came, again)
    # One who left leaves better numbers, from which another may be seen.
    if stayed.found.model.names != came.found.model.names:
        stayed = proven(joined(stayed, scene, able, again, further), again)
    return untightened(formed(exchanged(stayed, again), again), again)


def barer(found: Hypothesis) -> Hypothesis | None:
    """`found` with the mass of the plant file and no dry friction: either was begun with as the grid and
    the balance of forces had it, with nobody else beside the play. None where that is as found."""
    model = found.model
    for name in model.names:
        if name in DRY:
            model = model.without(model.names.index(name))
    theta, own = model.theta.copy(), masses(model)
    if len(model.effects) == len(found.model.effects) and not np.any(np.abs(theta[own]) > SLIGHT):
        return None
    theta[own] = 0.0
    return replace(found, model=model.at(theta))


def dampers(found: Hypothesis, scene: Scene) -> list[Candidate]:
    """A damper on one side of the play, at sizes of its force from a little to half of the command's: to
    first order the whole machine's own is the same, and no screen tells them apart."""
    name = NAMES["damping"]
    places = [p for p in places_of(found.model) if p.mass_ratio is None]
    left = found.fit(scene.trials) if len(places) > 1 and name not in found.model.names else None
    if left is None:
        return []
    speed = np.concatenate([np.gradient(t.y, t.sample_time) for t in scene.trials])
    command = np.concatenate([t.u for t in scene.trials])
    rate = float(np.std(command) / np.std(speed)) * found.model.base.simulator.force_per_input
    out = []
    for place in places:
        sizes = [{"coefficient": rate * share} for share in DAMPERS]
        first, *rest = (EffectSpec(name, size, place.options) for size in sizes)
        out.append(Candidate(first, 0.0, 1, place, left, valleys=tuple(rest)))
    return out


def unexplained(scene: Scene, left: Sequence[Array], told: Model, prior: Noise) -> bool:
    """Whether what is `left` is louder than the noise of the plant file, or where that states none for
    the force, than there may be. (Of a vehicle under water with drag and 0.5 N of noise, which a guess took
    for 0.045 N, 8.6 times the noise was left by the truth, and a play was looked for.)"""
    noise = prior
    if not told.base.plant.machine.force_noise:
        noise = replace(prior, force=GUESSED * prior.force)
    return float(np.mean(replace(scene, noise=noise).whiten(left) ** 2)) > UNEXPLAINED


def followed(scene: Scene, left: Sequence[Array], told: Model) -> bool:
    """Whether free runs of what stands follow the recordings: what is `left` is next to nothing of what the
    model alone leaves. (Plays that only prediction names had 57 to 99 % left between two masses, 2.9 to
    89 % at a measuring head; gravity of an arm 0.5 %, friction of a drive 0.2 %.)"""
    alone = scene.residuals(told)
    if alone is None:
        return False
    some, whole = (float(np.mean(scene.whiten(e) ** 2)) for e in (left, alone))
    return some < PARTED * whole


def beyond_prediction(found: Hypothesis, fitted: Scene, *others: Scene) -> list[float]:
    """What the gap brings over the same company without one, on the recordings `fitted` and on `others`,
    both foretold from sample to sample: free runs of a loop that cycles part by themselves, with a play in
    it or not."""
    bare = closed(found, fitted.trials)
    return [found.scaled(g.trials)[0] - bare.scaled(g.trials)[0] for g in (fitted, *others)]


def behind(found: Foretold, scene: Scene, standing: Judged, by: float = 0.0) -> bool:
    """Whether the play foretells less than what stands already, `by` more than that: before it is fitted it
    may by a little, after that company will not bring it ahead. (Five that came to stand were 65 behind to
    9,520 ahead before, and 2,969 to 18,859 ahead after; on a motor that cogs, beside a coarse converter and
    on a stage with another play they were 2,741 to 4,282 behind before, and up to ten minutes went there.)
    """
    return found.scaled(scene.trials)[0] < standing.fitted - by


def hopeless(begun: Foretold, scene: Scene, standing: Judged, brought: Callable[[], float]) -> bool:
    """Whether a play that was begun with is farther behind what stands than its gap, which `brought` so
    much over none, and who is missing beside it, will make up for. (Of what is measured, beside an eddy
    brake on a printer: 10,430, of which a gap of 11.9 um brought 776; to find who was missing took
    minutes. Three that were there were 3,700 to 14,600 ahead before anybody had joined.)"""
    if not behind(begun, scene, standing, BEHIND):
        return False
    return behind(begun, scene, standing, HOPE * brought())


def burdened(found: Hypothesis, scene: Scene) -> Hypothesis:
    """With a constant force where it foretells clearly better: free runs that part leave it unseen, or put
    it into the play, or into a dead zone of a command that holds it up. (A load of 3.77 N stood as a zone
    three times its width: on the way from there to both, every number is worse than its neighbours.)"""
    if "constant_load" in found.model.names:
        return found
    commands = np.concatenate([trial.u for trial in scene.trials])
    held = -float(np.mean(commands)) * found.model.base.simulator.force_per_input  # what u holds up
    tried = []
    for place in places_of(found.model):
        sizes = itertools.product(HELD, ZONES if "dead_zone" in found.model.names else (1.0,))
        begun = [_with_load(found, held * share, place, zone) for share, zone in sizes]
        tried.append(refitted(max(begun, key=lambda h: h.worth(scene.trials)), scene.trials))
    best = max(tried, key=lambda h: h.worth(scene.trials))
    if best.worth(scene.trials) < found.worth(scene.trials) + max(SHARE * scene.samples, LEAST):
        return found
    return settled(best, scene, (1.0,))


def _with_load(found: Hypothesis, force: float, place: Place, zone: float) -> Hypothesis:
    """`found` with a load of `force` before its play, and its dead zones at `zone` of their width."""
    effects = [
        replace(e, parameters={k: zone * v for k, v in e.parameters.items()})
        if e.name == "dead_zone"
        else e
        for e in found.model.effects
    ]
    effects.insert(-1, EffectSpec("constant_load", {"force": force}, place.options))
    return replace(found, model=replace(found.model, effects=tuple(effects)))


def settling(
    found: Hypothesis,
    trials: tuple[Trial, ...],
    judging: Sequence[Trial],
    again: Callable[[Hypothesis, Sequence[Trial]], Hypothesis],
    free_clocks: bool,
) -> tuple[Hypothesis, tuple[Trial, ...]]:
    """`found` with a force that settles in the place of its constant one, all numbers found `again`, where
    that foretells clearly better, and the trials on the clocks that suit it. (-7.4 N that took 3.8 s stood
    as a load, a spring and a damper: 3,600 behind in what was fitted, 4,400 in what judges.)"""
    load = next((s for s in found.model.effects if s.name == "constant_load"), None)
    if load is None or "drift" in found.model.names:
        return found, trials
    slow = SETTLED * max(trial.t[-1] - trial.t[0] for trial in trials)
    values = {"amplitude": load.parameters["force"], "time_constant": slow}
    drift = EffectSpec("drift", values, {**load.options, "kind": SETTLES})
    other = in_place(found, load.name, drift)
    on = in_step(other, trials, 1) if free_clocks else trials
    other, found = again(other, on), again(found, trials)
    ahead = charged(other, on) - charged(found, trials)
    return (other, on) if ahead - lost_to(found, other, judging) > LEAST else (found, trials)


def massless(
    found: Told, scene: Scene, again: Callable[[Told, Sequence[Trial]], Told], rough: float
) -> Told:
    """`found` with its gain by position told from where no mass is left beyond the line, all numbers found
    `again`, if that foretells as well but for what is `rough`."""
    moved = of_no_mass(found.model, scene.trials)
    if moved is None:
        return found
    there = again(replace(found, model=moved), scene.trials)
    return there if there.worth(scene.trials) > found.worth(scene.trials) - rough else found


def crossed(found: Told, scene: Scene, judging: Sequence[Trial] = ()) -> Told:
    """With a mass or damping beyond the contract's line as the effect it is, where it foretells best, and
    clearly better than on the line, by what it loses in recordings that are `judging` as well; free runs of
    a loop that rattles would not find the way. One that an effect of its kind undoes goes with it."""
    for name in ("mass", "damping"):
        if (net := netted(scene, found.model, name)) is not None:
            found = refitted(replace(found, model=net), scene.trials)
        model, fit = found.model, found.fit(scene.trials)
        size = sizes(scene, model).get(name, 0.0)
        if fit is None or NAMES[name] in model.names or not claims(name, size):
            continue
        value = model.corrections[name]
        if abs(value) < SURE * fit.spread_of(name):
            continue
        held, on_line = model.held | {name}, {**model.corrections, name: value * LINE / abs(size)}
        within = replace(found, model=replace(model, corrections=on_line, held=held))
        within = refitted(within, scene.trials)
        least = LEAST + lost_to(within, found, judging)
        if found.worth(scene.trials) < within.worth(scene.trials) + least:
            continue
        corrections = {k: v for k, v in model.corrections.items() if k != name}
        bare = replace(model, corrections=corrections, held=held)
        places = [Place("force", "all")] if name == "mass" else places_of(model)
        tried = []
        for place in places:
            spec = EffectSpec(NAMES[name], effect_values(model, name), place.options)
            effects = (*model.effects[:-1], spec, model.effects[-1])
            joined = replace(found, model=replace(bare, effects=effects))
            tried.append(joined if name == "mass" else refitted(joined, scene.trials))
        found = max(tried, key=lambda h: h.worth(scene.trials))
    return found


def _mapped(scene: Scene, held: Scene, told: Model) -> bool:
    """Free runs with a map follow the recordings nearly to the noise of `scene`: nothing rattles there. (A
    rubber stop on a rigid stage is foretold by a play as well, sample by sample.)"""
    calm, judging = without_unrest(scene), without_unrest(held)
    maps = free_form(calm, judging, told)
    if not maps or not maps[-1].parts:
        return False
    left = [ground.residuals(maps[-1].free) for ground in (calm, judging)]
    return all(
        e is not None and np.mean(ground.like(calm).whiten(e) ** 2) < UNEXPLAINED
        for ground, e in zip((calm, judging), left, strict=True)
    )

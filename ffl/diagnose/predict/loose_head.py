"""A play of the measuring head in a loop that cycles across it, named by prediction.

The contest judges by free runs; a loop that cycles across a play of what it measures parts from a recording
within a second, right in every number. From sample to sample the head tells all the while on which side of
the play the machine pushes it (`slipping`): the play is fitted to what that filter leaves, with who else is
missing beside it (`joining`), and stands against what the contest came to by log p(y | r) of the same
samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.rounds import Outcome, Step
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.amounts import NAMES
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import of_the_machine
from ffl.diagnose.noise.noise import Noise, louder, partly_coloured
from ffl.diagnose.predict.balance import humming, rubbing
from ffl.diagnose.predict.company import along, separable
from ffl.diagnose.predict.dry_forms import formed, plainly
from ffl.diagnose.predict.foretold import refitted
from ffl.diagnose.predict.joining import (
    LEAST,
    Company,
    clocked,
    contending,
    exchanged,
    in_step,
    joined,
    proven,
)
from ffl.diagnose.predict.moving import bracketed, doubted, gap_at, long_tables, moved, vague
from ffl.diagnose.predict.plain_spring import untightened
from ffl.diagnose.predict.play import GLANCE, LOOK, LOOSENESS, PROMISES, loosened, shortened
from ffl.diagnose.predict.rattling import (
    BELIEVED,
    CLEAR,
    crossed,
    followed,
    hopeless,
    massless,
    unexplained,
)
from ffl.diagnose.predict.slipping import FORMS, LINEAR, Slip, finer
from ffl.diagnose.recorded.trials import Trial
from ffl.systems.plant import EffectSpec

GRID = np.geomspace(1e-4, 0.03, 48)  # of the travel: valleys are narrow, and many
MOVES = (0.02, 0.004, 0.001)  # relative, of a gap that others have joined
TRIES = 10  # moves either way
POLISH = (0.1, 0.03, 0.01)  # of the numbers of all effects, at the end
BRACKETED = 1000.0  # log-likelihood by which half of a gap, and half as much again, must be behind
JUMPS = 100.0  # log-likelihood by which moments of contact make it rough
LEVELS = (1.0, 10.0)  # times the force noise, under which a gap is looked for
STARTS = 4  # companies whose best gap of the grid is fitted


def with_loose_head(
    scene: Scene,
    held: Scene | None,
    outcome: Outcome,
    told: Model,
    prior: Noise,
    say: Callable[[str], None] = lambda line: None,
) -> Outcome:
    """`outcome`, or, where a play of the measuring head foretells fitted and held-out recordings clearly
    better than all that the contest named, that play with who else is missing; `told`: the model with no
    effect, `prior`: noise as the plant file states it."""
    standing = outcome.standing
    if held is None or told.acting or standing.predicted or scene.plain or told.base.is_process:
        return outcome
    if not all(np.all(np.isfinite(trial.u)) for trial in (*scene.trials, *held.trials)):
        return outcome
    scene = replace(scene, noise=partly_coloured(prior))
    left = scene.residuals(standing.model)
    if left is not None and (
        not unexplained(scene, left, told, prior) or followed(scene, left, told)
    ):
        return outcome
    say("a play of what is measured is looked for from sample to sample")
    scene, sines = humming(scene, told)
    begun = start(scene, told, standing.model, sines)
    if begun is None or hopeless(begun, scene, standing, partial(brought, begun, scene)):
        return outcome
    if spared(begun, scene, standing.model):
        return outcome
    short = tuple(shortened(scene, LOOK))
    judging = tuple(shortened(held, LOOK))
    begun, scene = whitened(begun, scene, prior, short)
    say(f"  {_told(begun)} begun; who is missing beside it?")
    company = Company(regapped(begun, short), short, judging=judging)
    company = joined(company, scene, able, regapped)
    company = formed(exchanged(proven(company, regapped), regapped), regapped)
    company = untightened(company, regapped)
    company = proven(company, regapped)  # who stood in for another form of friction
    loud, quiet = company.found, quieter(company.found, scene.noise, short)
    company = replace(company, found=quiet)
    if quiet.noise != loud.noise:  # who made up for what the louder noise let pass leaves
        company = proven(company, regapped)
    scene = clocked(scene, company.trials)
    trials = scene.trials
    say(f"  {_told(company.found)}: fitted to all samples")
    company, found = plainly(company, claimed(polished(company.found, trials), scene), trials)
    found = finer(found, trials)

    def told_of(found: Slip) -> Judged | None:
        return _judged(found, scene, held, trials, prior)

    judged, bare = told_of(found), told_of(closed(found, trials))
    if judged is None or bare is None:
        return outcome
    before = replace(standing, held_out=held.like(standing.scene).by_free_run(standing.model))
    gains = [
        b - a for one in (bare, before) for a, b in zip(_worth(one), _worth(judged), strict=True)
    ]
    if min(gains) < CLEAR:
        return outcome
    judged = replace(judged, fit=doubted(judged.fit, found, trials, JUMPS))
    wide = not vague(judged.model, judged.spread, judged.fit.covariance)
    if not wide and not bracketed(found, trials, BRACKETED):
        return outcome
    name = (*before.model.names, "nothing")[0]
    contenders = {
        "backlash": [("backlash", judged), (name, before)],
        **contending(company, found, judged, told_of),
    }
    steps = [*outcome.steps, Step(before, (), (judged,), judged)]
    return Outcome(judged, steps, judged.held, contenders)


def able(spec: EffectSpec) -> bool:
    """Whether the filter can take the effect beside the play; a mass or damping is the model's own number
    until it crosses the line."""
    if spec.name in NAMES.values():
        return False
    return spec.name in LINEAR or spec.name in FORMS or along(spec) or separable(spec)


def start(scene: Scene, told: Model, stood: Model, sines: Sequence[EffectSpec] = ()) -> Slip | None:
    """The best gap of a grid, fitted, under the noise that suits it better, beside dry friction as the
    balance of forces has it, what was named of the drive, or nothing; None where no gap foretells better
    than none. (Who else is missing hides a play where the filter trusts a model without it; more force
    noise lets it follow. Alone, 10 um; beside that friction 0.685 mm, of 0.565 mm and a Stribeck curve.)"""
    trials, travel = shortened(scene, GLANCE), told.base.travel
    if Slip(told, scene.noise).predict(trials) is None:
        return None
    bare = _beside(scene, told, stood, sines)
    begun: list[tuple[float, Slip]] = []
    for loose in LEVELS:
        noise = loosened(scene.noise, loose)
        none = [Slip(model, noise) for model in bare]
        near = []
        for model in bare:
            grid = [_with_gap(model, gap * travel, noise) for gap in GRID]
            near.append(max(((h.worth(trials), h) for h in grid), key=lambda pair: pair[0]))
        near.sort(key=lambda pair: -pair[0])
        if near[0][0] <= max(h.worth(trials) for h in none):
            continue
        least = max(refitted(h, trials).worth(trials) for h in none)
        fitted = [refitted(rescanned(h, trials), trials) for _, h in near[:STARTS]]
        best = max(((h.worth(trials), h) for h in fitted), key=lambda pair: pair[0])
        if best[0] > least + PROMISES:
            begun.append(best)
    return max(begun, key=lambda pair: pair[0])[1] if begun else None


def _beside(scene: Scene, told: Model, stood: Model, sines: Sequence[EffectSpec]) -> list[Model]:
    """Models beside which a gap is looked for: the bare one, with the numbers that `stood`, a sine, a load
    or dry friction as the balance of forces has it at either place, what was named of the drive, and all
    that was named that the filter can take."""
    models = [told, replace(told, corrections=stood.corrections)]
    models += [told.with_effect(sine) for sine in sines]
    places = [p for p in of_the_machine(told) if p.mass_ratio is None]
    rubs = [force for force in rubbing(scene.trials, told) if able(force)]
    models += [told.with_effect(replace(f, options=p.options)) for f in rubs for p in places]
    whole = tuple(spec for spec in stood.effects if able(spec) and spec.name != "backlash")
    apart = tuple(spec for spec in whole if separable(spec))
    for named in (apart, whole) if len(whole) > len(apart) else (apart,):
        models += [replace(told, corrections=stood.corrections, effects=named)] if named else []
    return models


def spared(begun: Slip, scene: Scene, stood: Model) -> bool:
    """Whether what the contest named foretells better than the play alone, and no play beside it better
    still: then no play is looked for with who else is missing."""
    trials = shortened(scene, GLANCE)
    company = tuple(spec for spec in stood.effects if able(spec))
    bare = refitted(Slip(replace(stood, effects=company), scene.noise), trials)
    worth = bare.worth(trials)
    if not company or not worth > begun.worth(trials) + PROMISES:
        return False
    travel = stood.base.travel
    grid = [_with_gap(bare.model, gap * travel, scene.noise) for gap in GRID]
    best = max(grid, key=lambda h: h.worth(trials))
    return refitted(rescanned(best, trials), trials).worth(trials) < worth + PROMISES


def regapped(found: Slip, trials: Sequence[Trial]) -> Slip:
    """All numbers but for `long_tables` fitted again under less and less force noise beyond its own,
    the gap by itself before: who was missing may have been in it, and where the filter is sure its valleys
    are many and narrow."""
    noise, begun = found.noise, found
    for loose in LOOSENESS[1:]:
        found = replace(found, noise=loosened(noise, loose))
        found = refitted(rescanned(found, trials), trials, long_tables(found.model))
    best = max((begun, found), key=lambda h: h.worth(trials))
    return refitted(moved(best, trials, POLISH), trials, long_tables(best.model))


def whitened(
    begun: Slip, scene: Scene, prior: Noise, trials: Sequence[Trial]
) -> tuple[Slip, Scene]:
    """`begun` and `scene` under noise of which none is slow, where that foretells better. (A gap of 8.02 um
    and a lag of 0.94 ms on a spring that rings at 30 Hz, all noise white: 7.86 um, 0.46 ms and a damping of
    1.4 times its own more where half of the noise is taken for slower than 30 Hz; 8.00 um, 0.91 ms and 8 %
    as it is, 615 ahead.)"""
    loose = begun.noise.force / scene.noise.force
    other = refitted(replace(begun, noise=loosened(prior, loose)), trials)
    if other.worth(trials) <= begun.worth(trials):
        return begun, scene
    return other, replace(scene, noise=prior)


def quieter(found: Slip, noise: Noise, trials: Sequence[Trial]) -> Slip:
    """`found`, or under the stated `noise` where that foretells better: what was missing when the play was
    looked for passed for force noise."""
    other = regapped(replace(found, noise=noise), trials)
    return max((found, other), key=lambda h: h.worth(trials))


def polished(found: Slip, trials: Sequence[Trial]) -> Slip:
    """All numbers fitted to all samples."""
    found = refitted(rescanned(found, trials), trials)
    return refitted(moved(found, trials, POLISH[1:]), trials)


def rescanned(found: Slip, trials: Sequence[Trial]) -> Slip:
    """The gap moved, first to the best valley near, then as long as that helps."""
    at = gap_at(found.model)

    def times(share: float) -> Slip:
        theta = found.theta
        theta[at] *= share
        return found.at(theta)

    worth = found.worth(trials)
    for size in MOVES:
        near = [times(1.0 + k * size) for k in range(-TRIES, TRIES + 1) if k]
        best = max(near, key=lambda h: h.worth(trials))
        if (value := best.worth(trials)) > worth:
            found, worth = best, value
    return found


def claimed(found: Slip, scene: Scene) -> Slip:
    """`found` with a mass or damping beyond the contract's line as the effect it is, where without it the
    recordings are foretold clearly worse."""
    found = massless(found, scene, polished, LEAST)
    other = crossed(found, scene)
    beyond = {
        k for k, name in NAMES.items() if name in set(other.model.names) - set(found.model.names)
    }
    corrections = {k: v for k, v in found.model.corrections.items() if k not in beyond}
    model = replace(found.model, corrections=corrections, held=found.model.held | beyond)
    told = polished(replace(found, model=model), scene.trials) if beyond else found
    return other if other.worth(scene.trials) > told.worth(scene.trials) + LEAST else found


def closed(found: Slip, trials: tuple[Trial, ...]) -> Slip:
    """The same company without the play, all else fitted again. (What a friction in proportion to the load
    did within samples of 2 ms was a play of 0.17 um beside a table: 2,600 ahead of the table by steps of a
    sample, 970 behind it by halves of one.)"""
    bare = replace(found, model=replace(found.model, effects=found.model.effects[:-1]))
    return finer(refitted(bare, trials), trials)


def _told(found: Slip) -> str:
    """The gap and its company, in words."""
    *others, _ = found.model.names
    gap = f"a gap of {found.model.effects[-1].parameters['gap']:.3g}"
    return f"{gap} beside {', '.join(others)}" if others else gap


def brought(found: Slip, scene: Scene) -> float:
    """What the play brings over the same company without it."""
    trials = tuple(scene.trials)
    return found.scaled(trials)[0] - closed(found, trials).scaled(trials)[0]


def _with_gap(model: Model, gap: float, noise: Noise) -> Slip:
    spec = EffectSpec("backlash", {"gap": float(gap)}, {"kind": "play"})
    return Slip(replace(model, effects=(*model.effects, spec)), noise)


def _judged(
    found: Slip, scene: Scene, held: Scene, trials: tuple[Trial, ...], prior: Noise
) -> Judged | None:
    """As a hypothesis of the contest, on the clocks that suit it."""
    found, fitted = found.in_its_noise(trials)
    if scene.free_clocks:
        held = replace(held, trials=in_step(found, held.trials, 0))
    scene = replace(scene, trials=trials)
    return found.judged(scene, held, fitted, max(1.0, louder(found.noise, prior) / BELIEVED))


def _worth(judged: Judged) -> tuple[float, float]:
    """Of the fitted recordings, its numbers charged, and of the held-out ones."""
    return judged.score - judged.held_out, judged.held_out

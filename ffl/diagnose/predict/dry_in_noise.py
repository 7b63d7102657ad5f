"""Dry friction where noise decides when a machine lets go, told by prediction.

The contest judges by simulations without noise. Near standstill noise moves a machine that a simulation
holds, and smooths the friction: free runs then ask for a fraction of its level, or for a damping in its
place, and for the form that bends best. (A level of 0.68 N in the mean came out as 0.38 N, under force
noise of 0.38 N.) Here every form is fitted to what a filter that sticks and slips (`slipping`) leaves
from sample to sample, corrections of the linear model beside it. Without friction the filter's
likelihood is that of whitening; the friction must be the likelier by either measure.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ffl.diagnose.contest.dry import BY_DIRECTION, CREEPING, DRY, PLIABLE, level_of, plain_form
from ffl.diagnose.contest.earning import SHARE
from ffl.diagnose.contest.judging import Judged, credible
from ffl.diagnose.contest.line import crosses
from ffl.diagnose.contest.plainest import CONTACT, in_the_mean, unseen
from ffl.diagnose.contest.rounds import Outcome, Step
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.settle import LITTLE, SUBSTITUTE
from ffl.diagnose.hypothesis.amounts import claims, sizes
from ffl.diagnose.hypothesis.model import STIFF, Model
from ffl.diagnose.hypothesis.places import POINT, places_of
from ffl.diagnose.noise.noise import Noise, louder, partly_coloured
from ffl.diagnose.noise.spread import error_of
from ffl.diagnose.predict.company import along, separable
from ffl.diagnose.predict.foretold import FIRST, best_of, of_others, refitted
from ffl.diagnose.predict.play import GLANCE, LOOK, shortened
from ffl.diagnose.predict.slipping import FORMS, LINEAR, PARTS, Slip, finer
from ffl.diagnose.predict.smooth_table import smoothed
from ffl.diagnose.recorded.trials import Trial
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

PASSES = frozenset({"viscous_friction", "quadratic_drag"})  # for dry friction in noise
CLEAR = 12.0  # log-likelihood, in the mean of fitted and held out, over none and over free runs
ALSO = 4.0  # of it in either
LED = 500.0  # log-likelihood by which free runs of a friction are ahead where no other form will be
HOPELESS = 200.0  # the same of a friction that bends the linear part, and is not worth another fit
ALIKE = 0.25  # of a level, between the same friction under two noises
STILL = 0.02  # of a level that stands: force noise below it smooths nothing
HINT = 4.0  # of it that plain friction must bring for its other forms to be tried
DAMPING, SURE = "micro_damping", 5.0  # of a contact, and of its standard errors that show it
TRUSTED = 1.5  # times the stated noise: a filter that needs more leaves more than noise
LEVELS = np.geomspace(0.01, 1.0, 8)  # of the RMS force
# Stribeck friction is begun with so much of a plain level, sliding and at rest, falling over so much of the
# RMS speed. (One of 0.048 and 0.073 V and 0.0013 m/s, a plain level of 0.070 V and a damping of ten times
# less than nothing: begun from 0.9 alone it settled at 0.087 V and 5 um/s, 15 behind where it belongs.)
SHARES = ((0.9, 1.5), (0.6, 1.1))
FALLS = (0.03, 0.1, 0.3, 1.0)
YIELDS = (5e-4, 2e-3, 1e-2, 3e-2)  # of the travel
KNOTS = 9  # of a table
LIKELIEST = 3  # starts without friction that are fitted
# Log-likelihood of a part of the samples: a contact that yields and brings less, and takes as long as
# all other forms together, is not fitted on.
LEAN = 1.0
# Of what friction brings, that a table as smooth as is believed must bring beyond other forms.
CURVED = 0.025
LEAST = 0.005  # of what friction brings: true curves brought 0.04 and 0.07, a false one 0.002
FOOTING = 50.0  # nats a recording: more is no matter of where it begins


def with_dry_friction(
    scene: Scene, held: Scene | None, outcome: Outcome, told: Model, prior: Noise
) -> Outcome:
    """`outcome`, or, where a dry friction foretells fitted and held-out recordings clearly better than what
    stands in its place, that friction; `told`: the model with no effect, `prior`: noise as the plant file
    states it."""
    standing = outcome.standing
    if held is None or told.acting or standing.predicted:
        return outcome
    company = _company(standing.model)
    if company is None:
        return outcome
    if scene.plain or scene.observed or not told.base.plant.machine.states_noise:
        return outcome
    if _still(standing.model, prior):
        return outcome
    scene, held = (
        replace(scene, trials=standing.scene.trials),
        standing.held or outcome.held or held,
    )
    if not all(np.all(np.isfinite(trial.u)) for trial in (*scene.trials, *held.trials)):
        return outcome
    told = replace(told, effects=company)
    begun = replace(told, corrections=standing.model.corrections)
    noises = (prior, partly_coloured(prior), standing.scene.noise)
    if _led_by_free_runs(scene, held, standing, (told, begun), noises):
        return outcome
    found = _clear(scene, held, standing, (told, begun), noises)
    if found is None:
        return outcome
    name = found[0].model.names[-1]
    if name in standing.model.names and (name in PLIABLE or _damped(standing, name)):
        return outcome  # free runs have made more of it than the filter can
    if louder(found[0].scene.noise, prior) > TRUSTED:  # then under the stated noise as well
        sure = _clear(scene, held, standing, (told, begun), noises[:2], alike=found[0])
        if sure is None or louder(sure[0].scene.noise, prior) > TRUSTED:
            return outcome
        found = found if _alike(found[0], sure[0]) else sure
    best, before, rivals = found
    name = best.model.names[-1]
    stood = next((n for n in before.model.names if n in DRY | PASSES), "nothing")
    kept = {k: v for k, v in outcome.contenders.items() if k in best.model.names}
    others = [(one.model.names[-1], one) for one in rivals]
    contenders = {**kept, name: others if stood in FORMS else [*others, (stood, before)]}
    step = Step(before, (), (best,), best)
    return Outcome(best, [*outcome.steps, step], outcome.held, contenders)


def _clear(
    scene: Scene,
    held: Scene,
    standing: Judged,
    begun: Sequence[Model],
    noises: Sequence[Noise],
    alike: Judged | None = None,
) -> tuple[Judged, Judged, list[Judged]] | None:
    """The best form under that of the `noises` which suits it, `standing` by free runs beside it, and all
    forms; None where it is not clearly the likelier: than no friction and than free runs, or, where it is
    `alike`, which was, than no friction."""
    tables = [spec.parameters for spec in standing.model.effects if spec.name in PLIABLE]
    plain, rivals = _forms(scene, held, begun, noises, crosses(scene, standing), tables)
    best = _best(rivals, plain)
    if best is not None and crosses(scene, best):
        free = _by_free_runs(standing, best, scene, held, begun[0])
        if sum(_worth(free)) - sum(_worth(best)) > HOPELESS:
            return None  # with fewer numbers it is farther behind
        best = _as_stated(best, scene, held, noises)
    if plain is None or best is None or crosses(scene, best):
        return None
    before = _by_free_runs(standing, best, scene, held, begun[0])
    beaten = (plain,) if alike is not None and _alike(best, alike) else (plain, before)
    return (best, before, rivals) if _beats(best, beaten, plain) else None


def _beats(best: Judged, beaten: Sequence[Judged], plain: Judged) -> bool:
    """Clearly the likelier than each of `beaten`, fitted and held out together, and the more likely in
    both. A held-out recording in which any friction says less than that over `plain`, without one, cannot
    be asked: there it must not be behind."""
    asked = ALSO if best.held_out - plain.held_out >= CLEAR else 0.0
    for one in beaten:
        fitted, unseen = (b - a for a, b in zip(_worth(one), _worth(best), strict=True))
        if fitted < ALSO or unseen < asked or fitted + unseen < 2.0 * CLEAR:
            return False
    return True


def _led_by_free_runs(
    scene: Scene, held: Scene, standing: Judged, begun: Sequence[Model], noises: Sequence[Noise]
) -> bool:
    """The friction that stands is so far behind its own free runs, fitted and held out, in the filter that
    no other form would be ahead: what a step of a sample does not resolve is louder than the noise."""
    if not any(spec.name in FORMS for spec in standing.model.effects):
        return False
    model = replace(begun[1], effects=standing.model.effects)
    own = max(_ways(model, noises), key=lambda h: h.worth(scene.trials))
    judged = _judged(refitted(own, scene.trials, rounds=FIRST), scene, held)
    if judged is None:
        return False
    free = _by_free_runs(standing, judged, scene, held, begun[0])
    return all(a - b > LED for a, b in zip(_worth(free), _worth(judged), strict=True))


def _damped(standing: Judged, name: str) -> bool:
    """Whether free runs surely show a contact to be damped, which in the filter none is: it takes that
    for a stiffness. (A pivot of 0.35 N m/rad and 2e-4 N m s/rad: 0.31 and 1.98e-4 by free runs, and 2.97 by
    the filter, which had the truth 1,380 behind that.)"""
    index = standing.model.names.index(name)
    error = error_of(standing, index, DAMPING) if name == CONTACT else None
    return error is not None and standing.model.effects[index].parameters[DAMPING] > SURE * error


def _alike(one: Judged, other: Judged) -> bool:
    """The same friction beside the same effects, its level within a quarter."""
    if one.model.names != other.model.names:
        return False
    own, its = (level_of(judged.model.effects[-1]) for judged in (one, other))
    return own is not None and its is not None and abs(own - its) <= ALIKE * max(own, its)


def _best(rivals: Sequence[Judged], none: Judged | None) -> Judged | None:
    """The likeliest form that has numbers of its physics; a table must say more than fit a little better,
    or mend a little of what the filter itself is wrong by, which puts the true level behind another by 2 %
    of what friction brings over `none`: much more, or as clearly where nothing was fitted. What does
    nearly as well with fewer numbers is preferred."""
    able = [one for one in rivals if credible(one)]
    if not able or none is None:
        return None
    brought = max(one.score for one in able) - none.score
    share = SHARE * max(len(one.fit.white) for one in able)
    others = [one.held_out for one in able if one.model.names[-1] not in PLIABLE]

    def worth(one: Judged) -> float:
        if one.model.names[-1] not in PLIABLE:
            return one.score
        if one.price is not None:
            return one.score - CURVED * brought
        told = one.held_out >= max(others, default=np.inf) + CLEAR
        return one.score - max(0.0 if told else share, LITTLE * brought)

    top = max(worth(one) for one in able)
    near = [one for one in able if worth(one) > top - max(SUBSTITUTE, LEAST * brought)]
    return min(near, key=lambda one: len(one.model.coordinates))


def _as_stated(best: Judged, scene: Scene, held: Scene, noises: Sequence[Noise]) -> Judged | None:
    """`best` with what of mass, damping and stiffness went beyond the contract's line as the plant file has
    it, under that of the `noises` which suits it then: it stood for what a step of a sample does not
    resolve, for an effect that free runs tell, or for another noise."""
    beyond = {n for n, size in sizes(scene, best.model).items() if claims(n, size)}
    corrections = {k: v for k, v in best.model.corrections.items() if k not in beyond}
    model = replace(best.model, corrections=corrections, held=best.model.held | beyond)
    ways = _ways(model, {best.scene.noise, *noises})
    tried = [refitted(way, scene.trials) for way in ways]
    likeliest = max(tried, key=lambda one: one.scaled(scene.trials)[0])
    return _judged(finer(likeliest, scene.trials), scene, held)


def _company(model: Model) -> tuple[EffectSpec, ...] | None:
    """What stands beside a friction or what passes for one; None where neither stands, or something that
    the filter does not know."""
    names = set(model.names)
    friction = names & DRY or names & PASSES
    if model.effects and len(friction) != 1:
        return None
    if friction & (DRY - set(FORMS) - CREEPING):  # free runs made more of it than the filter can
        return None
    beside = tuple(spec for spec in model.effects if spec.name not in friction)
    return beside if all(map(_known, beside)) else None


def _known(spec: EffectSpec) -> bool:
    """Whether the filter knows the effect."""
    return spec.name in LINEAR or separable(spec) or along(spec)


def _still(model: Model, prior: Noise) -> bool:
    """A dry friction stands beside which force noise is as good as none: free runs tell its form."""
    per = model.base.simulator.force_per_input
    stood = [level_of(spec) for spec in model.effects if spec.name in DRY]
    noise = per * float(np.hypot(prior.force, prior.force_coloured))
    return any(level is not None and noise < STILL * level for level in stood)


def _worth(judged: Judged) -> tuple[float, float]:
    """Of the fitted recordings, its numbers charged, and of the held-out ones."""
    return judged.score - judged.held_out, judged.held_out


def _by_free_runs(standing: Judged, best: Judged, scene: Scene, held: Scene, told: Model) -> Judged:
    """`standing` by the likelihood of its free runs, on a footing with the filter's: what this has of the
    model without friction beyond what whitening has, of where recordings begin, is granted."""
    worth = []
    for ground in (scene, held):
        quiet = replace(ground, worth=1.0).like(best.scene)
        footing = Slip(told, best.scene.noise).scaled(ground.trials)[0] - quiet.by_free_run(told)
        free = replace(ground, worth=1.0).like(standing.scene).by_free_run(standing.model)
        worth.append(free + (footing if abs(footing) < FOOTING * len(ground.trials) else 0.0))
    return replace(standing, fitted=worth[0], held_out=worth[1])


def _rms(parts: Sequence[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def _forms(
    scene: Scene,
    held: Scene,
    begun: Sequence[Model],
    noises: Sequence[Noise],
    damped: bool,
    tables: Sequence[Mapping[str, Any]] = (),
) -> tuple[Judged | None, list[Judged]]:
    """The best without friction, from where the corrections stand and from nominal, and forms of friction
    where plain friction foretells best, under that of the `noises` that suits it; nothing where that
    says no more than none does, unless a damper stands that may be a friction (`damped`: a contact that
    yields for long says less as plain friction than as a damper). A table begins flat, and as `tables` have
    it, with the company that free runs found beside them."""
    trials, told = scene.trials, begun[0]
    short, glimpse, base = shortened(scene, LOOK), shortened(scene, GLANCE), told.base
    force = _rms([t.u for t in trials]) * base.simulator.force_per_input

    levels = [
        way
        for model in begun for place in places_of(told) for size in LEVELS
        for way in _ways(_with(model, "coulomb_friction", place.options, level=force * size), noises)
    ]  # fmt: skip
    plain = finer(refitted(max(levels, key=lambda h: h.worth(glimpse)), trials), trials)
    bare = plain.model.without(len(told.effects))
    without = [Slip(m, noise) for m in (*begun, bare) for noise in {plain.noise, *noises}]
    none = best_of(sorted(without, key=lambda h: -h.worth(short))[:LIKELIEST], trials, short)
    if not damped and plain.worth(trials) < none.worth(trials) + HINT:
        return None, []  # no other form is looked for where the plain one shows nothing
    spec = plain.model.effects[-1]
    level, options = (
        spec.parameters["level"],
        {k: spec.options[k] for k in POINT if k in spec.options},
    )
    speed = _rms([np.diff(t.y) / t.sample_time for t in trials])
    low, high = (end(end(t.y) for t in trials) for end in (min, max))
    flat = [level] * KNOTS
    table = {"grid": np.linspace(low, high, KNOTS).tolist(), "positive": flat, "negative": flat}
    starts: dict[str, list[dict[str, Any]]] = {
        BY_DIRECTION: [{"level_positive": level, "level_negative": level}],
        "stribeck_friction": [
            {
                "coulomb_level": slides * level,
                "static_level": rests * level,
                "stribeck_velocity": v * speed,
            }
            for slides, rests in SHARES
            for v in FALLS
        ],
        "presliding_friction": [
            {"level": level, "stiffness": level / (x * base.travel), "micro_damping": 0.0}
            for x in YIELDS
        ],
        "position_dependent_friction": [{"level": level, "table": table}],
    }
    forms = [plain]
    for name, values in starts.items():
        begun_by = [replace(plain, model=_with(bare, name, options, **own)) for own in values]
        if "table" in values[0]:
            as_found = [_with(begun[-1], name, options, **own) for own in tables]
            begun_by += [way for model in as_found for way in _ways(model, noises)]
        tried = [refitted(one, short, of_others(one.model), FIRST) for one in begun_by]
        ranked = sorted(tried, key=lambda h: -h.worth(short))
        if name not in STIFF:
            forms.append(best_of(ranked[:LIKELIEST], trials, short))
            continue
        leans = ranked[0].worth(short) > plain.worth(short) + LEAN
        forms.append(refitted(ranked[0], trials) if leans else ranked[0])
    forms.append(_of_the_mean(forms[-1], trials))
    either = [form for form in forms if form.model.names[-1] == BY_DIRECTION]
    forms.append(_of_one_level(max(either, key=lambda h: h.worth(trials)), trials))
    judged = [one for one in (_judged(found, scene, held) for found in forms) if one is not None]
    rigid = [one for one in judged if one.model.names[-1] == "coulomb_friction"]
    free = next(form for form in forms if form.model.names[-1] in PLIABLE)
    believed = smoothed(free, max(rigid, key=lambda one: one.score), scene, held) if rigid else None
    judged += [] if believed is None else [believed]
    return _judged(none, scene, held), [one for one in judged if _shown(one)]


def _of_one_level(either: Slip, trials: Sequence[Trial]) -> Slip:
    """Plain friction of the mean level of friction by direction, all else as found there: from elsewhere it
    may settle behind it. (0.9692 +- 0.0058 and 0.9644 +- 0.0057 N, for 0.9654 N both ways.)"""
    plain = plain_form(either.model.effects[-1])
    assert plain is not None
    return _instead(either, plain, trials)


def _of_the_mean(table: Slip, trials: Sequence[Trial]) -> Slip:
    """Friction by direction from the mean levels of a fitted `table`, all else as found there: from
    one level for both ways it may settle elsewhere. (14.19 and 7.22 N and 26 % less damping, 1,720 behind a
    table of 13.9 and 6.4 N throughout; 13.99 and 6.45 N were there.)"""
    return _instead(table, in_the_mean(table.model.effects[-1]), trials)


def _instead(found: Slip, spec: EffectSpec, trials: Sequence[Trial]) -> Slip:
    """`spec` in the place of the last effect found, refitted from there."""
    model = replace(found.model, effects=(*found.model.effects[:-1], spec))
    return refitted(replace(found, model=model), trials)


def _shown(judged: Judged) -> bool:
    """Not a contact that no sensor shows: that is plain friction."""
    return judged.model.names[-1] != CONTACT or not unseen(judged, len(judged.model.names) - 1)


def _with(model: Model, name: str, options: Mapping[str, Any], **values: Any) -> Model:
    return model.with_effect(EffectSpec(name, values, dict(options)))


def _ways(model: Model, noises: Iterable[Noise]) -> list[Slip]:
    """`model` under each of the `noises`, its friction in steps of a sample and of parts of it."""
    return [Slip(model, noise, parts) for noise in noises for parts in PARTS]


def _judged(found: Slip, scene: Scene, held: Scene) -> Judged | None:
    found, fitted = found.in_its_noise(scene.trials)
    return found.judged(scene, held, fitted)

"""The line between a corrected number of the model and an effect of its own (INTERFACES.md).

During the contest mass, damping and stiffness of the linear model are simply free. Where one of them
ends up beyond the contract's line it becomes `mass_change`, `viscous_friction` or `linear_stiffness`,
and the linear model's own number stays at its nominal value.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.dry import PLIABLE
from ffl.diagnose.contest.earning import earns
from ffl.diagnose.contest.evenly import TIE, about_a_centre, beside_a_load, recentred
from ffl.diagnose.contest.judging import (
    OPEN,
    Judged,
    credible,
    judge,
    levelled,
    likeliest,
    raw_error,
    raw_residuals,
)
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.settle import KEEP, RIVALS, SUBSTITUTE, challengers, settle
from ffl.diagnose.hypothesis.amounts import (
    LINE,
    NAMES,
    as_effect,
    claims,
    effect_values,
    netted,
    sizes,
)
from ffl.diagnose.hypothesis.coordinate import slightest
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.ladders import with_best_start
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import Place, places_of
from ffl.effects import EFFECTS, Effect
from ffl.systems.plant import EffectSpec, Plant

LOSS = 1.5  # times the mean square left: beyond it a refit of the same number as an effect failed
ALIKE = 1.01  # times the held-out squares that the same physics in other words may leave
ALMOST = 0.999  # of the line: within it, whatever rounding does
SURE = 3.0  # standard errors
AJAR = 2.0  # times the line: as far a number may stand beyond it that says more there
TELLS = 25.0  # log-likelihood that it must say, as much as an effect
FAINT = 100.0  # log-likelihood that a number brings as an effect: with less a sibling may be it
CLAIMANTS = 4  # effects that are held against a correction beyond the line
LATE = {"input_delay": "delay", "actuator_lag": "time_constant", "sensor_lead": "lead"}


def slight(spec: EffectSpec, plant: Plant) -> bool:
    """A delay, lag or lead below a tenth of a sample (below a sample where the model was identified): a
    correction of the model, not physics it lacks."""
    name = LATE.get(spec.name)
    return name is not None and float(spec.parameters[name]) < slightest(plant)


def crosses(scene: Scene, judged: Judged) -> bool:
    """A correction is beyond the line, for sure and in the way of its effect: an effect by another
    name. (Less damping or stiffness than the model has is none.)"""
    beyond = [n for n, size in sizes(scene, judged.model).items() if claims(n, size)]
    return any(abs(judged.model.corrections[n]) > SURE * judged.fit.spread_of(n) for n in beyond)


def astray(judged: Judged) -> dict[str, float]:
    """Sizes of the model's numbers that are off by twice the line or more, and surely beyond it, though no
    effect of theirs stands: whether one is missing these recordings do not tell. (A limit in noise was
    27 +- 7 % of the mass, and "nothing missing".)"""
    found = {}
    for name, size in sizes(judged.scene, judged.model).items():
        clear = claims(name, 0.5 * size)
        apart = abs(judged.model.corrections[name]) * (1.0 - LINE / abs(size)) if clear else 0.0
        if apart > SURE * judged.fit.spread_of(name):
            found[name] = size
    return found


def on_the_line(held: Scene | None, judged: Judged) -> Judged:
    """`judged` with every correction beyond the line held on it: what its effects say by themselves."""
    for name, size in sizes(judged.scene, judged.model).items():
        if abs(size) > LINE and name not in judged.model.held:
            judged = _within(held, judged, name, ALMOST * LINE / abs(size))
    return judged


def claimants(
    quiet: Scene, held: Scene | None, base: Judged, rivals: Sequence[Judged], threshold: float
) -> list[Judged]:
    """Those of `rivals`, best first, that with their own corrections on the line do more than the one
    beyond it that `base` stands on, and earn their place beside it on the line."""
    worthy = [r for r in rivals[:CLAIMANTS] if r.score > base.score + SUBSTITUTE]
    if not worthy:
        return []
    on_line = [on_the_line(held, replace(r, scene=quiet)) for r in (base, *worthy)]
    base, plain, *worthy = levelled([base, *on_line])
    worthy = [r for r in worthy if r.score > base.score + SUBSTITUTE]
    return sorted((r for r in worthy if earns(r, plain, threshold)), key=lambda r: -r.score)


def across_the_line(scene: Scene, held: Scene | None, judged: Judged) -> Judged:
    """`judged` with every correction beyond the line turned into its effect; one that was held keeps
    its value, and is free from here on only to say how sure it is."""
    judged = recentred(held, judged)
    current, settled = _spring_with_centre(scene, held, judged), judged.model.held
    if settled:
        current = _as_it_stands(current, replace(current.model, held=current.model.held - settled))
    for name, effect in NAMES.items():
        size = sizes(scene, current.model).get(name, 0.0)
        if not claims(name, size) or effect in {spec.name for spec in current.model.acting}:
            continue  # of less damping or stiffness than the model has no effect says that either
        if abs(current.model.corrections[name]) < SURE * current.fit.spread_of(name):
            continue
        if name not in settled:
            within = _within(held, current, name, LINE / abs(size))
            current = judge(current.scene, held, current.model, 4, current.fit)  # by the same noise
            if not _beyond(current, within):
                if abs(size) >= AJAR * LINE or not _likelier(current, within):
                    current = _pruned(held, within)
                continue
        found = []
        places = places_of(current.model)
        if name == "mass" and (len(places) > 1 or _in_parts(current.model)):
            places = [*places, Place("force", "all")]
        for place in places:
            spec = EffectSpec(effect, effect_values(current.model, name), place.options)
            corrections = {k: v for k, v in current.model.corrections.items() if k != name}
            model = replace(
                current.model,
                corrections=corrections,
                held=current.model.held | {name},
            ).with_effect(spec)
            if name in settled:
                tried = _as_it_stands(current, model)
            else:
                tried = judge(current.scene, held, model, rounds=6)
            found.append(tried)
        best = likeliest(found)
        if not _misfit(current, best) < LOSS * _misfit(current, current):
            continue
        # At a point of the machine, alone, it must still be worth more than on the line. (A null on a
        # spring: a mass of 3.5 % that nothing held, 42 worse on the recordings that judge as an effect.)
        alone = name not in settled and not current.model.effects
        current = best if not alone or _beyond(best, within) else within
    current = _preloaded(held, about_a_centre(held, _netted(held, current)))
    return _without_idle(held, beside_a_load(held, current))


def released(judged: Judged) -> Judged:
    """`judged` with the numbers that were held on the line free to say how sure all is: none moves."""
    model = judged.model
    on_it = {name for name in model.held if model.corrections.get(name, 0.0) != 0.0}
    return _as_it_stands(judged, replace(model, held=model.held - on_it)) if on_it else judged


def against_the_refused(
    held: Scene | None, judged: Judged, outcome: Outcome
) -> tuple[Judged, Outcome]:
    """(`judged` or who does more in its place, `outcome` with those as contenders) where effects stand last
    that came in as numbers of the model's own: with these on the line the best of those that were tried
    are held against them once more, by their noise. (Dry friction in noise: 44 ahead of a damping beyond
    the line and refused for 6 on the recordings that judge, under noise that made no difference of it. Drag
    beside a Stribeck friction, refused for the little that it brought beside a damping of 5 times the
    model's: without that the two were 32 ahead, and plain friction with drag 36. A delay on a stage with
    a spring was 2.7 times its mass and a damper.) Where they bring little their siblings are tried too:
    beside the free number nobody saw them. (Drag in noise, 3 from a damper in truth, was told as one.)"""
    company = list(judged.model.names)
    name = company[-1] if company else ""
    while company and company[-1] in NAMES.values() and company[-1] not in outcome.contenders:
        company.pop()
    if len(company) == len(judged.model.names) or not outcome.steps:
        return judged, outcome
    if company and tuple(company) != outcome.standing.model.names:
        return judged, outcome
    best: dict[str, Judged] = {}
    for rival in outcome.tried:
        if rival.model.names[:-1] == tuple(company) and credible(rival):
            best.setdefault(rival.model.names[-1], rival)
    alone, scene = outcome.standing, judged.scene
    refused = [
        judge(scene, held, r.model, 4, r.fit) for r in (alone, *list(best.values())[:RIVALS])
    ]
    found = [on_the_line(held, r) for r in refused]
    if judged.score - levelled([found[0], judged])[0].score < FAINT:
        found += _siblings(held, judged, best)
    plain, judged, *found = levelled([found[0], judged, *found[1:]])
    contenders = {
        **outcome.contenders,
        name: [(name, judged), *((j.model.names[-1], j) for j in found)],
    }
    first = max(found, key=lambda j: j.score, default=judged)
    if first.score > judged.score + SUBSTITUTE and earns(first, plain, KEEP):
        contenders = {**outcome.contenders, first.model.names[-1]: contenders[name]}
        if company:  # others may suit it better
            first, told = settle(scene, held, first, outcome.steps, PLIABLE, lambda line: None, {})
            contenders = {**contenders, **told}
        judged = across_the_line(scene, held, first)
    return judged, replace(outcome, contenders=contenders)


def _siblings(held: Scene | None, judged: Judged, tried: Container[str]) -> list[Judged]:
    """Siblings of the last effect in its place, the model's own number held: those not `tried` yet."""
    last = len(judged.model.names) - 1
    own = {*NAMES.values()}
    seen = challengers(judged.scene, judged, last, (), frozenset())
    seen = [c for c in seen if c.spec.name not in own and c.spec.name not in tried]
    found = [judge(judged.scene, held, with_best_start(judged.scene, c), 8) for c in seen]
    return [other for other in found if credible(other)]


def _in_parts(model: Model) -> bool:
    """Whether an effect divides a machine of one mass, and where a further mass sits makes a difference.
    (Beside a load behind a play 7 % more mass stayed a correction: at the motor alone it was another
    machine.)"""
    return any(type(EFFECTS[spec.name]).modify is not Effect.modify for spec in model.effects)


def _netted(held: Scene | None, judged: Judged) -> Judged:
    """An effect and the model's own number of the same kind are one number: where what they come to is
    within the line, or less than the model has, no effect is left. (A damping that acts at the motor and
    is free as a whole may else be said twice, and so may a mass of 0.3 % beside one of 1.2 %.) What is more
    is the effect's alone, unless the recordings know better. (A damper of 6.75 +- 16.7 beside a damping of
    2 +- 140 %: 6.96 +- 0.011.)"""
    for name, effect in NAMES.items():
        net = netted(judged.scene, judged.model, name)
        if net is not None:
            gone = judged.model.effects[judged.model.names.index(effect)]
            judged = _without_spring(held, judged, net, gone)
            continue
        whole = as_effect(judged.model, name)
        if whole is not None:
            tried = judge(judged.scene, held, whole, 8)
            judged = tried if tried.score > judged.score - TIE else judged
    return judged


def _without_spring(held: Scene | None, judged: Judged, net: Model, gone: EffectSpec) -> Judged:
    """`net`, from which an effect has `gone`; of a spring its centre's pull stays as a load, if that is
    worth its number."""
    force = float(gone.parameters.get("stiffness", 0.0)) * float(gone.parameters.get("centre", 0.0))
    if not force or "constant_load" in net.names:
        return judge(judged.scene, held, net, 8)
    spec = EffectSpec("constant_load", {"force": force}, dict(gone.options))
    loaded = judge(judged.scene, held, net.with_effect(spec), 8)
    bare = judge(judged.scene, held, net, 8)
    loaded, bare = levelled([loaded, bare])
    return loaded if loaded.score > bare.score + KEEP else bare


def _pruned(held: Scene | None, judged: Judged) -> Judged:
    """`judged` with those effects alone, and in that form, that since a correction is held on the line are
    worth something: they stood beside one far beyond it."""
    judged, _ = settle(judged.scene, held, judged, (), PLIABLE, lambda line: None, {})
    if len(judged.model.effects) == 1 and not judged.model.proven:
        bare = judge(judged.scene, held, judged.model.without(0), 6, judged.fit)
        bare, judged = levelled([bare, judged])
        judged = bare if bare.score > judged.score - KEEP else judged
    return judged


def _beyond(current: Judged, within: Judged) -> bool:
    """The free number is worth more than the one on the line: beside effects as much as a further
    effect must be, alone anything, since nothing else was tried for it."""
    if within.model.effects:
        return earns(current, within, 0.0)
    current, within = levelled([current, within])
    return current.score > within.score


def _likelier(current: Judged, within: Judged) -> bool:
    """A number a little beyond the line says more than on it: it stays where it is, a number. (Beside a
    gain by position a spring 2.6 % stiffer, held on 2 %, was 67 behind: the gain, 19 % off, gave way to
    a map.)"""
    current, within = levelled([current, within])
    return current.score > within.score + TELLS


def _within(held: Scene | None, judged: Judged, name: str, share: float) -> Judged:
    """`judged` with the correction `name` held at `share` of what it was: on the line. A correction
    beyond it must earn its place like an effect: beside one that is a little wrong itself, and alone,
    where a direction that the data hardly see runs off with nothing gained, for all its small
    standard error (a mass of -13.3 +- 3.0 % that brought -0.4; real ones brought 14 to 1245)."""
    corrections = {**judged.model.corrections, name: share * judged.model.corrections[name]}
    model = replace(judged.model, corrections=corrections, held=judged.model.held | {name})
    return judge(judged.scene, held, model, 6, judged.fit)


def _spring_with_centre(scene: Scene, held: Scene | None, judged: Judged) -> Judged:
    """On a plant with a spring, a stiffness corrected and a constant load that together are a spring
    with its centre within the travel are that spring, `linear_stiffness`."""
    model, travel = judged.model, judged.model.base.travel
    if "constant_load" not in model.names or "stiffness" not in model.corrections:
        return judged
    size = sizes(scene, model).get("stiffness", 0.0)
    index = model.names.index("constant_load")
    load = model.effects[index]
    values = effect_values(model, "stiffness")
    if size <= 0.25 * LINE or abs(load.parameters["force"]) > 1.5 * travel * values["stiffness"]:
        return judged
    values["centre"] = load.parameters["force"] / values["stiffness"]
    corrections = {k: v for k, v in model.corrections.items() if k != "stiffness"}
    spring = replace(model.without(index), corrections=corrections, held=model.held | {"stiffness"})
    spec = EffectSpec("linear_stiffness", values, load.options)
    tried = judge(judged.scene, held, spring.with_effect(spec), 8)
    judged = judge(judged.scene, held, model, 4, judged.fit)  # by the same noise
    # The same machine, but what judges grants a correction its doubt and an effect none.
    alike = raw_error(held, tried.model) < ALIKE * raw_error(held, judged.model)
    same = alike and tried.fitted > judged.fitted - TIE
    return tried if same or tried.score > judged.score - TIE else judged


def _preloaded(held: Scene | None, judged: Judged) -> Judged:
    """A spring whose centre lies where the machine never was is a spring and a constant load: no
    recording tells the way to such a centre from a load. It is counted from 0 then, and the load
    has the rest; where 0 was not passed either, only if the centre is farther than the travel. A
    spring that beside the load is not worth an effect goes."""
    model = judged.model
    if "linear_stiffness" not in model.names or "constant_load" in model.names:
        return judged
    index = model.names.index("linear_stiffness")
    spring = model.effects[index]
    centre, stiffness = (float(spring.parameters[k]) for k in ("centre", "stiffness"))
    y = np.concatenate([trial.y for trial in judged.scene.trials])
    low, high = float(y.min()), float(y.max())
    travel = 0.0 if low <= 0.0 <= high else high - low
    if low - travel <= centre <= high + travel:
        return judged
    load = EffectSpec("constant_load", {"force": stiffness * centre}, dict(spring.options))
    split = model.with_parameters(index, {"stiffness": stiffness}).with_effect(load)
    both = judge(judged.scene, held, split, 4, _as_it_stands(judged, split).fit)
    alone = judge(judged.scene, held, split.without(index), 8, both.fit)  # by the same noise
    alone, both = levelled([alone, both])
    return alone if alone.score > both.score - KEEP else both


def _without_idle(held: Scene | None, judged: Judged) -> Judged:
    """`judged` without effects that take nothing off as they stand: amounts of no more than their own
    error, which came in on the way to where the others ended. (A cogging of 0.22 +- 0.26 mN stayed with
    53 of log-likelihood to its name, which a fit without it had not found the way to.)"""
    for name in judged.model.names:
        if name in judged.model.proven or len(judged.model.names) < 2:
            continue
        bare, scene = judged.model.without(judged.model.names.index(name)), judged.scene
        if 0.5 * scene.worth * (scene.cost(bare) - scene.cost(judged.model)) < OPEN:
            other = judge(scene, held, bare, 8, judged.fit)
            judged = other if np.isfinite(other.score) else judged
    return judged


def _as_it_stands(judged: Judged, model: Model) -> Judged:
    """`judged` with the same physics put in another way: nothing moves."""
    return replace(judged, fit=fit(judged.scene, model, rounds=0))


def _misfit(standard: Judged, judged: Judged) -> float:
    """Mean square of what `judged` leaves, whitened as `standard` is."""
    scene = replace(standard.scene, trials=judged.scene.trials)
    return float(np.mean(scene.whiten(raw_residuals(scene, judged.model)) ** 2))

"""Who else is missing beside a play that is foretold from sample to sample.

Two free runs part within a second where a loop rattles across a play, so that no free run tells what a
spring or a lag beside it does. The filter's innovations do: to first order they answer a small force as the
whitened output of the linear loop does, and a screen along the machine's own motion proposes who may join;
who does is foretold with all numbers fitted again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Generic

import numpy as np

from ffl.diagnose.contest.dry import CREEPING, PLIABLE, excluded
from ffl.diagnose.contest.judging import PER_NUMBER, Judged
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.settle import KEEP
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.predict.foretold import Told, refitted
from ffl.diagnose.recorded.trials import Trial
from ffl.diagnose.screen.candidate import Candidate
from ffl.diagnose.screen.followed import followed
from ffl.diagnose.screen.screen import Screen
from ffl.diagnose.screen.shortlist import shortlist
from ffl.effects import EFFECTS
from ffl.effects.drift import SETTLES
from ffl.systems.plant import EffectSpec

MOST = 2  # effects beside the play
AGAIN = 1  # time that who may join is asked again, where settling alone brought as much as he must
FAINT = 16.0  # first-order gain below which nobody is tried
# Moments of contact jump with every number, which makes the likelihood rough by a hundred or two:
LEAST = 250.0  # log-likelihood that joining brings
WORTH = 0.015  # the same, a sample
BOTH = 80.0  # the same, where recordings that judge bring as much
BEHIND = 1000.0  # by which those are left that a barer start has
ROUGH = 25.0  # times the log-likelihood that a better start brings or does not
HOLLOW = 0.2  # of what it brings: less to first order, and less of its share in what judges, is roughness
# Times a time constant by which a clock is moved; what settles has not begun before it did.
WARM = (0.0, -1.0, -0.5, -0.25, 0.25, 0.5, 1.0, 2.0, 5.0)
TURNS = (8, 16, 32, 64)  # parts of a period by which a clock is moved, finer and finer
Able = Callable[[EffectSpec], bool]
Settled = Callable[[Told, Sequence[Trial]], Told]


@dataclass(frozen=True)
class Company(Generic[Told]):
    """What is `found`, its play last, on the clocks of `trials`; for each that joined the best of its
    `rivals`, what was found with another in its place; `judging`: recordings that nothing is fitted to."""

    found: Told
    trials: tuple[Trial, ...]
    rivals: Mapping[str, Told] = field(default_factory=dict)
    judging: tuple[Trial, ...] = ()

    @property
    def full(self) -> bool:
        return len(self.found.model.effects) > MOST


def joined(
    company: Company[Told],
    scene: Scene,
    able: Able,
    settled: Settled[Told],
    further: Callable[[Company[Told]], Sequence[Candidate]] = lambda company: (),
    barer: Callable[[Told], Told | None] = lambda found: None,
) -> Company[Told]:
    """`company` with who foretells its recordings clearly better, one at a time, of whom the filter is
    `able` to take, and of those `further`; `settled` finds all numbers again, of the best and of those
    without it. The first is looked for beside what is `barer` as well: what stands in for who is missing
    leaves him nothing to bring. (A dead zone that was there brought nothing beside 8.7 % more mass, which
    was not, and 740 beside none; beside 5 N of friction that was not there nobody asked for a hysteresis.)
    """
    bare, again = barer(company.found), AGAIN
    while not company.full:
        found, trials = company.found, company.trials
        ranked = _ranked(company, scene, able, further)
        likely = [(way, ranked) for way in ranked[:1]]
        if bare is not None:  # a first-order gain is less rough than a refit far from any summit
            ranked = _ranked(replace(company, found=bare), scene, able, further)
            within = charged(found, trials) - BEHIND
            ranked = [way for way in ranked if charged(way.told, way.trials) > within]
            telling = sorted(ranked, key=lambda way: -way.gain)[:1]
            likely += [(way, ranked) for way in dict.fromkeys((*ranked[:1], *telling))]
            bare = None
        if not likely:
            break
        ways = [(settled(way.told, way.trials), way, beside) for way, beside in likely]
        best, way, others = max(ways, key=lambda pair: charged(pair[0], pair[1].trials))
        on = way.trials
        found = settled(found, trials)  # what settling alone brings is not credited to who joins
        least = max(LEAST, WORTH * sum(map(len, trials)))
        ahead = charged(best, on) - charged(found, trials)
        judged = _judged(found, best, company.judging)
        brings = ahead - max(-judged, 0.0) >= least
        brings = brings and not _hollow(ahead, way, judged, company.judging)
        if not brings and not _confirmed(ahead, best, found, company.judging):
            settled_alone = charged(found, trials) - charged(company.found, trials)
            company, again = replace(company, found=found), again - 1
            if settled_alone > least and again >= 0:  # who joins was asked beside another gap
                continue
            return company
        rivals = dict(company.rivals)
        if len(others) > 1:
            rivals[best.model.effects[-2].name] = next(o for o in others if o is not way).told
        company = replace(company, found=best, trials=on, rivals=rivals)
    return company


@dataclass(frozen=True, eq=False)
class _Way(Generic[Told]):
    """What is `told` of `trials` with one more, whose first-order `gain` that was."""

    told: Told
    trials: tuple[Trial, ...]
    gain: float


def _ranked(
    company: Company[Told],
    scene: Scene,
    able: Able,
    further: Callable[[Company[Told]], Sequence[Candidate]],
) -> list[_Way[Told]]:
    """`company` with each who may join, refitted, the best first."""
    tried: dict[str, _Way[Told]] = {}
    for c in (*proposed(company, scene, able), *further(company)):
        way = _Way(*beside(company.found, c, company.trials, scene.free_clocks), c.gain)
        best = tried.get(c.spec.name)
        if best is None or charged(way.told, way.trials) > charged(best.told, best.trials):
            tried[c.spec.name] = way
    return sorted(tried.values(), key=lambda way: -charged(way.told, way.trials))


def _confirmed(ahead: float, more: Told, less: Told, judging: Sequence[Trial]) -> bool:
    """Whether what `more` is `ahead` of `less` by in the fitted recordings is little, but those that judge
    say the same: roughness has no reason to. (A ripple of the encoder, 1.5 um: 116 and 136 ahead. Who was
    not there: 1 behind and 3 behind, 4 and 14 behind, 10 behind and 26 ahead.)"""
    if not judging or ahead < BOTH:
        return False
    return more.worth(judging) - less.worth(judging) > BOTH


def _hollow(ahead: float, way: _Way[Told], judged: float, judging: Sequence[Trial]) -> bool:
    """Whether neither what a way does to first order nor what is `judged` of it says why it is `ahead`:
    then one moment of contact is, that happens to fall better. (A sine of 387 Hz beside a play on a
    printer: 369 ahead, to first order 16, and 9 of 205 that were its share in what judged.)"""
    if not judging or 0.5 * way.gain > HOLLOW * ahead:
        return False
    share = sum(map(len, judging)) / sum(map(len, way.trials))
    return judged < HOLLOW * ahead * share


def _judged(less: Told, more: Told, judging: Sequence[Trial]) -> float:
    """By what `more` is ahead of `less` in the recordings that judge, each on the clocks that suit it; 0
    where there are none."""
    if not judging:
        return 0.0
    none, some = (told.worth(in_step(told, judging, 0)) for told in (less, more))
    return some - none


def lost_to(less: Told, more: Told, judging: Sequence[Trial]) -> float:
    """By what `more` is behind `less` in the recordings that judge, 0 at least, which who joins must bring
    as well. (Beside friction and a play, where the likelihood is rough by a thousand, a gain by position
    that was not there: 275 ahead in what was fitted, 353 behind in what was not.)"""
    return max(-_judged(less, more, judging), 0.0)


def proven(company: Company[Told], settled: Settled[Told]) -> Company[Told]:
    """`company` without those whom the rest, settled without them, does not miss."""
    for name in company.found.model.names[:-1]:
        model = company.found.model
        bare = replace(company.found, model=model.without(model.names.index(name)))
        bare = settled(bare, company.trials)
        ahead = charged(company.found, company.trials) - charged(bare, company.trials)
        lost = lost_to(bare, company.found, company.judging)
        if ahead - lost < LEAST and not _confirmed(ahead, company.found, bare, company.judging):
            company = replace(company, found=bare)
    return company


def exchanged(company: Company[Told], settled: Settled[Told]) -> Company[Told]:
    """`company` with the best rival of each that joined in its place where that foretells better; rivals
    are then those that were tried beside what is found now."""
    found, trials = company.found, company.trials
    rivals: dict[str, Told] = {}
    for name, rival in company.rivals.items():
        names = found.model.names
        # Who was tried, or who stood beside it then and has left since.
        others = [s for s in rival.model.effects if s.name not in names]
        if name not in names or not others:
            continue
        ways = [(settled(in_place(found, name, s), trials), s.name) for s in others]
        tried, other = max(ways, key=lambda way: charged(way[0], trials))
        ahead = charged(tried, trials) - charged(found, trials)
        if ahead > lost_to(found, tried, company.judging):
            found, rivals = tried, {other: found}
        else:
            rivals[name] = tried
    return replace(company, found=found, rivals=rivals)


def in_place(found: Told, name: str, other: EffectSpec) -> Told:
    """`found` with `other` where the effect `name` was."""
    k = found.model.names.index(name)
    effects = (*found.model.effects[:k], other, *found.model.effects[k + 1 :])
    return replace(found, model=replace(found.model, effects=effects))


def charged(found: Told, trials: Sequence[Trial]) -> float:
    """What `found` foretells of the recordings, its numbers charged."""
    return found.worth(trials) - PER_NUMBER * len(found.model.coordinates)


def proposed(company: Company[Told], scene: Scene, able: Able) -> list[Candidate]:
    """Who is worth a fit, of those who would explain what `company` leaves."""
    found, trials = company.found, company.trials
    left = found.fit(trials)
    if left is None:
        return []
    factor = found.scaled(trials)[1]
    quiet = replace(scene, trials=tuple(trials), noise=found.noise.scaled(factor), worth=1.0)
    bare = replace(found.model, effects=())
    along = followed(quiet, bare)
    if along is None:
        return []
    view = Screen(quiet, fit(quiet, bare, rounds=0), along)
    view = view.foretold(replace(left, white=left.white / factor, jacobian=left.jacobian / factor))
    barred = excluded(found.model) | PLIABLE | CREEPING
    names = [name for name in EFFECTS if name not in barred]
    fresh = [c for c in view.candidates(names) if c.gain > FAINT and able(c.spec)]
    return shortlist(fresh)


def beside(
    found: Told,
    candidate: Candidate,
    trials: Sequence[Trial],
    free_clocks: bool,
) -> tuple[Told, tuple[Trial, ...]]:
    """`found` with the candidate before its play, from the best of its starts, fitted; the trials on the
    clocks that suit it."""
    starts = []
    for spec in (candidate.spec, *candidate.valleys):
        effects = (*found.model.effects[:-1], spec, found.model.effects[-1])
        start = replace(found, model=replace(found.model, effects=effects))
        starts.append((start, in_step(start, trials, 1) if free_clocks else tuple(trials)))
    best, on = max(starts, key=lambda pair: pair[0].worth(pair[1]))
    best = refitted(best, on)
    if free_clocks and {"drift", "periodic_disturbance"} & set(best.model.names):
        on = in_step(best, on, 1)
        best = refitted(best, on)
    return best, on


def in_step(found: Told, trials: Sequence[Trial], from_trial: int) -> tuple[Trial, ...]:
    """The trials from `from_trial` onwards with their clocks moved to where the drift has settled as far,
    and the periodic disturbance is in step with, what they show, where there is one."""
    out = list(trials)
    for spec in sorted(found.model.effects, key=lambda spec: spec.name != "drift"):
        if spec.name == "drift" and spec.options.get("kind", SETTLES) == SETTLES:
            settling = float(spec.parameters["time_constant"])
            least, moves = 0.0, [[settling * share for share in WARM]]
        elif spec.name == "periodic_disturbance":
            period = 1.0 / float(spec.parameters["frequency"])
            (first, *finer), least = TURNS, -np.inf
            moves = [[k * period / first for k in range(-first // 2, first // 2)]]
            moves += [[k * period / parts for k in (-1, 0, 1)] for parts in finer]
        else:
            continue
        for k in range(from_trial, len(out)):
            for by in moves:
                clocks = [
                    out[k].start_time + step
                    for step in by
                    if step >= 0.0 or out[k].start_time + step >= least
                ]
                moved = [replace(out[k], start_time=clock) for clock in clocks]
                out[k] = max(moved, key=lambda trial: found.scaled([trial])[0])
    return tuple(out)


def needed(found: Told, trials: Sequence[Trial]) -> Told:
    """Without those beside the play that foretell nothing now that it is there."""
    for name in found.model.names[:-1]:
        bare = replace(found, model=found.model.without(found.model.names.index(name)))
        found = bare if bare.scaled(trials)[0] > found.scaled(trials)[0] - KEEP else found
    return found


def clocked(scene: Scene, trials: Sequence[Trial]) -> Scene:
    """`scene` with its recordings begun when those of `trials` were, the same or pieces of them."""
    pairs = zip(scene.trials, trials, strict=True)
    return replace(scene, trials=tuple(replace(t, start_time=o.start_time) for t, o in pairs))


def contending(
    company: Company[Told], found: Told, judged: Judged, told: Callable[[Told], Judged | None]
) -> dict[str, list[tuple[str, Judged]]]:
    """For each who joined, and stayed, the one that was tried in its place, as it is `told`; what lies
    between them counts for as little as the likelihood is rough."""
    out = {spec.name: [(spec.name, judged)] for spec in found.model.effects[:-1]}
    own = company.found.model.names
    for name, rival in company.rivals.items():
        others = [n for n in rival.model.names if n not in own]
        one = told(rival) if len(others) == 1 and name in out else None
        if one is not None:
            apart = charged(rival, company.trials) - charged(company.found, company.trials)
            like = replace(one, fitted=one.fitted + judged.score + apart / ROUGH - one.score)
            out[name].append((others[0], like))
    return out

"""The contest: every effect at every place against every other, judged by likelihood.

Each hypothesis is fitted with the noise it leaves itself (so that neither coloured noise passes for
physics nor physics for coloured noise), and scored by
    log-likelihood of the fitted recordings - penalty per free number + log-likelihood of the
    held-out recordings,
the second a free-running simulation with nothing fitted to it. One effect is added at a time; before
a second one is thought of, all siblings of the first have been fitted too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ffl.diagnose.contact import with_other_contact
from ffl.diagnose.fit import Fit, Scene, fit
from ffl.diagnose.friction_table import refined
from ffl.diagnose.glimpse import promising
from ffl.diagnose.harmonics import with_harmonics
from ffl.diagnose.imitate import imitated
from ffl.diagnose.judging import (
    PER_NUMBER,
    QUIET,
    SHARE,
    Judged,
    earns,
    judge,
    levelled,
    noise_error,
    raw_error,
    raw_residuals,
)
from ffl.diagnose.ladders import SWINGS, overlooked, with_best_start
from ffl.diagnose.line import crosses, on_the_line
from ffl.diagnose.linear import WITHOUT_ZERO, has_zero
from ffl.diagnose.model import Model
from ffl.diagnose.parallel import each
from ffl.diagnose.screen import Candidate, Screen, orthonormal
from ffl.diagnose.shortlist import SHORTLIST, shortlist
from ffl.diagnose.starts import with_starts
from ffl.effects import EFFECTS

FAINT = 16.0  # first-order gain below which a fit is not worth while
WORSE = 1.2  # held-out sum of squares that one more effect may cost, of what it was or noise makes
KEEP = 20.0  # score an effect must be worth beside all others
SUBSTITUTE = 3.0  # score by which a sibling must be better
FAR = 0.6  # surprise of the corrections at which effects compete from nominal ones too
HOPELESS = 0.3  # of what an effect is worth: a rival further behind after a few steps stays there
CHALLENGERS = 6  # most rivals that an effect must stand up to in the end
CLAIMANTS = 4  # effects that are held against a correction beyond the line
NOISY = 8.0  # times what noise alone brings in the mean: less is what it may bring once


@dataclass(frozen=True)
class Step:
    """One round of the contest: what stood, who challenged it, what they reached."""

    before: Judged
    screened: tuple[Candidate, ...]
    rivals: tuple[Judged, ...]
    accepted: Judged | None


@dataclass(frozen=True)
class Outcome:
    """What stands at the end, all rounds, the held-out recordings with their starts, and for each
    effect by name every hypothesis that was fitted in its place beside the others, its own included."""

    standing: Judged
    steps: list[Step]
    held: Scene | None
    contenders: dict[str, list[tuple[str, Judged]]]


def contest(
    scene: Scene,
    held: Scene | None,
    model: Model,
    threshold: float,
    most: int = 3,
    progress: Callable[[str], None] | None = None,
) -> Outcome:
    """Forward selection with substitution; the most pliable effects come in when no other does."""
    say = progress or (lambda line: None)
    standing = judge(scene, held, model)
    steps: list[Step] = []
    contenders: dict[str, list[tuple[str, Judged]]] = {}
    last_error = np.inf
    reserve = PLIABLE
    again = False
    while True:
        # White noise no louder than what is left: slow physics must not pass for slow noise.
        quiet = scene.with_noise_of(
            raw_residuals(scene, standing.model), coloured=False, quantile=QUIET
        )
        scene, quiet = with_starts(scene, standing.model), with_starts(quiet, standing.model)
        if held is not None:
            held = with_starts(replace(held, noise=quiet.noise), standing.model)
        base = judge(quiet, held, standing.model, rounds=6)
        say(f"{base.name}: log-likelihood {base.fitted:.1f}, held out {base.held_out:.1f}")
        base = with_harmonics(quiet, held, refined(quiet, held, base, say), say)
        if not again:
            base = with_other_contact(quiet, held, base, say)
        base = plain_lags(quiet, held, base, say)
        last_contenders = contenders
        if base.model.effects:
            base, contenders = settle(
                quiet, held, base, steps, reserve, say, last_contenders if again else {}
            )
        error = raw_error(held, base.model)
        if steps and error > WORSE * max(last_error, noise_error(held, base.scene)):
            now, then = levelled([base, steps[-1].before])
            if now.held_out < then.held_out:
                # What came in last does not hold up on the held-out recordings once all is refitted.
                times = np.sqrt(error / last_error)
                say(f"  turned down again: held-out error {times:.2f} times as large")
                steps[-1] = replace(steps[-1], accepted=None)
                return Outcome(steps[-1].before, steps, held, last_contenders)
        last_error = error
        if len(steps) == most:
            return Outcome(base, steps, held, contenders)
        least = (
            FAINT if steps else FAINT / 2
        )  # what hides in the noise of the first round may be faint
        taken = _excluded(base.model)
        if scene.free_clocks and taken & TIMED:  # an unknown clock can be set by one of them only
            taken |= TIMED
        screened = []
        entrants: list[Candidate] = []
        for screen in screens(quiet, base):
            seen = screen.candidates()
            screened += seen
            fresh = [c for c in seen if c.spec.name not in taken and c.gain > least]
            pliable = [c for c in fresh if c.spec.name in PLIABLE]
            plain = [c for c in fresh if c not in pliable] if reserve else pliable
            # Far from what was measured first orders do not tell one point from another.
            far = base.fit.cost > SWINGS * len(base.fit.white)
            listed = shortlist(plain, places=SHORTLIST if far else 2)
            entrants += listed + overlooked(quiet, base, fresh, listed)
        rivals = each(partial(_joined, quiet, held), promising(quiet, base, entrants))
        for rival in rivals:
            side = rival.model.effects[-1].options.get("side", "sensor")
            say(
                f"  {rival.name} {side}: {rival.fitted - base.fitted:+.1f} fitted, "
                f"{rival.held_out - base.held_out:+.1f} held out"
            )
        base, *rivals = levelled([base, *rivals])
        rivals.sort(key=lambda j: -j.score)
        for k, rival in enumerate(rivals[:2]):  # the two that matter go on to convergence
            if rival.score > base.score and rival.fit.status == "rounds":
                rivals[k] = judge(quiet, held, rival.model, 8, rival.fit)
        base, *rivals = levelled([base, *rivals])
        rivals.sort(key=lambda j: -j.score)
        worthy = [r for r in rivals if earns(r, base, threshold)]
        if worthy and base.model.effects and not (scene.plain or scene.observed):
            worthy = louder_than_noise(base, worthy)
        if not worthy and not base.model.effects and crosses(quiet, base.model):
            # What stands is no longer nominal: it claims an effect too, and must be the better one.
            worthy = [r for r in rivals[:CLAIMANTS] if r.score > base.score + SUBSTITUTE]
            worthy = [on_the_line(held, r) for r in worthy]
            base, *worthy = levelled([base, *worthy])
            worthy = [r for r in worthy if r.score > base.score + SUBSTITUTE]
            worthy.sort(key=lambda r: -r.score)
        accepted = worthy[0] if worthy else None
        steps.append(Step(base, tuple(screened), tuple(rivals), accepted))
        if accepted is None and reserve and set(base.model.names) & DRY:
            reserve, standing, last_error, again = frozenset(), base, np.inf, True
            continue
        if accepted is None:
            return Outcome(base, steps, held, contenders)
        standing, again = accepted, False
        scene = replace(scene, trials=accepted.scene.trials)  # with the clocks it settled on
        held = accepted.held


def _joined(quiet: Scene, held: Scene | None, first: Fit) -> Judged:
    return judge(quiet, held, first.model, 6, first)


def plain_lags(
    quiet: Scene, held: Scene | None, base: Judged, say: Callable[[str], None]
) -> Judged:
    """Two lags without their zero where, beside effects, they do as well: a linear model that was fitted
    to a machine with the effect bends, and a zero is what two lags have to bend with."""
    model = base.model
    if not model.effects or WITHOUT_ZERO in model.corrections:
        return base
    if not has_zero(model.base.simulator.mechanics):
        return base
    corrections = {**model.corrections, WITHOUT_ZERO: 1.0}
    plain = replace(model, corrections=corrections, held=model.held | {WITHOUT_ZERO})
    other, base = levelled([judge(quiet, held, plain, 8), base])
    say(f"  the lags without their zero: {other.score - base.score:+.1f}")
    return other if other.score >= base.score else base


def louder_than_noise(base: Judged, rivals: Sequence[Judged]) -> list[Judged]:
    """Those of `rivals` that bring much more than noise alone does to their numbers in the machine as
    `base` names it: with play, stick or a dead zone it answers noise with slow motions of its own, in
    which a spring or a load finds hundreds of nats."""
    scene, model = base.scene, base.model
    alike = imitated(model.plant(), scene.trials, scene.noise, np.random.default_rng(0))
    out = []
    for rival in rivals:
        last = ("effect", len(model.effects))
        own = np.array([(c.kind, c.effect) == last for c in rival.model.coordinates])
        j = rival.fit.jacobian
        whole, without = orthonormal(j), orthonormal(j[:, ~own])
        brought = [
            0.5 * float(np.sum((whole.T @ e) ** 2) - np.sum((without.T @ e) ** 2))
            for e in (rival.scene.whiten(one.y) for one in alike)
        ]
        usual = float(np.mean(brought)) if brought else 0.0
        if rival.fitted - base.fitted > NOISY * usual or usual < np.sum(own):
            out.append(rival)
    return out


def screens(quiet: Scene, base: Judged) -> list[Screen]:
    """Views of what `base` leaves: from where its corrections stand and, where these have gone
    far to stand in for an effect, from nominal ones as well."""
    out = [Screen(quiet, base.fit)]
    if base.fit.surprise > FAR:
        kept = {k: v for k, v in base.model.corrections.items() if k in base.model.held}
        nominal = replace(base.model, corrections=kept)
        out.append(Screen(quiet, fit(quiet, nominal, rounds=0)))
    return out


DRY = frozenset(  # forms of one and the same friction: rivals, never company
    {
        "coulomb_friction",
        "asymmetric_friction",
        "stribeck_friction",
        "presliding_friction",
        "hysteresis",
        "position_dependent_friction",
    }
)


TIMED = {"periodic_disturbance", "drift"}

# So many free numbers that they imitate two plain effects at once, or a tank's outflow: tried once
# no plain one earns more, and only where plain dry friction, their mean, has earned its place.
PLIABLE = frozenset({"position_dependent_friction"})


def _excluded(model: Model) -> set[str]:
    """Effects that cannot be added: those there, and other forms of the dry friction there."""
    names = {spec.name for spec in model.acting}
    return names | (DRY if names & DRY else set())


def settle(
    quiet: Scene,
    held: Scene | None,
    judged: Judged,
    steps: Sequence[Step],
    reserve: frozenset[str],
    say: Callable[[str], None],
    tried_before: Mapping[str, list[tuple[str, Judged]]],
) -> tuple[Judged, dict[str, list[tuple[str, Judged]]]]:
    """Backward elimination and substitution: every effect must earn its place beside the others, and
    against its rivals in that company; these are returned with what they reached. Of rivals that
    have been `tried_before` in this company only those are tried that had no leave to come in."""
    current = judged
    contenders: dict[str, list[tuple[str, Judged]]] = {}
    for name in judged.model.names:
        if name not in current.model.names or name in current.model.proven:
            continue
        if current.fit.status == "rounds":
            current = judge(quiet, held, current.model, 10, current.fit)
        index = current.model.names.index(name)
        without = judge(quiet, held, current.model.without(index), 6, current.fit)
        current, without = levelled([current, without])
        say(f"  without {name}: {without.score - current.score:+.1f}")
        if without.score > current.score - KEEP and len(current.model.effects) > 1:
            current = without
            continue
        before = sorted(tried_before.get(name, ()), key=lambda pair: -pair[1].score)
        if before and abs(before[0][1].fitted - current.fitted) > SUBSTITUTE:
            before = []  # the company has changed since
        others = [(name, current), *before[1:]]
        only = PLIABLE if before else None
        trial = partial(_tried, quiet, held, current, without)
        for rival, other, lines in each(
            trial, challengers(quiet, current, index, steps, reserve, only)
        ):
            others.append((rival, other))
            for line in lines:
                say(line)
        names, tried = zip(*others, strict=True)
        *tried, alone = levelled([*tried, without])
        others = list(zip(names, tried, strict=True))
        current = others[0][1]
        for rival, other in others[1:]:
            say(f"  {rival} for {name}: {other.score - current.score:+.1f}")
        share = SHARE * len(current.fit.white)  # the pliable must say more, not fit a little better
        worthy = [
            (rival, other)
            for rival, other in others[1:]
            if earns(other, alone, 0.0)
            and (rival not in PLIABLE or name in PLIABLE or other.score > current.score + share)
        ]
        best_name, best = max([others[0], *worthy], key=lambda pair: pair[1].score)
        fewer = [p for p in worthy if _plainer(p[1], current)]
        simpler = max(fewer, key=lambda pair: pair[1].score, default=None)
        if simpler and simpler[1].score > best.score - SUBSTITUTE:  # it does the same with less
            best_name, current = simpler
        elif best.score > current.score + SUBSTITUTE:
            current = best
        else:
            best_name = name
        contenders[best_name] = others
    return current, contenders


def _tried(
    quiet: Scene, held: Scene | None, current: Judged, without: Judged, c: Candidate
) -> tuple[str, Judged, list[str]]:
    """What a challenger reaches in the place of the effect that `current` has and `without` has not:
    its name, its fit and what there is to say of it."""
    lines: list[str] = []
    start = with_best_start(quiet, c.like, c.spec)
    other = judge(quiet, held, start, 4, c.like)
    least = current.score - HOPELESS * (current.score - without.score)
    if other.score > least:
        other = judge(quiet, held, other.model, 8, other.fit)
        coarse, plain = levelled([other, current])
        if coarse.score > (plain.score if c.spec.name in PLIABLE else least):
            other = refined(quiet, held, other, lines.append)
    return c.spec.name, other, lines


def _plainer(rival: Judged, current: Judged) -> bool:
    """Fewer numbers, where the data do not see the further ones."""
    fewer = len(rival.model.coordinates) < len(current.model.coordinates)
    return fewer and rival.freedom >= current.freedom


def challengers(
    quiet: Scene,
    current: Judged,
    index: int,
    steps: Sequence[Step],
    reserve: frozenset[str],
    only: frozenset[str] | None = None,
) -> list[Candidate]:
    """Who is fitted in the place of effect `index`, from where the linear model stands beside it: its
    siblings and the best of the round it won, each at the point that promises most and at its own;
    of these `only` the ones so named."""
    spec = current.model.effects[index]
    names = list(EFFECTS[spec.name].siblings)
    if spec.name in DRY:  # whichever form came in first, the table is another of the same force
        names += PLIABLE
    for step in steps:
        if step.accepted is not None and step.accepted.model.names[-1] == spec.name:
            names += [r.model.names[-1] for r in step.rivals[:4]]
    company = current.model.without(index)
    taken = _excluded(company) | reserve
    wanted = [n for n in dict.fromkeys(names) if n not in taken and n != spec.name]
    if only is not None:
        wanted = [n for n in wanted if n in only]
        if not wanted:
            return []
    found = Screen(quiet, fit(quiet, company, rounds=0)).candidates([*wanted, spec.name])
    found.sort(key=lambda c: -(c.gain - 2 * PER_NUMBER * c.freedom))
    side = spec.options.get("side", "sensor")
    top = max((c.gain for c in found), default=0.0)
    chosen, others = [], []
    seen: set[str] = set()
    for c in found:
        own = c.spec.options.get("side", "sensor") == side
        if c.spec.name == spec.name:
            if not own and only is None:
                others.append(c)
        elif c.gain > 0.01 * top and (own or c.spec.name not in seen):
            (others if c.spec.name in seen else chosen).append(c)
            seen.add(c.spec.name)
    return [*chosen, *others][:CHALLENGERS]

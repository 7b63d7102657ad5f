"""What stands is put to the test again: every effect beside the others, against its rivals in that
company, backward elimination and substitution."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from ffl.diagnose.contest.believed import stays_in_a_believed_model
from ffl.diagnose.contest.dry import (
    BY_DIRECTION,
    CREEPING,
    DRY,
    FALLING,
    PLAINEST,
    PLIABLE,
    as_it_stands,
    contact_of,
    excluded,
    levels_of,
    plain_form,
)
from ffl.diagnose.contest.earning import SHARE, earns, gaining, stays
from ffl.diagnose.contest.evenly import of_its_mass
from ffl.diagnose.contest.falling import curves
from ffl.diagnose.contest.judging import (
    PER_NUMBER,
    Judged,
    between,
    credible,
    judge,
    levelled,
    likeliest,
)
from ffl.diagnose.contest.parallel import each
from ffl.diagnose.contest.rounds import Step
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import Fit, fit
from ffl.diagnose.hypothesis.friction_table import refined
from ffl.diagnose.hypothesis.ladders import with_best_start
from ffl.diagnose.hypothesis.places import point_of
from ffl.diagnose.screen.candidate import Candidate
from ffl.diagnose.screen.screen import Screen, as_measured
from ffl.effects import EFFECTS
from ffl.systems.plant import EffectSpec

KEEP = 20.0  # score an effect must be worth beside all others
RIVALS = 4  # names of the round that an effect won, the best of which are tried in its place again
SUBSTITUTE = 3.0  # score by which a sibling must be better
HOPELESS = 0.15  # of what an effect is worth: a rival further behind after a few steps stays there
# Of what an effect brings, that a pliable form must bring in its place: true tables brought 40 % and more
# (in a filter a quarter), one that bent to what noise makes of sticking 0.6 % (1.1 %).
LITTLE = 0.05
CHALLENGERS = 6  # most rivals that an effect must stand up to in the end


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
        say(
            f"  without {name}: {without.fitted - current.fitted:+.1f} fitted, "
            f"{without.held_out - current.held_out:+.1f} held out"
        )
        pair = (current, without, KEEP)
        worthy = stays(*pair) or stays_in_a_believed_model(quiet, *pair)
        if not worthy and (len(current.model.effects) > 1 or EFFECTS[name].scan):
            # A free run that goes its own way may gain hundreds by chance, the best sine of thousands 44.
            current = _in_another_form(quiet, held, current, without, index, steps, say)
            continue
        before = list(tried_before.get(name, ()))
        own = max((p for p in before if p[0] == name), key=lambda p: p[1].score, default=None)
        if own is None or abs(own[1].fitted - current.fitted) > SUBSTITUTE:
            before = []  # the company has changed since
        others = [(name, current), *(pair for pair in before if pair is not own)]
        only = _untried(name, before) if before else None
        found = challengers(quiet, current, index, steps, reserve, only)
        others += _in_its_place(quiet, held, current, without, index, found, say)
        names = [rival for rival, _ in others]
        *tried, alone = levelled([*(other for _, other in others), without])
        tried[1:] = between(quiet, tried[0], tried[1:])
        others = list(zip(names, tried, strict=True))
        current = others[0][1]
        for rival, other in others[1:]:
            say(f"  {rival} for {name}: {other.score - current.score:+.1f}")
        # The pliable must say more, not fit a little better.
        share = max(SHARE * len(current.fit.white), LITTLE * (current.score - alone.score))
        able = [
            (rival, other)
            for rival, other in others[1:]
            if earns(other, alone, 0.0)
            and (rival not in PLIABLE or name in PLIABLE or other.score > current.score + share)
        ]
        kept = gaining([current, *(other for _, other in able)], alone)
        able = [pair for pair in able if any(pair[1] is one for one in kept)]
        best_name, best = max([others[0], *able], key=lambda pair: pair[1].score)
        fewer = [p for p in able if _plainer(p[1], current)]
        simpler = max(fewer, key=lambda pair: pair[1].score, default=None)
        if simpler and simpler[1].score > best.score - SUBSTITUTE:  # it does the same with less
            best_name, current = simpler
        elif best.score > current.score + (0.0 if _fewer(best, current) else SUBSTITUTE):
            current = best
        else:
            best_name = name
        contenders[best_name] = others
    return current, contenders


def _untried(name: str, before: Sequence[tuple[str, Judged]]) -> frozenset[str]:
    """Rivals of an effect that had no leave to come in. Of one that came by substitution (the first of
    `before` stood then, and had its own siblings tried) also those of its siblings that were not."""
    late = {FALLING} if name == BY_DIRECTION else set()
    came = before[0][0] != name
    new = set(EFFECTS[name].siblings) - {rival for rival, _ in before} if came else set()
    return PLIABLE | late | new


def _in_another_form(
    quiet: Scene,
    held: Scene | None,
    current: Judged,
    without: Judged,
    index: int,
    steps: Sequence[Step],
    say: Callable[[str], None],
) -> Judged:
    """`without`, or `current` with another form of the dry friction `index`, which is not worth its place
    as it stands: the form may be wrong, not the friction. (Of a robot's axis levels by direction brought
    32 and lost 11 on what judges; one level for both brought 33 and 7.)"""
    if current.model.names[index] not in DRY:
        return without
    found = challengers(quiet, current, index, steps, PLIABLE, DRY)
    worth = [without]
    for name, other in _in_its_place(quiet, held, current, without, index, found, say):
        if earns(other, without, KEEP):
            say(f"  {name} for {current.model.names[index]}, which goes")
            worth.append(other)
    return likeliest(worth)


def _in_its_place(
    quiet: Scene,
    held: Scene | None,
    current: Judged,
    without: Judged,
    index: int,
    found: Sequence[Candidate],
    say: Callable[[str], None],
) -> list[tuple[str, Judged]]:
    """What each rival `found` for effect `index` reaches beside the other effects; those alone that have
    numbers of their physics."""
    trial = partial(_reached, quiet, held, current, without, index, quiet.cost(current.model))
    reached = []
    for rival, other, lines in each(trial, found):
        for line in lines:
            say(line)
        if credible(other):
            reached.append((rival, other))
    return reached


def one_for_two(
    quiet: Scene, held: Scene | None, current: Judged, say: Callable[[str], None]
) -> Judged:
    """One effect in the place of a dry friction and of a force beside it that may be two halves of it: a
    pliable form for a force by position, where it does more than both; levels by direction for a level
    and a constant load, where these are not worth one effect more."""
    names = current.model.names
    friction = next((i for i, n in enumerate(names) if n in DRY - PLIABLE), None)
    if friction is None:
        return current
    goal, found = quiet.cost(current.model), []
    for other, name in enumerate(names):
        if other == friction or name in current.model.proven:
            continue
        company = current.model.without(max(friction, other)).without(min(friction, other))
        begun: list[tuple[Fit, float]] = []  # and the score by which it must be ahead
        if "position" in EFFECTS[name].depends_on:
            like = fit(quiet, company, rounds=0)
            for c in Screen(quiet, like).candidates(sorted(PLIABLE))[:2]:
                start = with_best_start(quiet, c)
                one = fit(quiet, start, rounds=4, known=like.known(), goal=goal)
                if one.cost - goal <= HOPELESS * (like.cost - goal):
                    begun.append((one, SUBSTITUTE))
        elif whole := levels_of(current.model.effects[friction], current.model.effects[other]):
            begun.append((fit(quiet, company.with_effect(whole), rounds=4, goal=goal), -KEEP))
        for one, ahead in begun:
            whole_judged = refined(quiet, held, judge(quiet, held, one.model, 6, one), say)
            whole_judged, two = levelled([whole_judged, current])
            gained = whole_judged.score - two.score
            say(f"  {one.model.names[-1]} for {names[friction]} and {name}: {gained:+.1f}")
            if gained > ahead:
                found.append(whole_judged)
    if not found:
        return current
    return likeliest(found)


def _reached(
    quiet: Scene,
    held: Scene | None,
    current: Judged,
    without: Judged,
    index: int,
    goal: float,
    c: Candidate,
) -> tuple[str, Judged, list[str]]:
    """What a challenger reaches in the place of effect `index`, which `current` has and `without` has not:
    its name, its fit and what there is to say of it; `goal`: squares that `current` leaves."""
    lines: list[str] = []
    others = [*as_it_stands(current.model.effects[index], c), *curves(quiet, current, index, c)]
    start = with_best_start(quiet, c, others)
    begun = fit(quiet, start, rounds=4, known=c.like.shared(start), goal=goal)
    other = judge(quiet, held, begun.model, 4, begun)
    least = current.score - HOPELESS * (current.score - without.score)
    if other.score > least:
        other = judge(quiet, held, other.model, 8, other.fit)
        coarse, plain = levelled([other, current])
        if coarse.score > (plain.score if c.spec.name in PLIABLE else least):
            other = refined(quiet, held, other, lines.append)
    return c.spec.name, of_its_mass(held, other), lines


def _plainer(rival: Judged, current: Judged) -> bool:
    """Fewer numbers, where the data do not see the further ones."""
    return _fewer(rival, current) and rival.freedom >= current.freedom


def _fewer(rival: Judged, current: Judged) -> bool:
    return len(rival.model.coordinates) < len(current.model.coordinates)


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
    if spec.name == BY_DIRECTION and not reserve:
        names.append(FALLING)
    for step in steps:
        if spec.name in step.joined:
            names += list(dict.fromkeys(r.model.names[-1] for r in step.rivals))[:RIVALS]
        elif step.accepted is not None:  # who was there before, if it no longer is
            names.append(step.accepted.model.names[-1])
    company = current.model.without(index)
    taken = excluded(company) | reserve
    if not company.base.plant.is_identified:
        taken |= CREEPING
    asked = [n for n in dict.fromkeys(names) if only is None or n in only]
    wanted = [n for n in asked if n not in taken and n != spec.name]
    if only is not None and not wanted:
        return []
    beside = fit(quiet, company, rounds=0)
    screen = as_measured(quiet, beside) or Screen(quiet, beside)
    found = screen.candidates([*wanted, spec.name])
    found.sort(key=lambda c: -(c.gain - 2 * PER_NUMBER * c.freedom))
    side = spec.options.get("side", "sensor")
    top = max((c.gain for c in found), default=0.0)
    chosen: list[Candidate] = []
    others: list[Candidate] = []
    seen: set[str] = set()
    for c in found:
        own = c.spec.options.get("side", "sensor") == side
        if c.spec.name == spec.name:
            if not own and only is None:
                others.append(c)
        elif own and c.spec.name == PLAINEST and plain_form(spec):
            continue
        elif c.gain > 0.01 * top and (own or c.spec.name not in seen):
            (others if c.spec.name in seen else chosen).append(c)
            seen.add(c.spec.name)
    return [*_given(spec, wanted, beside), *chosen, *others][:CHALLENGERS]


def _given(spec: EffectSpec, wanted: Sequence[str], like: Fit) -> list[Candidate]:
    """The plainest form of a friction and the contact that it may be, if `wanted`, where it acts, whatever
    a screen promises: without friction a loop at its limit may run away, and no column says anything."""
    forms = [form for form in (plain_form(spec), contact_of(spec)) if form is not None]
    return [Candidate(f, 0.0, 1, point_of(spec), like) for f in forms if f.name in wanted]

"""Several effects at once: where each alone explains little and all of them explain nearly everything.

Strong effects hide one another. The linear model's own numbers bend towards all of them, and the one
effect that does best alone may be none of them. To first order, though, a set of effects is as easily
judged as one: beside each of the best the whole catalogue is screened again, beyond what that one
explains, and a set that leaves a small part of what any smaller one does has its shapes tuned to first
order as well, and is fitted as a set, from there.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any

import numpy as np
import scipy.optimize

from ffl.diagnose.contest.dry import DRY
from ffl.diagnose.contest.earning import earns
from ffl.diagnose.contest.judging import Judged, credible, judge, levelled, likeliest
from ffl.diagnose.contest.parallel import each
from ffl.diagnose.contest.scene import Scene, is_far
from ffl.diagnose.hypothesis.fit import Fit, fit
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.triangle import lengths, triangle
from ffl.diagnose.recorded.starts import with_clocks, with_starts
from ffl.diagnose.screen.candidate import Candidate, with_coefficients
from ffl.diagnose.screen.drives import blocked
from ffl.diagnose.screen.kinds import POSITIVE
from ffl.diagnose.screen.screen import PER_COLUMN, Screen, catalogue
from ffl.effects import EFFECTS
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

FIRST = 4  # effects beside which all others are screened again, the best of the screen
NEXT = 5  # of these that are looked at, for each
LEFT = 0.98  # of what the best single effect leaves, to first order: what a pair may leave
THIRD = 0.85  # of what a pair leaves: what a third may leave
ENOUGH = 1.5  # mean square, in units of the noise, that a single effect leaves where it is all
TUNED = 6  # pairs whose shapes are tuned
HIDDEN = 0.1  # of what the best single effect leaves: it tells nothing
GROWN = 2  # pairs beside which a third effect is looked for
BEHIND = 2.0  # times what a single effect leaves, fitted: what a set may leave before it is
TRIED = 3  # sets that are fitted
BEGUN = 8  # rounds by which it is seen how far a set gets
STEPS = 12  # rounds of the best
REACH = 1.5  # logarithm: how far a shape is moved from the grid's
REPEATS = 0.03  # the same for what repeats, between the grid's lines
RUNGS = np.linspace(-0.98, 0.98, 15)  # of the reach
DIFFERENCE = 1e-3  # logarithm: step of a difference
EVALUATIONS = 12


@dataclass(frozen=True)
class Together:
    """Effects, `specs`, that to first order leave a sum of squares `left` beside `screen.fit`, numbers
    charged, and the candidates they came from."""

    screen: Screen
    candidates: tuple[Candidate, ...]
    specs: tuple[EffectSpec, ...]
    left: float
    share: float = 1.0  # of what the best single effect leaves

    @property
    def like(self) -> Fit:
        return self.screen.fit

    @property
    def model(self) -> Model:
        """The model of `like` with all of them, within bounds."""
        model = self.like.model
        for spec in self.specs:
            model = model.with_effect(spec)
        return model.at(model.theta)


def starts(
    base: Judged, screens: Sequence[tuple[Screen, Sequence[Candidate]]], most: int
) -> list[Together]:
    """Sets of effects, `most` at most, that to first order leave much less than any single one, the best of
    every view in turn, the view along the measured motion first; none near what was measured, where one
    comes after the other. (What is left along one motion says nothing of what is left along another: on a
    robot's joint, gravity and dry friction left 0.11 of what the best single one does along the simulated
    motion, and things that undo the command 0.05 along the measured one.)"""
    if most < 2 or not base.fit.far:
        return []
    found = [_best(sets(screen, seen, most), TUNED) for screen, seen in reversed(screens)]
    in_turn = [one for row in zip_longest(*found) for one in row if one is not None]
    return in_turn[:TUNED]


def together(
    quiet: Scene,
    held: Scene | None,
    base: Judged,
    found: Sequence[Together],
    threshold: float,
    say: Callable[[str], None],
    single: Judged | None = None,
) -> Judged | None:
    """`base` with the best of the sets that were `found`, of those that are not far behind a `single`
    effect that stands by now; None where none is left or it does not earn its place."""
    most = quiet.cost(base.model)
    if single is not None:
        most = min(most, BEHIND * quiet.cost(single.model))

    def nearer(start: Together) -> Model | None:
        """As a simulation: along a measured command a dead zone as wide as a limit lets nothing through,
        and first order finds that the command explains itself."""
        model = start.model
        return model if quiet.cost(model) < most else None

    def begun(model: Model) -> tuple[Scene, Fit]:
        scene = with_starts(with_clocks(quiet, model, 1), model)
        return scene, fit(scene, model, rounds=BEGUN)

    sound = [model for model in each(nearer, found) if model is not None]
    tried = each(begun, sound[:TRIED])
    if not tried:
        return None
    # By the noise of each: what one leaves may be slow, and more of it than of what is noise at no time.
    all_judged = each(lambda entry: judge(entry[0], held, entry[1].model, STEPS, entry[1]), tried)
    judged = likeliest([j for j in all_judged if credible(j)] or all_judged)
    say(
        f"  together {judged.name}: {judged.fitted - base.fitted:+.1f} fitted, "
        f"{judged.held_out - base.held_out:+.1f} held out"
    )
    judged, base = levelled([judged, base])
    return judged if earns(judged, base, threshold) else None


def sets(screen: Screen, seen: Sequence[Candidate], most: int = 2) -> list[Together]:
    """Pairs, tuned, that leave much less than any single effect of those `seen`, and what some of them
    are part of where a third leaves much less than they do; best first. None where one is enough."""
    allowed = {c.spec.name for c in seen}
    solved = [_solved(screen, (c,)) for c in _best_of_each(seen)[:FIRST]]
    alone = [one for one in solved if one is not None]
    least = min((one.left for one in alone), default=0.0)
    if least < ENOUGH * len(screen.residual):
        return []
    pairs = [pair for found in grown(alone, allowed) for pair in found]
    different = {
        frozenset(spec.name for spec in p.specs): p for p in reversed(_best(pairs, len(pairs)))
    }
    tried = [p for p in _best(list(different.values()), TUNED) if p.left < least]
    found = [p for p in _best(each(tuned, tried), TUNED) if p.left < LEFT * least]
    if most > 2:
        found = _larger(found, allowed)
    return [replace(one, share=one.left / least) for one in _best(found, TUNED)]


def _larger(pairs: Sequence[Together], allowed: Collection[str]) -> list[Together]:
    """The pairs, the best of them as what they are part of where a third effect leaves much less."""
    # Near what was measured one comes after the other.
    far = [p for p in pairs[:GROWN] if is_far(p.left, len(p.screen.residual))]

    def third(entry: tuple[Together, list[Together]]) -> Together:
        pair, found = entry
        more = _best(found, 1)
        best = tuned(more[0]) if more else pair
        return best if best.left < THIRD * pair.left else pair

    larger = each(third, zip(far, grown(far, allowed), strict=True))
    others = dict(zip(map(id, far), larger, strict=True))
    return [others.get(id(pair), pair) for pair in pairs]


def grown(starts: Sequence[Together], allowed: Collection[str]) -> list[list[Together]]:
    """Each of the `starts`, all of one view, with each of the best effects beyond what it explains."""

    def beyond(start: Together) -> tuple[Screen, set[str]]:
        names = {spec.name for spec in start.specs}
        others = set(allowed) - names - (DRY if names & DRY else set())  # two forms of one friction
        tables = [start.screen.table_of(c) for c in start.candidates]
        return start.screen.beside(tables), others

    def with_more(entry: tuple[Together, list[Candidate]]) -> list[Together]:
        start, seen = entry
        found = [_solved(start.screen, (*start.candidates, c)) for c in _best_of_each(seen)[:NEXT]]
        return [one for one in found if one is not None]

    if not starts:
        return []
    return each(with_more, zip(starts, catalogue([beyond(s) for s in starts]), strict=True))


def tuned(start: Together) -> Together:
    """The same with the shapes of all, finer than any grid, that leave least to first order."""
    shapes = [(k, name) for k, c in enumerate(start.candidates) for name in _shapes(c)]
    if not shapes:
        return start
    centre = np.log([start.candidates[k].nonlinear[name] for k, name in shapes])
    effects = [EFFECTS[c.spec.name] for c in start.candidates]
    reach = [REPEATS if effects[k].scan else REACH for k, _ in shapes]

    def at(x: Array) -> tuple[Candidate, ...]:
        values = [dict(c.nonlinear) for c in start.candidates]
        for (k, name), number in zip(shapes, x, strict=True):
            ends = ((p.lower, p.upper) for p in effects[k].parameters if p.name == name)
            values[k][name] = float(np.clip(np.exp(number), *next(ends, (-np.inf, np.inf))))
        pairs = zip(start.candidates, values, strict=True)
        return tuple(replace(c, nonlinear=v) for c, v in pairs)

    seen: dict[tuple[str, tuple[Any, ...]], Array] = {}

    def table(c: Candidate) -> Array:
        key = c.spec.name, tuple(sorted(c.nonlinear.items()))
        if key not in seen:
            seen[key] = start.screen.beyond(start.screen.table_of(c))
        return seen[key]

    def left(x: Array) -> Array:
        candidates = at(x)
        return _left(start.screen, candidates, [table(c) for c in candidates])[0]

    best = centre.copy()
    for k, far in enumerate(reach):  # not convex: number by number along a ladder, then downhill
        rungs = [np.where(np.arange(len(best)) == k, centre + s, best) for s in RUNGS * far]
        best = min(rungs, key=lambda x: float(np.sum(left(x) ** 2)))
    found = scipy.optimize.least_squares(
        left,
        best,
        bounds=(centre - reach, centre + reach),
        diff_step=DIFFERENCE,
        max_nfev=EVALUATIONS,
    )
    other = _solved(start.screen, at(found.x))
    return other if other is not None and other.left < start.left else start


def _best(listed: Sequence[Together], most: int) -> list[Together]:
    return sorted(listed, key=lambda one: one.left)[:most]


def _best_of_each(seen: Sequence[Candidate]) -> list[Candidate]:
    """The best candidate by each name, of dry friction in any form one, best first."""
    best: dict[str, Candidate] = {}
    seen = [c for c in seen if not _softens(c.spec)]
    for c in sorted(seen, key=lambda c: -(c.gain - PER_COLUMN * c.freedom)):
        best.setdefault("dry" if c.spec.name in DRY else c.spec.name, c)
    return list(best.values())


def _shapes(c: Candidate) -> list[str]:
    """The positive numbers that shape the candidate's columns."""
    parameters = EFFECTS[c.spec.name].parameters
    own = {p.name for p in parameters if p.lower >= 0.0 and not p.known} | {"shape"}
    return [n for n, v in c.nonlinear.items() if n in own and isinstance(v, float) and v > 0.0]


def _solved(screen: Screen, candidates: tuple[Candidate, ...]) -> Together | None:
    """The candidates together, with the coefficients that leave least; None where one of them is of the
    wrong sign."""
    tables = [screen.beyond(screen.table_of(c)) for c in candidates]
    left, coefficients = _left(screen, candidates, tables)
    specs = tuple(map(with_coefficients, candidates, coefficients))
    for spec, own in zip(specs, coefficients, strict=True):
        if (spec.name in POSITIVE and np.any(own < 0)) or _softens(spec) or _none(spec):
            return None
    if blocked(screen, candidates, coefficients):
        return None
    charged = float(left @ left) + PER_COLUMN * sum(c.freedom for c in candidates)
    return Together(screen, candidates, specs, charged)


def _softens(spec: EffectSpec) -> bool:
    """A spring that gives way the further it is pulled: in a set it holds whatever any force does."""
    return bool(spec.parameters.get("cubic_coefficient", 0.0) < 0.0)


def _none(spec: EffectSpec) -> bool:
    """A magnitude came out below nothing."""
    amounts = [p.name for p in EFFECTS[spec.name].parameters if p.linear and p.lower == 0.0]
    return any(spec.parameters.get(name) == 0.0 for name in amounts)


def _left(
    screen: Screen, candidates: Sequence[Candidate], tables: Sequence[Array]
) -> tuple[Array, list[Array]]:
    """(what they leave of the residual, coefficients of each) from their `tables` beyond the model's own
    freedom; an amount fixed by nature is 1."""
    fixed = [EFFECTS[c.spec.name].fixed_amount for c in candidates]
    left = screen.residual - sum(t[:, 0] for t, one in zip(tables, fixed, strict=True) if one)
    free = [t for t, one in zip(tables, fixed, strict=True) if not one]
    if not free:
        return left, [np.ones(1) for _ in tables]
    table = np.hstack(free)
    if not np.all(np.isfinite(table)):  # a shape on the way that no machine has
        return screen.residual, [np.ones(t.shape[1]) for t in tables]
    size = np.maximum(lengths(table), 1e-300)
    r, aim = triangle(table / size, left)
    scaled = np.linalg.lstsq(r, aim, rcond=1e-7)[0] / size
    own = iter(np.split(scaled, np.cumsum([t.shape[1] for t in free])[:-1]))
    return left - table @ scaled, [np.ones(1) if one else next(own) for one in fixed]

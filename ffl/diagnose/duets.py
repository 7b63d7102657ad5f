"""Two effects at once: where each alone explains little and both explain nearly all.

Two strong effects hide one another. The linear model's own numbers bend towards both, and the one
effect that does best alone is then neither of them. To first order, though, columns of two effects are
as easily judged as those of one: a pair that leaves a small part of what any single effect does has its
shapes tuned to first order as well, and is fitted as a pair, from there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
import scipy.optimize

from ffl.diagnose.candidate import Candidate, with_coefficients
from ffl.diagnose.fit import Fit, Scene, fit
from ffl.diagnose.followed import SWINGS
from ffl.diagnose.judging import Judged, earns, judge, levelled
from ffl.diagnose.parallel import each
from ffl.diagnose.screen import PER_COLUMN, POSITIVE, Screen
from ffl.diagnose.settle import DRY, KEEP
from ffl.diagnose.starts import with_clocks, with_starts
from ffl.diagnose.triangle import lengths, triangle
from ffl.effects import EFFECTS
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

LISTED = 10  # effects of which pairs are made, the best of the screen
LEFT = 0.85  # of what the best single effect leaves: what a pair may leave, to first order
TUNED = 6  # pairs whose shapes are tuned
TRIED = 3  # pairs that are fitted
BEGUN = 8  # rounds by which it is seen how far a pair gets
STEPS = 12  # rounds of the best
REACH = 1.5  # logarithm: how far a shape is moved from the grid's
REPEATS = 0.03  # the same for what repeats, between the grid's lines
RUNGS = np.linspace(-0.98, 0.98, 15)  # of the reach
DIFFERENCE = 1e-3  # logarithm: step of a difference
EVALUATIONS = 12


@dataclass(frozen=True)
class Pair:
    """Two effects, `specs`, that to first order leave a sum of squares `left` beside `screen.fit`, and
    the candidates they came from."""

    screen: Screen
    candidates: tuple[Candidate, Candidate]
    specs: tuple[EffectSpec, EffectSpec]
    left: float

    @property
    def like(self) -> Fit:
        return self.screen.fit


def duet(
    quiet: Scene,
    held: Scene | None,
    base: Judged,
    screens: Sequence[tuple[Screen, Sequence[Candidate]]],
    single: Judged | None,
    threshold: float,
    say: Callable[[str], None],
) -> Judged | None:
    """`base` with the two effects that together explain what no `single` one does, or None."""
    if base.fit.cost < SWINGS * len(base.fit.white):
        return None  # near what was measured one comes after the other
    starts = [pair for screen, seen in screens for pair in pairs(screen, seen)]
    starts = _best(each(tuned, _best(starts, TUNED)), TRIED)

    def begun(pair: Pair) -> tuple[Scene, Fit]:
        model = pair.like.model
        for spec in pair.specs:
            model = model.with_effect(spec)
        model = model.at(model.theta)  # within bounds
        scene = with_starts(with_clocks(quiet, model, 1), model)
        return scene, fit(scene, model, rounds=BEGUN)

    tried = each(begun, starts)
    if not tried:
        return None
    scene, first = min(tried, key=lambda entry: entry[1].cost)
    judged = judge(scene, held, first.model, STEPS, first)
    say(
        f"  both {judged.name}: {judged.fitted - base.fitted:+.1f} fitted, "
        f"{judged.held_out - base.held_out:+.1f} held out"
    )
    judged, base, *rest = levelled([judged, base, *([] if single is None else [single])])
    if any(judged.score < other.score + KEEP for other in rest):
        return None
    return judged if earns(judged, base, threshold) else None


def pairs(screen: Screen, seen: Sequence[Candidate]) -> list[Pair]:
    """Those that leave much less than any single effect, best first."""
    best: dict[str, Candidate] = {}
    for c in seen:
        best.setdefault(c.spec.name, c)
    listed = sorted(best.values(), key=lambda c: -(c.gain - PER_COLUMN * c.freedom))[:LISTED]
    if len(listed) < 2:
        return []
    tables = [screen.beyond(screen.table_of(c)) for c in listed]
    r, target = triangle(np.hstack(tables), screen.residual)
    whole = float(screen.residual @ screen.residual)
    cuts = np.cumsum([0, *[table.shape[1] for table in tables]])
    parts = [slice(a, b) for a, b in pairwise(cuts)]
    least = whole - max(c.gain for c in listed)
    out = []
    for i, k in combinations(range(len(listed)), 2):
        one, other = listed[i], listed[k]
        if {one.spec.name, other.spec.name} <= DRY:
            continue  # two forms of one friction
        found = _together(r[:, parts[i]], r[:, parts[k]], target)
        if found is None:
            continue
        gain, mine, its = found
        if _negative(one, mine) or _negative(other, its):
            continue
        left = whole - gain + PER_COLUMN * (one.freedom + other.freedom)
        if left < LEFT * least:
            specs = with_coefficients(one, mine), with_coefficients(other, its)
            out.append(Pair(screen, (one, other), specs, left))
    return _best(out, len(out))


def _best(listed: Sequence[Pair], most: int) -> list[Pair]:
    return sorted(listed, key=lambda pair: pair.left)[:most]


def tuned(pair: Pair) -> Pair:
    """The pair with the shapes of both, finer than any grid, that leave least to first order."""
    shapes = [(k, name) for k, c in enumerate(pair.candidates) for name in _shapes(c)]
    if not shapes:
        return pair
    began = np.log([pair.candidates[k].nonlinear[name] for k, name in shapes])
    reach = [REPEATS if EFFECTS[pair.candidates[k].spec.name].scan else REACH for k, _ in shapes]

    def at(x: Array) -> tuple[tuple[Candidate, Candidate], Array, list[Array]]:
        values = [dict(c.nonlinear) for c in pair.candidates]
        for (k, name), number in zip(shapes, x, strict=True):
            values[k][name] = float(np.exp(number))
        one, other = (replace(c, nonlinear=v) for c, v in zip(pair.candidates, values, strict=True))
        tables = [pair.screen.beyond(pair.screen.table_of(c)) for c in (one, other)]
        return (one, other), *_solved(pair.screen.residual, tables, (one, other))

    start = began.copy()
    for k, far in enumerate(reach):  # not convex: number by number along a ladder, then downhill
        rungs = [np.where(np.arange(len(start)) == k, began + s, start) for s in RUNGS * far]
        start = min(rungs, key=lambda x: float(np.sum(at(x)[1] ** 2)))
    found = scipy.optimize.least_squares(
        lambda x: at(x)[1],
        start,
        bounds=(began - reach, began + reach),
        diff_step=DIFFERENCE,
        max_nfev=EVALUATIONS,
    )
    candidates, left, coefficients = at(found.x)
    cost = float(left @ left) + PER_COLUMN * sum(c.freedom for c in candidates)
    wrong = any(map(_negative, candidates, coefficients))
    if wrong or not cost < pair.left:
        return pair
    specs = tuple(map(with_coefficients, candidates, coefficients))
    return replace(pair, candidates=candidates, specs=specs, left=cost)


def _shapes(c: Candidate) -> list[str]:
    """The positive numbers that shape the candidate's columns."""
    own = {p.name for p in EFFECTS[c.spec.name].parameters if p.lower >= 0.0} | {"shape"}
    return [n for n, v in c.nonlinear.items() if n in own and isinstance(v, float) and v > 0.0]


def _solved(
    target: Array, tables: Sequence[Array], candidates: Sequence[Candidate]
) -> tuple[Array, list[Array]]:
    """(what both leave of the target, coefficients of each); an amount that is fixed by nature is 1."""
    fixed = [EFFECTS[c.spec.name].fixed_amount for c in candidates]
    left = target - sum(t[:, 0] for t, one in zip(tables, fixed, strict=True) if one)
    free = [t for t, one in zip(tables, fixed, strict=True) if not one]
    if not free:
        return left, [np.ones(1) for _ in tables]
    table = np.hstack(free)
    size = np.maximum(lengths(table), 1e-300)
    r, aim = triangle(table / size, left)
    scaled = np.linalg.lstsq(r, aim, rcond=1e-7)[0] / size
    cuts = np.cumsum([t.shape[1] for t in free])[:-1]
    own = iter(np.split(scaled, cuts))
    return left - table @ scaled, [np.ones(1) if one else next(own) for one in fixed]


def _together(one: Array, other: Array, target: Array) -> tuple[float, Array, Array] | None:
    """(what both take off the sum of squares, coefficients of each) from columns of a triangle."""
    both = np.hstack([one, other])
    size = np.maximum(np.linalg.norm(both, axis=0), 1e-300)
    coefficients, _, rank, _ = np.linalg.lstsq(both / size, target, rcond=1e-7)
    if rank < both.shape[1]:
        return None
    left = target - both @ (coefficients / size)
    coefficients = coefficients / size
    gain = float(target @ target - left @ left)
    return gain, coefficients[: one.shape[1]], coefficients[one.shape[1] :]


def _negative(c: Candidate, coefficients: Array) -> bool:
    return c.spec.name in POSITIVE and bool(np.any(coefficients < 0))

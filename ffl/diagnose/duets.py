"""Two effects at once: where each alone explains little and both explain nearly all.

Two strong effects hide one another. The linear model's own numbers bend towards both, and the one
effect that does best alone is then neither of them. To first order, though, columns of two effects are
as easily judged as those of one: a pair that leaves a small part of what any single effect does is
fitted as a pair, from there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations, pairwise

import numpy as np

from ffl.diagnose.candidate import Candidate, with_coefficients
from ffl.diagnose.fit import Scene, fit
from ffl.diagnose.judging import Judged, earns, judge, levelled
from ffl.diagnose.ladders import SWINGS
from ffl.diagnose.parallel import each
from ffl.diagnose.screen import PER_COLUMN, POSITIVE, Screen
from ffl.diagnose.settle import DRY, KEEP
from ffl.diagnose.starts import with_clocks, with_starts
from ffl.diagnose.triangle import triangle
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

LISTED = 10  # effects of which pairs are made, the best of the screen
LEFT = 0.85  # of what the best single effect leaves: what a pair may leave, to first order
TRIED = 3  # pairs that are fitted
BEGUN = 8  # rounds by which it is seen how far a pair gets
STEPS = 12  # rounds of the best


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
    starts = [start for screen, seen in screens for start in pairs(screen, seen)]
    starts.sort(key=lambda start: start[0])

    def begun(start: tuple[float, Candidate, Sequence[EffectSpec]]):  # type: ignore[no-untyped-def]
        _, like, specs = start
        model = like.like.model
        for spec in specs:
            model = model.with_effect(spec)
        model = model.at(model.theta)  # within bounds
        scene = with_starts(with_clocks(quiet, model, 1), model)
        return scene, fit(scene, model, rounds=BEGUN)

    tried = each(begun, starts[:TRIED])
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


def pairs(
    screen: Screen, seen: Sequence[Candidate]
) -> list[tuple[float, Candidate, list[EffectSpec]]]:
    """(sum of squares left, a candidate, both effects with their coefficients) of the pairs that leave
    much less than any single effect, best first."""
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
            specs = [with_coefficients(one, mine), with_coefficients(other, its)]
            out.append((left, one, specs))
    return sorted(out, key=lambda start: start[0])


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

"""A few shapes put together to what a map's data see of it.

A shape at a time, as many ways as are worth it side by side: who does best alone may be no part of what
does best together (two hinges at the ends of a slack strap were a cubic and a bell; u and u |u| a sine and
a hinge). After each, the inner numbers (a centre, a width, a period) are refined together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
import scipy.linalg
import scipy.optimize

from ffl.diagnose.maps.shapes import Shape
from ffl.systems.state_space import Array

MOST = 3  # terms of a formula
WAYS = 5  # that are gone on from side by side
FAMILIES = 6  # of shapes that are tried on each
PER_NUMBER = 8.0  # sum of squares that one more number must take off
CANCELS = 30.0  # times the largest sum: terms so large say nothing
SHARE = 0.01  # of what the map itself takes off, that one more term must take off
INNER = 0.1  # of that, what one more number within a term must
FINER = 8  # points to a piece between two knots
FLOOR = 1e-8  # of a column's length: what is left of it beside others is rounding


@dataclass(frozen=True)
class Map:
    """What the data see of a map over its grid `z` (k,): |q - r values|^2."""

    z: Array
    r: Array
    q: Array

    @cached_property
    def _between(self) -> tuple[Array, Array]:
        """(Points between the knots too, (m,), what takes values there to the knots of the straight pieces
        that are nearest to them, (k, m))."""
        knots = np.arange(len(self.z))
        points = np.interp(np.arange(FINER * (len(knots) - 1) + 1) / FINER, knots, self.z)
        hats = np.column_stack([np.interp(points, self.z, hat) for hat in np.eye(len(knots))])
        weights = np.sqrt(np.gradient(points))
        q, r = np.linalg.qr(hats * weights[:, None])
        return points, scipy.linalg.solve_triangular(r, q.T * weights)

    def columns(self, shapes: Sequence[Shape]) -> Array:
        """The `shapes` as a map draws them: the straight pieces that are nearest to each overshoot it at
        the knots. (A cosine of five knots a period by 14 %.)"""
        points, to_knots = self._between
        return to_knots @ columns_of(shapes, points)

    def cost(self, shapes: Sequence[Shape]) -> float:
        with np.errstate(all="ignore"):  # a shape whose width has come to nothing
            columns = self.columns(shapes)
        if not np.all(np.isfinite(columns)):
            return 1e300
        table = self.r @ columns
        weights = np.linalg.lstsq(table, self.q, rcond=1e-10)[0]
        return float(np.sum((self.q - table @ weights) ** 2))


def columns_of(shapes: Sequence[Shape], z: Array) -> Array:
    return np.column_stack([s.columns(z, *s.inner) for s in shapes])


def composed(pool: Sequence[Shape], seen: Map, best: float) -> list[Shape]:
    """The sum of `MOST` shapes of the `pool` at most that leaves least for its length; none where no shape
    takes off `SHARE` of what the map itself does, `best`."""
    traces = [seen.r @ seen.columns([s]) for s in pool]

    def price(shapes: Sequence[Shape]) -> float:
        terms = len(shapes) + INNER * sum(len(s.inner) for s in shapes)
        dear = SHARE * best * terms + PER_NUMBER * sum(s.numbers for s in shapes)
        return (seen.cost(shapes) if shapes else float(seen.q @ seen.q)) + dear

    ways: list[list[Shape]] = [[]]
    found, least = [], price([])
    for _ in range(MOST):
        longer = [
            _refined([*way, shape], seen)
            for way in ways
            for shape in _promising(way, pool, traces, seen)
        ]
        longer = [way for way in longer if not _cancel(way, seen)]
        longer.sort(key=price)
        ways = _apart(longer)
        if not ways:
            break
        if (cheapest := price(ways[0])) < least:
            found, least = ways[0], cheapest
    plain = [s for s in pool if not s.inner]  # of these every set is soon tried
    sets = [list(some) for k in range(MOST) for some in combinations(plain, k + 1)]
    for some in sorted(sets, key=price):
        if price(some) < least and not _cancel(some, seen):
            return some
    return found


def _promising(
    way: Sequence[Shape], pool: Sequence[Shape], traces: Sequence[Array], seen: Map
) -> list[Shape]:
    """Of the shapes that take most off what `way` leaves the best of each family."""
    base = seen.r @ seen.columns(way) if way else np.zeros((len(seen.q), 0))
    basis = np.linalg.qr(base)[0]
    left = seen.q - basis @ (basis.T @ seen.q)
    best: dict[str, tuple[float, Shape]] = {}
    for shape, trace in zip(pool, traces, strict=True):
        beside = trace - basis @ (basis.T @ trace)
        if np.linalg.norm(beside) < FLOOR * np.linalg.norm(trace):
            continue
        own = np.linalg.qr(beside)[0]
        worth = float(np.sum((own.T @ left) ** 2)) - PER_NUMBER * shape.numbers
        if shape.text not in best or worth > best[shape.text][0]:
            best[shape.text] = worth, shape
    first = sorted(best.values(), key=lambda pair: -pair[0])[:FAMILIES]
    return [shape for _, shape in first]


def _apart(ways: Sequence[list[Shape]]) -> list[list[Shape]]:
    """The first `WAYS`, one of each set of families."""
    seen: dict[tuple[str, ...], list[Shape]] = {}
    for way in ways:
        seen.setdefault(tuple(sorted(s.text for s in way)), way)
    return list(seen.values())[:WAYS]


def _cancel(shapes: Sequence[Shape], seen: Map) -> bool:
    """Whether the terms are much larger than their sum: two that undo one another draw what lies between
    them. (1.163e7 N m of sign and as much of tanh over a sample's speed.)"""
    table = seen.columns(shapes)
    terms = table * np.linalg.lstsq(seen.r @ table, seen.q, rcond=1e-10)[0]
    return bool(np.abs(terms).max() > CANCELS * np.abs(terms.sum(axis=1)).max())


def _refined(shapes: list[Shape], seen: Map) -> list[Shape]:
    """The inner numbers of all shapes together, by a simplex from where they are."""
    counts = [len(s.inner) for s in shapes]
    start = np.array([v for s in shapes for v in s.inner])
    if not len(start):
        return shapes
    steps = np.repeat([s.step for s in shapes], counts)
    widest = 10 * float(seen.z[-1] - seen.z[0]) + float(np.abs(seen.z).max())
    bound = np.repeat([min(s.most, widest) for s in shapes], counts)

    def at(p: Array) -> list[Shape]:
        pieces = np.split(p, np.cumsum(counts)[:-1])
        return [
            replace(s, inner=tuple(map(float, own))) for s, own in zip(shapes, pieces, strict=True)
        ]

    def cost(p: Array) -> float:
        return seen.cost(at(p)) if np.all(np.abs(p) < bound) else 1e300

    found = scipy.optimize.minimize(
        cost, start, method="Nelder-Mead",
        options={
            "initial_simplex": np.vstack([start, start + np.diag(steps)]),
            "maxfev": 60 * len(start) + 60,
        },
    )  # fmt: skip
    return at(found.x) if found.fun < cost(start) else shapes

"""Numbers of what is foretold moved one by one: where moments of contact jump with every number,
derivatives say little."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.hypothesis.fit import Fit
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.predict.foretold import Told, refitted
from ffl.diagnose.recorded.trials import Trial
from ffl.systems.state_space import Array

TRIES = 5  # steps of a move
FAR, SCALE = 0.2, (0.1, 3.0)  # of a unit, where a search for doubt begins; of a step the next
STEEP, REACHES = 20.0, 8  # times the roughness: a fall that tells a curvature, and tries to find it
MOVES = (0.2, 0.1, 0.05)  # of a number's unit, one after the other
SURE = 2.0  # standard errors that a play must be wide
MANY = 8  # knots of a table: more are not moved one by one
BRACKET = (0.5, 1.5)  # times a gap, between which it is


def moved(
    point: Told, trials: Sequence[Trial], sizes: Sequence[float] = MOVES, *, mass: bool = False
) -> Told:
    """All numbers of the effects but for `long_tables`, and the mass, moved one by one as long as it
    helps."""
    worth = point.worth(trials)
    coordinates, shapes = point.model.coordinates, long_tables(point.model)
    own = [k for k, c in enumerate(coordinates) if c.kind != "correction" and k not in shapes]
    for size in sizes:
        for k in [*(masses(point.model) if mass else ()), *own]:
            way = np.zeros(len(coordinates))
            way[k] = size * units(point)[k]
            point, worth = walked(point, worth, way, trials)
    return point


def walked(point: Told, worth: float, way: Array, trials: Sequence[Trial]) -> tuple[Told, float]:
    """(the point, its worth) after steps of `way`, forth or back, as many as help."""
    for sign in (1.0, -1.0):
        for _ in range(TRIES):
            tried = point.at(point.theta + sign * way)
            value = tried.worth(trials)
            if not value > worth:
                break
            point, worth = tried, value
    return point, worth


def doubted(fit: Fit, point: Told, trials: Sequence[Trial], rough: float) -> Fit:
    """`fit` of `point` with standard errors of the effects' numbers no smaller than a likelihood that is
    `rough` by so much can tell. Where it falls by x^2/(2 s^2) over x its best is no nearer to the truth
    than s sqrt(1 + 2 rough): asked along each combination of numbers that the derivatives tell apart, of
    which those with a jump in them say far too much, over a fall that is many times the roughness; a unit
    at most. What no sample sees remains in doubt."""
    seen = np.any(fit.jacobian != 0.0, axis=0)
    coordinates = enumerate(point.model.coordinates)
    own = [k for k, c in coordinates if c.kind != "correction" and seen[k]]
    unit = units(point)[own]
    table = fit.jacobian[:, own] * unit
    _, told, ways = np.linalg.svd(table, full_matrices=False)
    worth, share = point.worth(trials), np.ones(len(told))
    for k, way in enumerate(ways):
        step = np.zeros(len(point.theta))
        step[own], length, fall = unit * way, FAR, 0.0
        for _ in range(REACHES):
            there = [point.at(point.theta + x * step).worth(trials) for x in (length, -length)]
            fall = float(np.mean(np.maximum(worth - np.array(there), 0.0)))
            if rough < fall < STEEP * rough or (fall <= rough and length >= 1.0):
                break
            length *= np.clip(np.sqrt(0.2 * STEEP * rough / max(fall, 1e-300)), *SCALE)
        seen = np.sqrt(2.0 * fall / (1.0 + 2.0 * rough)) / length  # 1/(s sqrt(1 + 2 rough))
        share[k] = min(1.0, max(seen, 1.0) / max(told[k], 1e-300))
    columns = fit.jacobian.copy()
    columns[:, own] = (table @ (ways.T * share) @ ways) / unit
    return replace(fit, jacobian=columns, columns=columns)


def vague(model: Model, spread: Array, covariance: Array) -> bool:
    """Whether the play is no wider than `SURE` standard errors, `spread` (p,) being all numbers': something
    is foretold, but by no gap. How the masses are shared on its sides, and how contact is damped, may be in
    doubt: its error is that where they are as found, by the `covariance` (p, p).
    (An encoder that loses counts: 35 +- 65 um; a Stribeck friction: 111 +- 111. A play of 294 +- 160 um
    between masses shared 3.6 times either way was 2,704 ahead of none.)"""
    at = gap_at(model)
    own = [k for k, c in enumerate(model.coordinates) if c.kind == "option"]
    beside = covariance[np.ix_(own, own)], covariance[at, own]
    share = 1.0
    if own and all(np.all(np.isfinite(part)) for part in beside) and covariance[at, at] > 0.0:
        told = float(beside[1] @ np.linalg.lstsq(*beside, rcond=None)[0]) / covariance[at, at]
        share = float(np.sqrt(max(1.0 - told, 0.0)))
    wide = 1.0 if model.coordinates[at].log else model.theta[at]
    return not SURE * share * spread[at] < wide


def bracketed(point: Told, trials: Sequence[Trial], least: float) -> bool:
    """Whether half of the gap and half as much again foretell less by `least`, all else fitted again:
    beside what is still missing innovations are no noise, and tell no error of a gap. (4.4 um of
    4.9, called +- 4.2: 6,351 behind at half, 4,497 at 1.4 times.)"""
    at, worth = gap_at(point.model), point.worth(trials)
    for share in BRACKET:
        theta, log = point.theta, point.model.coordinates[at].log
        theta[at] = theta[at] + np.log(share) if log else share * theta[at]
        if refitted(point.at(theta), trials, fixed=(at,)).worth(trials) > worth - least:
            return False
    return True


def units(point: Told) -> Array:
    """By what a move is measured: the gap itself, a unit of logarithms and of the mass, else a scale."""
    sizes = [1.0 if c.log else c.scale for c in point.model.coordinates]
    for k in masses(point.model):
        sizes[k] = 1.0
    at = gap_at(point.model)
    sizes[at] = point.theta[at]
    return np.array(sizes)


def gap_at(model: Model) -> int:
    """Which coordinate is the play's."""
    return [c.name for c in model.coordinates].index("gap")


def masses(model: Model) -> list[int]:
    """Which coordinates are the mass's."""
    return [k for k, c in enumerate(model.coordinates) if c.key[:2] == ("correction", "mass")]


def long_tables(model: Model) -> list[int]:
    """Which coordinates are knots of tables, where there are more than `MANY`: none is moved by itself, and
    beside a play of the head all stay until it has been found. (Friction by position in each direction
    beside such a play: no answer within 600 s. Blind case 20270204/0012.)"""
    own = [k for k, c in enumerate(model.coordinates) if c.place is not None]
    return own if len(own) > MANY else []

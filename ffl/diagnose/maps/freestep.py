"""Maps fitted in the closed loop: Gauss-Newton along the motion that they make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.maps.freemodel import (
    RUNAWAY,
    FreeModel,
    FreeScreen,
    Part,
    Run,
    evidence,
    posterior,
    run_of,
    tables_of,
)
from ffl.effects import Motion
from ffl.systems.state_space import Array

ROUNDS = 3  # Gauss-Newton rounds of a map in the closed loop, and
MORE = 12  # as long as each takes off
STILL = 0.02  # of the sum of squares: a map that does nearly all starts far from where it ends
BENDING = 3  # first rounds of a map of the velocity, which damps the motion that it is read from:
COARSE = 0.2  # least length in them, fine detail would be that of the wrong motion
SHARES = (1.0, 0.5, 0.25)  # of a step that are tried
# Where none of them helps a map of the velocity: what damps as much as a brake at its peak is far from
# linear in the motion that it makes. (One went from a tenth on, 125,000 to 4,700 of 4,732 samples.)
SMALLER = (0.1, 0.04)
SMALL = 0.1  # sum of squares that ends the rounds


def stepped(
    screen: FreeScreen, free: FreeModel, rounds: int
) -> tuple[FreeModel, Run, float] | None:
    """The maps together with the model's own numbers after `rounds` rounds, of `ROUNDS` as many more
    as bring much; what they leave, and what they took off the sum of squares. None where the
    simulation leaves all bounds."""
    now = run_of(screen.scene, free)
    if now is None:
        return None
    first = cost = now.cost
    for done in range(MORE if rounds == ROUNDS else rounds):
        wanted = _step(screen, free, now, done < BENDING)
        if wanted is None:
            break
        found = _first_below(screen.scene, _ways(free, wanted), cost)
        if found is None:
            break
        free, now = found
        gained, cost = cost - now.cost, now.cost
        if gained < SMALL or (done + 1 >= rounds and gained < STILL * cost):
            break
    return free, now, first - cost


def _ways(free: FreeModel, wanted: FreeModel) -> list[FreeModel]:
    """Shares of the way from `free` to `wanted`, at last with the maps alone: where these are far from
    right, numbers that take off what the maps leave to first order lead away."""
    alone = FreeModel(free.model, wanted.parts)
    return [
        _between(free, end, share)
        for shares in ((SHARES, SMALLER) if _damps(free) else (SHARES,))
        for end in (wanted, alone)
        for share in shares
    ]


def _damps(free: FreeModel) -> bool:
    return any("velocity" in part.term.variables for part in free.parts)


def begun_along(
    screen: FreeScreen, free: FreeModel, motions: Sequence[dict[Place, Motion]]
) -> FreeModel:
    """`free`, whose maps are blank, with those that explain best what the `screen` wants explained along
    the `motions` that were measured."""
    tables = traces(screen, free, motions)
    return FreeModel(free.model, _maps(screen, free, screen.wanted, tables, True))


def _step(screen: FreeScreen, free: FreeModel, now: Run, early: bool) -> FreeModel | None:
    """The maps and numbers that explain `now` best to first order around `free`; `early`: a round in
    which maps of the velocity are coarse."""
    tables = traces(screen, free, now.motions)
    if not all(np.all(np.abs(t) < RUNAWAY) for t in tables):
        return None
    whole = now.white + _sum(tables, [p.coefficients for p in free.parts])
    parts = _maps(screen, free, whole + screen.from_nominal(free.model), tables, early)
    theta = free.model.theta
    if len(theta):
        left = whole - _sum(tables, [p.coefficients for p in parts])
        theta = theta + _numbers(screen, free.model, left)
    return FreeModel(free.model.at(theta), parts)


def traces(
    screen: FreeScreen, free: FreeModel, motions: Sequence[dict[Place, Motion]]
) -> list[Array]:
    """Traces (N, k) of each map's columns along the `motions`."""
    entries = [(p.term, p.place) for p in free.parts]
    return tables_of(screen, entries, [p.ranges for p in free.parts], motions)


def last_gain(screen: FreeScreen, free: FreeModel) -> float:
    """Log-evidence of the last map of `free` along the motion that all of them make; -inf where that
    leaves all bounds."""
    now = run_of(screen.scene, free)
    if now is None:
        return -np.inf
    own = [screen.beyond(t) for t in traces(screen, free, now.motions)][-1]
    last = free.parts[-1]
    target = screen.beyond(now.white + screen.from_nominal(free.model)) + own @ last.coefficients
    return evidence(last.term, last.ranges, own, target).gain


def _maps(
    screen: FreeScreen, free: FreeModel, whole: Array, tables: Sequence[Array], early: bool
) -> tuple[Part, ...]:
    """The maps of `free` with the coefficients that explain `whole` best beyond the model's numbers."""
    spans = [p.ranges for p in free.parts]
    target = screen.beyond(whole)
    beyond = [screen.beyond(t) for t in tables]
    priors = []
    for k, (p, table) in enumerate(zip(free.parts, beyond, strict=True)):
        others = [o.coefficients for o in free.parts]
        others[k] = np.zeros_like(others[k])
        least = COARSE if early and p.term.along == "velocity" else 0.0
        priors.append(evidence(p.term, p.ranges, table, target - _sum(beyond, others), least))
    coefficients = posterior([p.term for p in free.parts], spans, beyond, priors, target)
    return tuple(
        replace(p, coefficients=c, length=e.length)
        for p, c, e in zip(free.parts, coefficients, priors, strict=True)
    )


def numbers_beside(scene: Scene, free: FreeModel) -> tuple[FreeModel, Run] | None:
    """The model's own numbers fitted beside maps that stay, and what is left; None where `free` leaves all
    bounds."""
    now = run_of(scene, free)
    if now is None:
        return None
    for _ in range(MORE):
        theta = free.model.theta
        wanted = free.at(theta + _numbers(FreeScreen(scene, free), free.model, now.white))
        ways = [_between(free, wanted, share) for share in SHARES]
        found = _first_below(scene, ways, now.cost)
        if found is None:
            break
        gained = now.cost - found[1].cost
        free, now = found
        if gained < STILL * now.cost:
            break
    return free, now


def _numbers(screen: FreeScreen, model: Model, left: Array) -> Array:
    """Step of the model's own numbers that takes most off `left`; corrections stay near nominal as far as
    they are believed (`Coordinate.doubt`), beside what the maps do not explain yet: louder than noise, it
    tells them no better than its own size."""
    j = screen.slopes
    if not (np.all(np.abs(j) < RUNAWAY) and np.all(np.abs(left) < RUNAWAY)):
        return np.zeros(j.shape[1])  # a run next to this one leaves all bounds
    loud = max(float(np.sqrt(np.mean(left**2))), 1.0)
    belief = loud * np.sqrt(1.5) / np.array([c.doubt for c in model.coordinates])
    size = np.linalg.norm(j, axis=0)
    # What says nothing goes back to nominal, or stays where nothing is believed of it.
    size = np.where(size > 0.0, size, np.where(belief > 0.0, belief, 1.0))
    stacked = np.vstack([j / size, np.diag(belief / size)])
    target = np.append(left, -belief * model.theta)
    return np.linalg.lstsq(stacked, target, rcond=1e-9)[0] / size


def _first_below(
    scene: Scene, ways: Sequence[FreeModel], cost: float
) -> tuple[FreeModel, Run] | None:
    """The first that leaves less than `cost`, with what it leaves."""
    for free in ways:
        run = run_of(scene, free)
        if run is not None and run.cost < cost:
            return free, run
    return None


def _between(a: FreeModel, b: FreeModel, share: float) -> FreeModel:
    """`share` of the way from `a` to `b`."""
    theta = a.model.theta + share * (b.model.theta - a.model.theta)
    parts = tuple(
        replace(q, coefficients=p.coefficients + share * (q.coefficients - p.coefficients))
        for p, q in zip(a.parts, b.parts, strict=True)
    )
    return FreeModel(b.model.at(theta), parts)


def _sum(tables: Sequence[Array], coefficients: Sequence[Array]) -> Array:
    return np.sum([t @ c for t, c in zip(tables, coefficients, strict=True)], axis=0)

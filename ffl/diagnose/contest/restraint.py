"""Numbers of the linear part that held-out recordings object to: as the plant file states them.

What the fitted recordings hardly show of the linear part (a mode that only the judging multisine excites)
is fitted to their noise, and a held-out run is foretold by it. So where a held-out run is missed by more
than noise, or none of the numbers is told by itself, the stated numbers are tried again, all of them and
mode by mode, the effects fitted anew beside them, and stay where both kinds of recordings together are
the likelier for it. Not beside a friction table: its levels, fitted anew, trade against a damping
without a trace (`friction_table`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.earning import beyond_noise
from ffl.diagnose.contest.judging import (
    Judged,
    charged,
    judge,
    levelled,
    noise_error,
    raw_error,
)
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.friction_table import NAME as TABLE

MISSED = 1.2  # mean square of a held-out run, whitened, from which stated numbers are tried again
GAINED = 4.0  # log-likelihood of both kinds of recordings that they must bring
TOLD = 3.0  # standard errors from which a number is told; where none is, stated ones must bring nothing
WORSE = 1.2  # held-out sum of squares that one more effect may cost, of what it was or noise makes
MUCH_WORSE = 2.0  # the same of one that brings the fitted recordings more than their noise is
BY_CHANCE = 0.05  # of noise that makes more
ROUNDS = 6
TRIED = 2  # of those whom only recordings that judge speak against


def worse(held: Scene | None, judged: Judged, before: Judged, now: float, then: float) -> bool:
    """Whether `judged`, less likely than `before` on the held-out recordings, leaves more there, `now`
    for `then` (sums of squares), than one further effect may cost and than noise leaves."""
    one, other = levelled([judged, before])
    most = MUCH_WORSE if beyond_noise(one, other) else WORSE
    if one.held_out >= other.held_out or now <= most * then:
        return False
    return now > WORSE * noise_error(held, judged.scene, BY_CHANCE)


def as_far_as_told(
    held: Scene | None, judged: Judged, before: Judged, now: float, then: float
) -> tuple[Judged, float] | None:
    """`judged` and what it leaves held out, `now`; with stated numbers where that is `worse` than `then` as
    fitted, by what the fit made of the linear part, and not with these; None where it is with both. (A
    delay of 0.36 ms, 109 fitted: the damping of a mode that the fitted moves hardly show, and the judging
    multisine does, went to half with it, and the delay was turned down; with stated damping 0.333 +- 0.019
    ms, explained.)"""
    if not worse(held, judged, before, now, then):
        return judged, now
    stated = restrained(held, judged)
    if stated is judged:
        return None
    less = raw_error(held, stated.model)
    return None if worse(held, stated, before, less, then) else (stated, less)


def spoken_against(
    quiet: Scene, held: Scene | None, base: Judged, rivals: Sequence[Judged], threshold: float
) -> list[Judged]:
    """Of the `rivals` of `base` that bring the fitted recordings what one more effect must and cost those
    that judge, the likeliest with stated numbers: what a fit with them has made of the linear part may
    be all that these object to. (A disturbance of 0.83 V in noise as large, on a stage with a spring: 416
    fitted and -351 held out beside 41 % less mass and five times the damping, of which the moves that were
    fitted hardly tell; with stated numbers 413 and 335.) All in the noise of the round, `quiet`."""
    brought = [r for r in rivals if charged(r, base) > threshold and r.held_out < base.held_out]
    asked = sorted(brought, key=lambda r: -r.fitted)[:TRIED]
    stated = [other for r in asked if (other := restrained(held, r)) is not r]
    return [judge(quiet, held, s.model, ROUNDS, s.fit) for s in stated]


def restrained(held: Scene | None, judged: Judged) -> Judged:
    """`judged`, or with stated numbers where these foretell the held-out recordings and explain the fitted
    ones together better. `held`: what judges, raw: no number is granted what the fitted ones leave open."""
    if held is None or not held.trials or not judged.model.corrections:
        return judged
    if TABLE in judged.model.names:
        return judged
    whole = held.like(judged.scene)
    untold = not _told(judged)
    if not untold and not missed(whole, judged):
        return judged
    best, bar = judged, _both(whole, judged, judged) + (0.0 if untold else GAINED)
    for names in _groups(judged):
        kept = {k: v for k, v in judged.model.corrections.items() if k not in names}
        model = replace(judged.model, corrections=kept, held=judged.model.held | names)
        other = judge(judged.scene, held, model, ROUNDS, judged.fit if model.effects else None)
        worth = _both(whole, other, judged)
        if worth > bar:
            best, bar = other, worth
    return best


def _groups(judged: Judged) -> Iterator[frozenset[str]]:
    """All numbers that were moved, and those of every mode."""
    moved = [name for name in judged.model.corrections if name not in judged.model.held]
    yield frozenset(moved)
    modes = sorted({name.rsplit("_", 1)[0] for name in moved if name.startswith("mode_")})
    for mode in modes:
        own = frozenset(name for name in moved if name.startswith(f"{mode}_"))
        if len(own) < len(moved):
            yield own


def _told(judged: Judged) -> bool:
    """Whether any number of the linear part lies clear of what is stated."""
    pairs = zip(judged.model.coordinates, judged.spread, strict=True)
    values = judged.model.corrections
    return any(
        abs(values.get(c.name, 0.0)) >= TOLD * spread
        for c, spread in pairs
        if c.kind == "correction"
    )


def missed(held: Scene, judged: Judged) -> bool:
    """Whether the held-out recordings are missed by more than noise."""
    residuals = held.residuals(judged.model)
    return residuals is None or float(np.mean(held.whiten(residuals) ** 2)) > MISSED


def _both(held: Scene, judged: Judged, by: Judged) -> float:
    """Log-likelihood of fitted and held-out recordings together, by the noise of `by`."""
    own = by.scene
    total = 0.0
    for scene in (own, held):
        residuals = scene.residuals(judged.model)
        if residuals is None:
            return -np.inf
        total += scene.log_likelihood(scene.whiten(residuals))
    return total - judged.fit.surprise

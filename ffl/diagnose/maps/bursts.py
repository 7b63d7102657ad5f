"""Bursts in what names leave: events of their own, or noise in the machine as it is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.random import Generator

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.imitate import Imitation, imitated
from ffl.diagnose.noise.least import least_noise
from ffl.diagnose.recorded.events import Events, events
from ffl.diagnose.recorded.knocks import knocks
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

QUIET_ENOUGH = 1.15  # mean square of a residual under the least noise below which nothing is left
MANY = 20  # draws of noise that bursts are held against before they are called events
RARER = 1.2  # times the same of pushes that are told by their shape, in deviations, not in power
LOUDER = 1.5  # times the bursts that noise alone makes in the machine as named: events beyond


@dataclass(frozen=True)
class Heard:
    """Bursts in what the names leave; `at_ease`: there are none, and it is as quiet as noise; `stated`: the
    plant whose own noise they were held against."""

    bursts: Events
    at_ease: bool
    stated: Plant | None


def heard_in(
    scene: Scene, nominal: Model, standing: Model, left: list[Array], rng: Generator
) -> Heard:
    """Bursts in what `standing` has `left`, and how loud it is, beyond what noise does in the machine that
    it makes: what sticks and slips answers noise in bursts, louder than the loop alone would make it; slow
    noise holds few independent samples in a short window and looks like bursts on any machine."""
    stated, louder, loud = None, LOUDER, _loudness(scene, standing, left)
    hear: Callable[[list[Array]], Events] = partial(events, scene)
    bursts = hear(left)
    if not bursts.found:
        stated = nominal.base.plant
        hear = partial(events, scene, plant=stated)
        bursts = hear(left)
    # Names leave reversals and places, which look like pushes.
    if not (bursts.found or standing.effects) and (faint := knocks(scene, left)).found:
        bursts, hear, louder = faint, partial(knocks, scene), RARER
    if bursts.found or (standing.effects and loud > QUIET_ENOUGH):
        machine, sent = standing.judged_on(scene.trials)
        alike = imitated(machine.plant(), sent, scene.noise, rng)
        bursts = _beyond(bursts, alike, hear, louder)
        if bursts.found:  # a few draws may all be tame
            more = imitated(machine.plant(), sent, scene.noise, rng, MANY)
            bursts = _beyond(bursts, more, hear, louder)
        loud /= max([1.0, *(_loudness(scene, standing, one.y) for one in alike)])
    return Heard(bursts, loud < QUIET_ENOUGH and not bursts.found, stated)


def _beyond(
    bursts: Events, alike: list[Imitation], hear: Callable[[list[Array]], Events], louder: float
) -> Events:
    """`bursts`, found only where they are `louder` than what is heard in recordings `alike`, in which noise
    is all."""
    usual = max((hear(one.y).ratio for one in alike), default=0.0)
    return replace(bursts, limit=max(bursts.limit, louder * usual))


def _loudness(scene: Scene, model: Model, residuals: list[Array]) -> float:
    """Mean square of residuals whitened by the least noise that they show."""
    quiet = replace(scene, noise=least_noise(scene, model, residuals))
    return float(np.mean(quiet.whiten(residuals) ** 2))

"""The play that a search from sample to sample begins with, and the company beside which it does."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.dry import DRY
from ffl.diagnose.contest.plainest import in_the_mean
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import POINT, of_the_machine, point_of
from ffl.diagnose.predict.balance import rubbing
from ffl.diagnose.predict.company import along, separable
from ffl.diagnose.predict.foretold import refitted
from ffl.diagnose.predict.play import (
    LOOK,
    Hypothesis,
    able,
    of_another_mass,
    of_grid,
    settled,
    shortened,
    start,
)
from ffl.effects.backlash import PARTS
from ffl.systems.plant import EffectSpec

TIGHT = (1.0,)  # times the force noise, none of it more than stated


def started(
    scene: Scene,
    told: Model,
    named: Sequence[EffectSpec],
    sines: Sequence[EffectSpec],
    levels: Sequence[float],
    most: int,
) -> tuple[Hypothesis | None, Sequence[float]]:
    """The play to begin with, and the levels from there, of the company beside which it foretells best:
    what was `named` of the drive and the scale, all of it that the filter can take, its dry friction on
    either side of the play, or dry friction or a damper as the balance of forces has it, on either side;
    one of the `sines` that this balance leaves, with the friction of any of these."""
    named = [in_the_mean(spec) for spec in named]
    apart = tuple(spec for spec in named if separable(spec))
    whole = tuple(spec for spec in named if able(spec))
    companies = [apart, whole] if len(whole) > len(apart) else [apart]
    places = of_the_machine(told)
    for k, spec in enumerate(whole):
        form = {key: v for key, v in spec.options.items() if key not in POINT}
        others = [p for p in places if spec.name in DRY and p.side != point_of(spec).side]
        for place in others:
            there = replace(spec, options={**form, **place.options})
            companies.append((*whole[:k], there, *whole[k + 1 :]))
    for force in rubbing(scene.trials, told):
        companies += [(*apart, replace(force, options=place.options)) for place in places]
    beside = tuple(spec for spec in whole if along(spec))
    for force in rubbing(scene.trials, told, beside) if beside else ():
        companies += [(*whole, replace(force, options=place.options)) for place in places]
    ways = [start(scene, replace(told, effects=own), levels, most) for own in companies]
    bare = [tuple(s for s in own if s.name in DRY) for own in ((), *companies)]
    plain = [own for k, own in enumerate(bare) if own not in bare[:k]]
    for own, sine, place in itertools.product(plain, sines, places):
        effects = (*own, replace(sine, options=place.options))
        way = start(scene, replace(told, effects=effects), levels[:1], 1)[0]
        # Its frequency is a little off, and no gap of a grid is right beside it under less noise.
        ways.append((way and refitted(way, shortened(scene, LOOK)), levels))
    best = _best([(begun, after) for begun, after in ways if begun is not None], scene)
    if len(told.base.simulator.mechanics.modes) > 1 or best is None:
        return best or (None, levels)
    ends = [settled(best[0], scene, best[1])]
    ends += [settled(begun, scene, TIGHT) for begun in _tight(scene, told, companies)]
    return max(ends, key=lambda one: one.worth(scene.trials)), TIGHT


def _tight(
    scene: Scene, told: Model, companies: Sequence[tuple[EffectSpec, ...]]
) -> list[Hypothesis]:
    """A play for either side on which a rigid plant's own damping may act, begun under the noise as it is
    beside the company that suits it best. (Loose, a wrong company finds its way too: beside a drift and a
    damper, both right, these settle 600 and 800 ahead of friction by direction alone.)"""
    sides = PARTS if told.base.simulator.mechanics.modes[0].damping > 0.0 else PARTS[:1]
    best: list[Hypothesis] = []
    most = -np.inf
    for own in companies:
        grids = [of_grid(scene, replace(told, effects=own), TIGHT[0], (side,)) for side in sides]
        begun = [of_another_mass(grid, scene.trials) for grid in grids if grid is not None]
        worth = max((play.worth(scene.trials) for play in begun), default=-np.inf)
        if worth > most:
            best, most = begun, worth
    return best


def _best(
    ways: Sequence[tuple[Hypothesis, Sequence[float]]], scene: Scene
) -> tuple[Hypothesis, Sequence[float]] | None:
    """The one that foretells best, by the mass that suits it."""
    moved = [(of_another_mass(begun, scene.trials), after) for begun, after in ways]
    return max(moved, key=lambda way: way[0].worth(scene.trials)) if moved else None

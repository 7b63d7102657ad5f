"""Which maps may come in, ranked to first order: along the simulated motion, and where that is far from
the machine's along the measured one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ffl.diagnose.contest.parallel import each
from ffl.diagnose.hypothesis.fit import Fit
from ffl.diagnose.hypothesis.linear import WITHOUT_ZERO
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import Place, places_of
from ffl.diagnose.maps.columns import terms_by
from ffl.diagnose.maps.freemodel import (
    Evidence,
    FreeModel,
    FreeScreen,
    Part,
    evidence,
    motions_of,
    tables_of,
)
from ffl.diagnose.maps.freestep import begun_along
from ffl.diagnose.maps.grids import ranges_of
from ffl.diagnose.maps.terms import TERMS, Term
from ffl.diagnose.recorded.trials import Trial
from ffl.diagnose.recorded.warmth import feels_heat, first_warmth, warmed
from ffl.diagnose.screen.followed import followed, strays
from ffl.effects import Motion

if TYPE_CHECKING:
    from ffl.diagnose.maps.form import FreeForm

FAR_BEHIND = 0.05  # of the best evidence: not worth a simulation
ROWS = 6000  # of the whitened tables, spread evenly, that rank the maps
WORTH = 20.0  # log-likelihood that a map must bring in the fitted recordings (nulls reach 26)


def entries_of(model: Model, trials: Sequence[Trial] = ()) -> list[tuple[Term, Place]]:
    """Every term at every place where it may act, and those of what else was recorded in all `trials`."""
    mechanical = bool(model.simulator.mechanics.modes)
    points = places_of(model) if mechanical else []
    out = []
    names = [n for n in trials[0].others if all(n in t.others for t in trials)] if trials else []
    for term in (*TERMS, *(term for name in names for term in terms_by(name))):
        places = points if term.port == "force" else [Place(term.port, term.side)]
        out += [(term, place) for place in places]
    return out


def as_stated(model: Model) -> Model:
    """`model` with the numbers of its linear part as the plant file states them; what was chosen stays."""
    kept = {k: v for k, v in model.corrections.items() if k in model.held or k == WITHOUT_ZERO}
    return replace(model, corrections=kept, given=None)


def measured_view(current: FreeForm, fitted: Fit) -> FreeScreen | None:
    """The view along the motion that was measured, beside the linear model as it is stated, where the one
    `fitted`, its numbers bent to stand for what is missing, still strays; None where nothing takes it
    there, or maps stand already."""
    if current.parts or not strays(current.scene, fitted):
        return None
    model = as_stated(current.free.model)
    along = followed(current.scene, model)
    return None if along is None else FreeScreen(current.scene, FreeModel(model), along)


@dataclass(frozen=True)
class Entry:
    """A map that may come in, blank, as a `view` ranks it: `evidence` to first order, and what the
    recordings began warm with (`warmth`), where the map feels heat."""

    evidence: Evidence
    part: Part
    warmth: Sequence[float]
    view: FreeScreen

    @property
    def motions(self) -> list[dict[Place, Motion]] | None:
        """At the map's place, along the motion of the `view`."""
        scene = warmed(self.view.along or self.view.scene, self.warmth)
        return motions_of(FreeModel(self.view.model), scene, [self.part.place])

    @property
    def begun(self) -> FreeModel:
        """The map as a view along the measured motion has it."""
        start, motions = FreeModel(self.view.model, (self.part,)), self.motions
        return begun_along(self.view, start, motions) if motions else start


def least_worth(ranked: Sequence[Entry]) -> float:
    """Evidence that is worth a simulation, of those that are `ranked`."""
    return max(WORTH, FAR_BEHIND * ranked[0].evidence.gain) if ranked else np.inf


def ranked(
    view: FreeScreen, current: FreeForm, entries: Sequence[tuple[Term, Place]]
) -> list[Entry]:
    """Every map, that of most evidence first, from as many rows as are needed to rank them."""
    free = FreeModel(view.model, current.parts)
    motions = motions_of(free, view.along or view.scene, [p for _, p in entries])
    if motions is None:
        return []
    left = current.white if view.along is None else view.wanted
    target = view.beyond(left + view.from_nominal(view.model))
    every = max(1, len(target) // ROWS)

    def promise(entry: tuple[Term, Place]) -> Entry:
        term, place = entry
        span = ranges_of([m[place] for m in motions])
        warmth: Sequence[float] = ()
        if feels_heat(term):
            found, warmth = first_warmth(
                view, term, place, span, [m[place] for m in motions], target, every
            )
        else:
            table = view.beyond(tables_of(view, [entry], [span], motions)[0])
            found = evidence(term, span, table[::every], target[::every])
        found = replace(found, gain=found.gain * every)
        blank = np.zeros(len(term.kernel(span, 1.0)))
        return Entry(found, Part(term, place, blank, span, found.length), warmth, view)

    return sorted(each(promise, entries), key=lambda entry: -entry.evidence.gain)

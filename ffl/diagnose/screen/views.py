"""What a contest sees of what stands: views to first order, and who of those in them is worth a fit."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from ffl.diagnose.contest.dry import CREEPING, PLIABLE
from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.ladders import overlooked
from ffl.diagnose.hypothesis.places import points_of
from ffl.diagnose.screen.candidate import Candidate
from ffl.diagnose.screen.screen import Screen, as_measured
from ffl.diagnose.screen.shortlist import SHORTLIST, shortlist

FAR = 0.6  # surprise of the corrections at which effects compete from nominal ones too


@dataclass(frozen=True)
class View:
    """What a `screen` has `seen`, of it what is `fresh`, and of this what is `allowed` to come in now."""

    screen: Screen
    seen: list[Candidate]
    fresh: list[Candidate]
    allowed: list[Candidate]

    @classmethod
    def of(cls, screen: Screen, taken: Collection[str], least: float, pliable: bool | None) -> View:
        """`fresh`: not `taken`, and of more than the `least` gain; what creeps comes in the place of others
        alone. `allowed` are of these the `pliable` alone, all but these, or (None) everyone."""
        seen = screen.candidates()
        barred = CREEPING.union(taken)
        fresh = [c for c in seen if c.spec.name not in barred and c.gain > least]
        allowed = [c for c in fresh if pliable in (None, c.spec.name in PLIABLE)]
        return cls(screen, seen, fresh, allowed)


def entrants_of(
    quiet: Scene, base: Judged, views: Sequence[View], taken: Collection[str]
) -> list[Candidate]:
    """Who of those in each view is worth a fit, and whom first order overlooks."""
    # Far from what was measured first orders do not tell one point from another.
    places, points, out = SHORTLIST if base.fit.far else 2, points_of(base.model), []
    for view in views:
        listed = shortlist(view.allowed, places=places, points=points)
        out += listed + overlooked(quiet, base, view.screen.fit, view.fresh, listed, taken)
    return out


def screens(quiet: Scene, base: Judged) -> list[Screen]:
    """Views of what `base` leaves: from where its corrections stand and, where these have gone
    far to stand in for an effect, from nominal ones as well; where the machine went another way, along
    that too."""
    out = [Screen(quiet, base.fit)]
    if base.fit.surprise > FAR:
        kept = {k: v for k, v in base.model.corrections.items() if k in base.model.held}
        nominal = replace(base.model, corrections=kept)
        out.append(Screen(quiet, fit(quiet, nominal, rounds=0)))
    along = as_measured(quiet, out[-1].fit)
    return out if along is None else [*out, along]

"""Which variables a map that is told depends on, and its formula."""

from __future__ import annotations

from dataclasses import replace

from numpy.random import Generator

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.maps.depends import needed_variables
from ffl.diagnose.maps.formula import formula
from ffl.diagnose.maps.freeform import calmed
from ffl.diagnose.maps.freemodel import FreeScreen
from ffl.diagnose.maps.gains import MARGIN, with_the_stated_mass, within_the_line
from ffl.diagnose.maps.outcome import Contest

NEEDED = 0.03  # of a map's evidence that shuffling a variable must cost


def described(contest: Contest, scene: Scene, rng: Generator) -> Contest:
    """`contest` with the variables that its maps need and their formulas; "nothing" where a number of the
    linear part within the contract's line does as well."""
    if contest.verdict == "unnamed" and contest.alone is not None:
        if within_the_line(scene, contest.alone):  # and the names it beats stand for no more
            return Contest("nothing", None, None, 0.0, 0.0, None)
        contest = replace(contest, alone=with_the_stated_mass(calmed(contest.alone)))
    winner = contest.winner
    assert winner is not None
    screen = FreeScreen(winner.scene, winner.free)
    needed: dict[str, float] = {}
    formulas = []
    for index, part in enumerate(winner.parts):
        for name, share in needed_variables(screen, winner.free, winner.white, part, rng).items():
            needed[name] = max(needed.get(name, 0.0), share)
        scale = winner.free.model.simulator.force_per_input if part.place.port == "force" else 1.0
        said = formula(screen, winner.free, winner.white, index, scale)
        if said is not None:
            formulas.append(said)
    worth = NEEDED + MARGIN / max(winner.evidence, MARGIN)
    variables = tuple(v for v in winner.variables if needed.get(v, 1.0) > worth)
    others = [v for part in winner.alike for v in part.term.variables]
    others += ["time"] if contest.bursts_remain else []
    variables = tuple(dict.fromkeys((*(variables or winner.variables), *others)))
    return replace(
        contest,
        variables=variables,
        needed=tuple(needed.items()),
        formulas=tuple(formulas),
    )

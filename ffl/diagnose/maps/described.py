"""Which variables a map that is told depends on, and its formula."""

from __future__ import annotations

from dataclasses import replace

from numpy.random import Generator

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.maps.depends import needed_variables
from ffl.diagnose.maps.form import FreeForm
from ffl.diagnose.maps.formula import Formula, formula
from ffl.diagnose.maps.freeform import calmed
from ffl.diagnose.maps.freemodel import FreeScreen
from ffl.diagnose.maps.gains import MARGIN, within_the_line
from ffl.diagnose.maps.outcome import Contest
from ffl.diagnose.maps.retold import (
    beside_formula,
    own_number,
    surprise,
    with_the_stated_mass,
    with_the_stated_number,
)

NEEDED = 0.03  # of a map's evidence that shuffling a variable must cost


def described(contest: Contest, scene: Scene, rng: Generator) -> Contest:
    """`contest` with the variables that its maps need and their formulas; "nothing" where a number of the
    linear part within the contract's line does as well."""
    if contest.verdict == "unnamed" and contest.alone is not None:
        if within_the_line(scene, contest.alone):  # and the names it beats stand for no more
            return Contest("nothing", None, None, 0.0, 0.0, None)
        stated = with_the_stated_number(with_the_stated_mass(calmed(contest.alone)))
        contest = replace(contest, alone=stated)
    winner = contest.winner
    assert winner is not None
    screen = FreeScreen(winner.scene, winner.free)
    needed: dict[str, float] = {}
    formulas = []
    for index, part in enumerate(winner.parts):
        for name, share in needed_variables(screen, winner.free, winner.white, part, rng).items():
            needed[name] = max(needed.get(name, 0.0), share)
        scale = winner.free.model.simulator.force_per_input if part.place.port == "force" else 1.0
        said, told = _told(screen, winner, index, scale)
        if told is not winner:
            alone = contest.winner is contest.alone
            contest = replace(contest, alone=told) if alone else replace(contest, beside=told)
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


def _told(
    screen: FreeScreen, winner: FreeForm, index: int, scale: float
) -> tuple[Formula | None, FreeForm]:
    """The formula of a map and the map beside the numbers that go with it: of two that do as well that
    beside which the machine is nearer to the stated one. (Up to its peak an eddy brake is as well a tanh
    that damping three times below zero takes something back from.)"""
    free, white = winner.free, winner.white
    ways = []
    for held in (True, False) if own_number(winner) is not None else ():
        said = formula(screen, free, white, index, scale, whole=False, held=held)
        told = None if said is None else beside_formula(winner, said, scale)
        if told is not None:
            ways.append((said, told))
    if not ways:
        return formula(screen, free, white, index, scale), winner
    return min(ways, key=lambda way: surprise(way[1].free.model))

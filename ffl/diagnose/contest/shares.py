"""Shares of a plant's own modes, slightly off, in the place of what is not there.

Masses that share a motion otherwise than the plant file has it leave poles where they are and move zeros:
each mode has another part in y. No mass, damping or frequency of the linear part does that, and a flexible
mode next to a zero does. (Two stated modes off by 0.4 % against each other: one of 0.86 +- 7.8 Hz.) Where a
damper joins the masses, what one spring or damper is off by turns the shares of all modes as well
(`mode_i_lead`), and dampers and springs are found that do it too. (A car's suspension, all of its numbers
within 3 %: 5 % less stiffness beside 7 % more.) The shares are asked for only where such an effect was
found, or where they bring much beside all that was: free beside every hypothesis they would take half of
what a mass at one end of a spring does, and beside none a null of the printer took drag.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from ffl.diagnose.contest.judging import Judged, judge, levelled
from ffl.diagnose.contest.modes import MODE
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.settle import SUBSTITUTE
from ffl.diagnose.hypothesis.linear import damped_together
from ffl.diagnose.hypothesis.model import Model

MASS = "mass_change"
BETWEEN = frozenset({"linear_stiffness", "viscous_friction"})
SLIGHT = 0.04  # of a share: more is no number of the plant file that may be off
MOST = 0.95  # of what a mode brings whose frequency nobody can tell
MUCH = 60.0  # score that they must bring where they take the place of nothing
ROUNDS = 10
GLANCE = 2  # rounds after which half of that must be there: for slight changes all is nearly linear


def shares_off(
    quiet: Scene, held: Scene | None, current: Judged, say: Callable[[str], None]
) -> Judged | None:
    """`current` with the shares of the plant's own modes free, no further off than a plant file may be: in
    the place of a flexible mode, of a change of mass, or of dampers and springs where the plant's damping
    joins its modes, if they say as much, or as good as all that a mode does whose frequency is less sure
    than large; or beside all that was found, if they bring `MUCH`. None where none of this is so."""
    model = current.model
    shares = [c.name for c in model.base.corrections if c.asked and c.name not in model.corrections]
    if not shares:
        return None
    current = judge(quiet, held, model, 0)  # in the same noise as its rivals
    if names := _instead(model):
        instead = _in_place_of(quiet, held, current, names, shares, say)
        if instead is not None:
            return instead
    for rounds, least in ((GLANCE, 0.5 * MUCH), (ROUNDS, MUCH)):
        rival, stands = levelled([_free(quiet, held, model, shares, rounds), current])
        if rival.score - stands.score <= least:
            return None
    if not _slight(rival, shares):
        return None
    say(f"  shares of the plant's modes: {rival.score - stands.score:+.1f}")
    return rival


def _instead(model: Model) -> tuple[str, ...]:
    """The effects of `model` that shares may say as well."""
    there = [name for name in model.names if name not in model.proven]
    one = next((name for name in (MODE, MASS) if name in there), None)
    if one is not None:
        return (one,)
    joined = damped_together(model.base.simulator.mechanics)
    return tuple(name for name in there if name in BETWEEN) if joined else ()


def _in_place_of(
    quiet: Scene,
    held: Scene | None,
    current: Judged,
    names: Sequence[str],
    shares: Sequence[str],
    say: Callable[[str], None],
) -> Judged | None:
    model = bare = current.model
    for name in names:
        bare = bare.without(bare.names.index(name))
    rival, stands = levelled([_free(quiet, held, bare, shares), current])
    gained = rival.score - stands.score
    say(f"  shares of the plant's modes for {' + '.join(names)}: {gained:+.1f}")
    if not _slight(rival, shares):
        return None
    if gained > -SUBSTITUTE:
        return rival
    index = model.names.index(names[0])
    spread = dict(zip([c.key for c in model.coordinates], current.spread, strict=True))
    if spread.get(("effect", "frequency", index, None), 0.0) < 1.0:
        return None
    without, rival, stands = levelled([judge(quiet, held, bare, 6), rival, stands])
    return rival if rival.score - without.score > MOST * (stands.score - without.score) else None


def _free(
    quiet: Scene, held: Scene | None, model: Model, shares: Sequence[str], rounds: int = ROUNDS
) -> Judged:
    own = replace(model, corrections={**model.corrections, **dict.fromkeys(shares, 0.0)})
    return judge(quiet, held, own, rounds)


def _slight(judged: Judged, shares: Sequence[str]) -> bool:
    return all(abs(judged.model.corrections[share]) <= SLIGHT for share in shares)

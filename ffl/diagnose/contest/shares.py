"""Shares of a plant's own modes, slightly off, in the place of a mode or a mass that is not there.

Masses that share a motion otherwise than the plant file has it leave poles where they are and move zeros:
each mode has another part in y. No mass, damping or frequency of the linear part does that, and a flexible
mode next to a zero does. (Two stated modes off by 0.4 % against each other: one of 0.86 +- 7.8 Hz.) The
shares are asked for only where such an effect was found: free beside every hypothesis they would take
half of what a mass at one end of a spring does, and beside none a null of the printer took drag.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ffl.diagnose.contest.judging import Judged, judge, levelled
from ffl.diagnose.contest.modes import MODE
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.settle import SUBSTITUTE

MASS = "mass_change"
SLIGHT = 0.04  # of a share: more is no number of the plant file that may be off
MOST = 0.95  # of what a mode brings whose frequency nobody can tell


def shares_off(
    quiet: Scene, held: Scene | None, current: Judged, say: Callable[[str], None]
) -> Judged | None:
    """`current` without its flexible mode, or without its change of mass, the shares of the plant's own
    modes free, where these are no further off than a plant file may be and say as much as the effect; or
    as good as all that it does, if it is a mode whose frequency is less sure than large. None where there
    is no such effect, or none of this is so."""
    model = current.model
    shares = [c.name for c in model.base.corrections if c.asked and c.name not in model.corrections]
    name = next((n for n in (MODE, MASS) if n in model.names and n not in model.proven), None)
    if not shares or name is None:
        return None
    index = model.names.index(name)
    bare = model.without(index)
    own = replace(bare, corrections={**bare.corrections, **dict.fromkeys(shares, 0.0)})
    rival, stands = levelled([judge(quiet, held, own, 10), current])
    gained = rival.score - stands.score
    say(f"  shares of the plant's modes for {name}: {gained:+.1f}")
    if any(abs(rival.model.corrections[share]) > SLIGHT for share in shares):
        return None
    if gained > -SUBSTITUTE:
        return rival
    spread = dict(zip([c.key for c in model.coordinates], current.spread, strict=True))
    if spread.get(("effect", "frequency", index, None), 0.0) < 1.0:
        return None
    without, rival, stands = levelled([judge(quiet, held, bare, 6), rival, stands])
    return rival if rival.score - without.score > MOST * (stands.score - without.score) else None

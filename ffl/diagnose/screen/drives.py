"""What lies between the command and the motor, and whether anything gets through it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ffl.diagnose.recorded.commands import lets_through
from ffl.diagnose.screen.candidate import Candidate
from ffl.effects import EFFECTS
from ffl.systems.state_space import Array

if TYPE_CHECKING:
    from ffl.diagnose.screen.screen import Screen

PASSED = 0.3  # of the RMS of the (limited) command: a drive that lets through less is none


def blocked(screen: Screen, candidates: Sequence[Candidate], coefficients: Sequence[Array]) -> bool:
    """Whether those of the `candidates` that change the command leave next to nothing of it, or of what
    its limit does: a limit and a dead zone as wide are minus the command together, which explains
    whatever it does."""
    passing = screen.model.base.passing
    specs = [replace(c.spec, parameters={**c.spec.parameters, **c.nonlinear}) for c in candidates]
    if not all(lets_through(spec, passing) for spec in specs):
        return True
    own = [
        (EFFECTS[c.spec.name], c, k)
        for c, k in zip(candidates, coefficients, strict=True)
        if EFFECTS[c.spec.name].port == "command"
    ]
    power = left = 0.0
    for number, motion in enumerate(screen.motions(own[0][1].place)) if own else ():
        limited, through = motion.u.copy(), np.zeros(len(motion.u))
        for effect, c, k in own:
            seen = screen.motions(c.place)[number]
            columns = screen.columns_of(effect, seen, c.nonlinear, c.place)
            if effect.fixed_amount:
                limited += columns[:, 0]
            else:
                through += columns @ k[: columns.shape[1]]
        through += limited
        power, left = power + float(limited @ limited), left + float(through @ through)
    return left < PASSED**2 * power

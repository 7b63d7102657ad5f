"""A drive that bends or limits the command, fed with the command as it was recorded.

Within a dead zone, or at a limit, nothing holds the machine: force noise moves it as it likes, and a free
run, which takes part in none of it, says little of what was left out. What it leaves there is slow, and
slow effects that are not there take some of it off. With the command as recorded taken through the
drive, u' = D(u), the rest is the linear loop with d = u' - u beside its command,
    y - y'_sim = S (P w + v),
whose noise is stationary again and whitened exactly: log p(y | u) of the same samples. Where the command
goes through other effects behind the drive, a delay or a lag say, so does d; where one of these comes
before, d is what all of them make of the command less what the others do.
The same holds of a limit that the plant file states (`command_limit`): u was recorded behind it, and d is
what is made of u less what the others would make of what the controller asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.predict.company import separable, without
from ffl.diagnose.recorded.trials import Trial
from ffl.effects import EFFECTS, Effect
from ffl.effects.leading import leading
from ffl.systems.plant import EffectSpec

RATE = "slew_limit"


def is_drive(effect: Effect, observed: bool) -> bool:
    """Whether the machine is looked at behind the effect: who bends the command; where an observer leads it
    who limits its rate as well, since what the observer adds is no command. (The rate that it asks of a
    ship's rudder swung beyond all bounds.)"""
    return effect.bends or (observed and effect.name == RATE)


def as_sent(trial: Trial, effects: Sequence[EffectSpec], observed: bool = False) -> Trial | None:
    """The trial for a simulation of `effects` without those of the drive (`is_drive`); None where it was
    not recorded, or goes before that through one that cannot be followed without the machine."""
    through = [spec for spec in effects if EFFECTS[spec.name].port == "command"]
    if not np.all(np.isfinite(trial.u)):
        return None
    asked = trial if trial.asked is None else replace(trial, u=trial.asked)
    bent = [spec for spec in through if is_drive(EFFECTS[spec.name], observed)]
    if leading((EFFECTS[spec.name], spec.parameters) for spec in through) == len(bent):
        made = without(trial, bent).u - asked.u
        return replace(trial, feedforward=trial.feedforward + made, asked=None)
    if not all(map(separable, through)):
        return None
    others = [spec for spec in through if not is_drive(EFFECTS[spec.name], observed)]
    made = without(trial, through).u - without(asked, others).u
    return replace(trial, load=made if trial.load is None else trial.load + made, asked=None)

"""A drive that bends or limits the command, fed with the command as it was recorded.

Within a dead zone, or at a limit, nothing holds the machine: force noise moves it as it likes, and a free
run, which takes part in none of it, says little of what was left out. What it leaves there is slow, and
slow effects that are not there take some of it off. With the command as recorded taken through the
drive, u' = D(u), the rest is the linear loop with d = u' - u beside its command,
    y - y'_sim = S (P w + v),
whose noise is stationary again and whitened exactly: log p(y | u) of the same samples. Delays and lags
stay in the simulation, which has them within a sample too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.company import without
from ffl.diagnose.trials import Trial
from ffl.effects import EFFECTS
from ffl.systems.plant import EffectSpec


def is_static(spec: EffectSpec) -> bool:
    """Whether the effect makes of each command another one, whatever was before."""
    effect = EFFECTS[spec.name]
    return effect.port == "command" and tuple(effect.depends_on) == ("command",)


def as_sent(trial: Trial, drive: Sequence[EffectSpec]) -> Trial | None:
    """The trial for a simulation behind the `drive`; None where the command was not recorded."""
    if not np.all(np.isfinite(trial.u)):
        return None
    made = without(trial, drive).u - trial.u
    return replace(trial, load=made if trial.load is None else trial.load + made)

"""Where held-out recordings go that no fitted one did: what was found is carried on there, not known."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ffl.diagnose.recorded.trials import Trial
from ffl.effects import EFFECTS, is_speed
from ffl.systems.state_space import Array

MARGIN = 0.02  # of what the fitted recordings cover: as near is as good as within
FEW = 0.01  # of the held-out samples beyond it: no more is said of fewer


def unvisited(
    names: Iterable[str], fitted: Sequence[Trial], held: Sequence[Trial], unit: str
) -> str | None:
    """A sentence on the share of the `held` samples at positions, or speeds, that the `fitted` recordings
    do not reach, where an effect of `names` depends on these; None where there are hardly any. Of an output
    that is a speed itself, that; where such a machine was nobody knows."""
    depends = {variable for name in names for variable in EFFECTS[name].depends_on}
    parts = []
    seen = (("position", _output, ""), ("velocity", _slope, "/s"))
    for variable, of, per in (("velocity", _output, ""),) if is_speed(unit) else seen:
        if variable not in depends:
            continue
        known, there = (np.concatenate([of(trial) for trial in group]) for group in (fitted, held))
        low, high = float(known.min()), float(known.max())
        room = MARGIN * (high - low)
        beyond = float(np.mean((there < low - room) | (there > high + room)))
        if beyond > FEW:
            bounds = f"{low:.4g} to {high:.4g} {unit}{per}"
            parts.append(f"{100.0 * beyond:.2g} % of them at a {variable} outside {bounds}")
    if not parts:
        return None
    return (
        f"held-out samples lie where no fitted recording was, {' and '.join(parts)}: what depends on it "
        "is carried on from the nearest that was, not known"
    )


def _output(trial: Trial) -> Array:
    return trial.y


def _slope(trial: Trial) -> Array:
    """Of the measured motion, over a hundredth of the recording at least: noise has no speed to tell."""
    wide = max(1, len(trial.y) // 100)
    return np.asarray((trial.y[wide:] - trial.y[:-wide]) / (wide * trial.sample_time))

"""Recordings whose sensor glitches, mended so that model and machine see the same.

A sample of y that no machine moved to (`ffl.recordings.spikes`) is put back on its path. Where the
controller acted on it, y = y_path + g, the command was

    u = f + C_r r - C_y y = (f - C_y g) + C_r r - C_y y_path,

which is the same loop with a known feedforward beside f: no noise, and nothing that physics must explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.recorded.equation import stated_ratio
from ffl.recordings import Recording
from ffl.recordings.jumps import unwrapped
from ffl.recordings.spikes import spikes, told, without_spikes
from ffl.recordings.units import turn_in
from ffl.systems.plant import Plant
from ffl.systems.zpk import as_state_space


def without_glitches(
    plant: Plant, recordings: Sequence[Recording]
) -> tuple[list[Recording], list[str]]:
    """(recordings with y on its path, and what the controller made of its glitches in f; what to say)."""
    kept, notes = [], []
    for recording in recordings:
        at = spikes(recording.y)
        if len(at) == 0:
            kept.append(recording)
            continue
        mended = replace(recording, y=without_spikes(recording.y, at))
        acted = ""
        if plant.controller is not None and _acted(plant, recording, mended):
            glitch = recording.y - mended.y
            answer = np.atleast_1d(as_state_space(plant.controller.output).filter(glitch))
            mended = replace(mended, f=recording.f - answer)
            acted = "; what the controller made of it is taken as known"
        kept.append(mended)
        notes.append(
            f"{recording.source}: y leaves its path for one sample, {told(recording, at)}: put back on it"
            + acted
        )
    return kept, notes


def without_turns(
    plant: Plant, recordings: Sequence[Recording]
) -> tuple[list[Recording], list[str]]:
    """(recordings whose angles go on where an encoder starts again after a turn; what to say)."""
    turn = turn_in(plant.output_unit)
    if turn is None:
        return list(recordings), []
    kept, notes = [], []
    for recording in recordings:
        mended, often = unwrapped(recording, turn)
        kept.append(mended)
        if often:
            times = "once" if often == 1 else f"{often} times"
            notes.append(
                f"{recording.source}: the angle starts again after {turn:.6g} {plant.output_unit}, "
                f"{times}: carried on over the turn"
            )
    return kept, notes


def _acted(plant: Plant, recording: Recording, mended: Recording) -> bool:
    """Whether the controller saw y as recorded, and not `mended`: so it must have where u was not."""
    if "u" in recording.missing:
        return True
    return stated_ratio(plant, recording) < stated_ratio(plant, mended)

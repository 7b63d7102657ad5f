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
from ffl.recordings.counters import counter_of
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
    """(recordings whose y goes on where an encoder starts again after a turn, or a counter after all of its
    steps; what to say)."""
    turn, unit = turn_in(plant.output_unit), plant.output_unit
    kept, notes = [], []
    for recording in recordings:
        mended, often = (recording, 0) if turn is None else unwrapped(recording, turn)
        if often:
            notes.append(
                f"{recording.source}: the angle starts again after {turn:.6g} {unit}, "
                f"{_times(often)}: carried on over the turn"
            )
        counter = counter_of(mended.y, plant.machine.encoder_resolution)
        mended, often = (mended, 0) if counter is None else unwrapped(mended, counter.range)
        if counter is not None and often:
            notes.append(
                f"{recording.source}: y wraps around after 2^{counter.bits} = {2**counter.bits} steps of "
                f"{counter.step:.6g} {unit}, as a counter does that is full, {_times(often)}: unwrapped, "
                f"carried on by {counter.range:.6g} {unit}"
            )
        kept.append(mended)
    return kept, notes


def _times(often: int) -> str:
    return "once" if often == 1 else f"{often} times"


def _acted(plant: Plant, recording: Recording, mended: Recording) -> bool:
    """Whether the controller saw y as recorded, and not `mended`: so it must have where u was not."""
    if "u" in recording.missing:
        return True
    return stated_ratio(plant, recording) < stated_ratio(plant, mended)

"""What a next feedforward would do, on the model with its effects, before the machine runs it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffl.errors import InputError
from ffl.machines import Simulation, Simulator
from ffl.recordings import Recording
from ffl.systems import Plant
from ffl.systems.state_space import Array

LEAD = 2000  # samples of reference put before the recording, in which model and servo settle


@dataclass(frozen=True)
class Foretold:
    """r - y in output units, (N,) each: `measured`, of the model with the feedforward as recorded
    (`before`) and with the next one (`after`)."""

    recording: str
    measured: Array
    before: Array
    after: Array

    @property
    def rms(self) -> dict[str, float]:
        names = ("measured", "before", "after")
        return {name: float(np.sqrt(np.mean(getattr(self, name) ** 2))) for name in names}


def foretold(model: Plant, recording: Recording, feedforward: Array) -> Foretold:
    """Two runs of `model` over the recording's reference: with its own f, and with `feedforward` (N,)
    in its place.

    The recording may begin in motion: the reference goes on backwards at the velocity it has there.
    `model` agreeing with `measured` before is what gives `after` its weight.
    Raises `InputError` where the model with its effects diverges.
    """
    r = recording.r
    whole = np.concatenate([led_in(r), r])
    simulator = Simulator(model)
    errors = []
    for f in (recording.f, feedforward):
        run = run_on(simulator, model, whole, f, recording.d)
        if run.diverged:
            raise InputError(
                f"{recording.source}: model '{model.name}' diverges on this reference; its effects "
                "or its controller do not fit the machine"
            )
        errors.append(r - run.y[LEAD:])
    return Foretold(recording.source, r - recording.y, *errors)


def run_on(
    simulator: Simulator, model: Plant, whole: Array, feedforward: Array, load: Array | None = None
) -> Simulation:
    """`model` over the reference `whole` from rest; `feedforward` and `load` (N,) belong to its last N
    samples: until then f holds its first value, and nothing pushes."""
    lead = len(whole) - len(feedforward)
    return simulator.run(
        model.effects,
        whole,
        np.concatenate([np.full(lead, feedforward[0]), feedforward]),
        force=None if load is None else np.concatenate([np.zeros(lead), load]),
        start=simulator.at_rest(float(whole[0])) if whole[0] else None,
        command_limit=model.machine.command_limit,
    )


def led_in(reference: Array) -> Array:
    """(LEAD,) the reference before its first sample: backwards at the velocity it has there."""
    steps = np.arange(LEAD, 0.0, -1.0)
    return np.asarray(reference[0] - (reference[1] - reference[0]) * steps)

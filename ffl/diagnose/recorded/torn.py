"""Steps of y that no command could make: samples that are missing, or a sensor that stood still.

Beside a reference missing samples are told by its step as well (`recordings.jumps`). The machine tells
both: from one sample to the next the position of a mass goes on as before, but for what the command makes,

    |step - usual step| <= max_k |h_{k+1} - h_k| (max u - min u),

h the impulse response of the plant. (Two seconds cut out of a 30 kg axis: y back by 0.2 m in 2 ms, 5,100
times what its command could do; a play was named.) A y that stood still before, but for a last digit that
trembles, was frozen. One that goes back by the same each time, and stays within that, may be a counter that
was full (`recordings.counters`: what is certain is carried on before).
"""

from __future__ import annotations

import numpy as np

from ffl.diagnose.recorded.against_controller import Fault
from ffl.effects.modal import is_speed
from ffl.recordings import Recording
from ffl.recordings.counters import equal_jumps
from ffl.recordings.jumps import ABOUT, jumps, missing
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array
from ffl.systems.zpk import as_state_space

IMPOSSIBLE = 20.0  # times what the command could do: blows and stops turn speeds, and bend a step
TREMBLES = 2.5  # of its least step: what a frozen y may do in its last digit
LED = 0.3  # of the jump: what r does meanwhile
FIRST = 4  # samples of the impulse response


def torn(plant: Plant, recording: Recording) -> Fault | None:
    """Samples that are missing or a frozen sensor, told by what y jumps by; None where y is no position of
    a stated mass. Where r makes the same step they are told beside it."""
    physics, y, u = plant.physics, recording.y, recording.u
    if is_speed(plant.output_unit):
        return None
    if physics.mass is None and physics.motor_constant is None:
        return None
    if not np.all(np.isfinite(u)):
        return None
    kick = np.zeros(FIRST)
    kick[0] = 1.0
    response = np.concatenate([[0.0], np.atleast_1d(as_state_space(plant.system).filter(kick))])
    most = IMPOSSIBLE * float(np.abs(np.diff(response)).max()) * float(np.ptp(u))
    step = np.diff(y)
    at, told = [], {k for k, _ in missing(recording)}
    for k in jumps(y) - 1:
        if k + 1 in told:
            continue
        about = np.concatenate([step[k - ABOUT : k], step[k + 1 : k + ABOUT + 1]])
        if abs(step[k] - np.median(about)) > most:
            at.append(int(k))
    if not at:
        return None
    k, t = at[0], recording.t
    still = _stood(y, k, 0.0)
    if not recording.is_open_loop:  # who is led on does not stand, whatever the last digit does
        digit = float(np.min(np.abs(step), initial=np.inf, where=step != 0.0))
        trembling = _stood(y, k, TREMBLES * digit)
        led = float(np.ptp(recording.r[k + 1 - trembling : k + 1]))
        still = trembling if led > LED * abs(step[k]) else still
    if still > ABOUT:
        return Fault(
            recording.source,
            "frozen_sensor",
            f"y frozen from {t[k + 1 - still]:.4g} to {t[k]:.4g} s",
            f"y stands still and then jumps by {step[k]:.4g}, which no command of this recording could "
            "do: cut that stretch out of the recording",
        )
    more = f" and {len(at) - 1} more times" if len(at) > 1 else ""
    if (size := equal_jumps(y)) is not None:
        unit = plant.output_unit
        return Fault(
            recording.source,
            "wrapped",
            f"y goes back by {size:.4g} {unit} each time that it jumps, at {t[k + 1]:.6g} s{more}, and "
            "stays within that",
            f"y may wrap around, as a counter does that is full: carry it on by {size:.4g} {unit} at each "
            "jump; where the counter has 2^n steps, stating one of them as [machine] encoder_resolution is "
            "enough",
        )
    return Fault(
        recording.source,
        "samples_missing",
        f"y jumps between two samples, by {step[k]:.4g} at {t[k + 1]:.6g} s{more}, which no command of "
        "this recording could do",
        "samples are missing there and the time was counted on, or the sensor lost counts: give the time "
        "stamps as they were taken, or cut the recording there",
    )


def _stood(y: Array, k: int, within: float) -> int:
    """Samples up to the k-th, it too, in which y did not leave it."""
    return int(np.argmin(np.append(np.abs(y[k::-1] - y[k]) <= within, False)))

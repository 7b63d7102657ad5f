"""Steps of y that no command could make: samples that are missing where no reference was recorded.

Beside a reference they are told by its step (`recordings.jumps`). Without one the machine tells: from one
sample to the next the position of a mass goes on as before, but for what the command makes of it,

    |step - usual step| <= max_k |h_{k+1} - h_k| (max u - min u),

h the impulse response of the plant. (Two seconds cut out of a 30 kg axis: y back by 0.2 m in 2 ms, 5,100
times what its command could do; a play was named.) A y that stood still to the last digit before was
frozen.
"""

from __future__ import annotations

import numpy as np

from ffl.diagnose.recorded.against_controller import Fault
from ffl.effects.modal import is_speed
from ffl.recordings import Recording
from ffl.recordings.jumps import ABOUT, jumps
from ffl.systems.plant import Plant
from ffl.systems.zpk import as_state_space

IMPOSSIBLE = 20.0  # times what the command could do: blows and stops turn speeds, and bend a step
FIRST = 4  # samples of the impulse response


def torn(plant: Plant, recording: Recording) -> Fault | None:
    """Samples that are missing, told by what y jumps by; None where there is a reference, or where y is no
    position of a stated mass."""
    physics, y, u = plant.physics, recording.y, recording.u
    if not recording.is_open_loop or is_speed(plant.output_unit):
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
    at = []
    for k in jumps(y) - 1:
        about = np.concatenate([step[k - ABOUT : k], step[k + 1 : k + ABOUT + 1]])
        if abs(step[k] - np.median(about)) > most:
            at.append(int(k))
    if not at:
        return None
    k, t = at[0], recording.t
    still = int(np.argmax(np.append(y[k::-1] != y[k], True)))  # samples that y stood
    if still > ABOUT:
        return Fault(
            recording.source,
            "frozen_sensor",
            f"y frozen from {t[k + 1 - still]:.4g} to {t[k]:.4g} s",
            f"y stands still and then jumps by {step[k]:.4g}, which no command of this recording could "
            "do: cut that stretch out of the recording",
        )
    more = f" and {len(at) - 1} more times" if len(at) > 1 else ""
    return Fault(
        recording.source,
        "samples_missing",
        f"y jumps between two samples, by {step[k]:.4g} at {t[k + 1]:.6g} s{more}, which no command of "
        "this recording could do",
        "samples are missing there and the time was counted on, or the sensor lost counts: give the time "
        "stamps as they were taken, or cut the recording there",
    )

"""Does y answer a command before it was sent? Columns that are not of one time base.

No machine does; where no controller's equation tells, what the model makes of u laid beside y does. A lead
may be a number of the model that is off, or a force that depends on the motion: y = G u + what the model's
own numbers change in that to first order + G (forces along y), fitted with u as it stands and moved earlier
by k samples, must be a different matter altogether.
"""

from __future__ import annotations

import numpy as np

from ffl.diagnose.hypothesis.linear import corrected_plant, corrections_of
from ffl.diagnose.recorded.against_controller import Fault
from ffl.diagnose.recorded.compared import compared, moved_by, stated_delay
from ffl.diagnose.recorded.equation import SHIFTS
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

ALIKE = 0.05  # of y's variance: what is left at most with u moved
CLEAR = 0.25  # of what is left with u as it stands (physics at its worst, of 408 recordings: 0.51)
NEAR = 1.25  # factor by which the model may be off beside that: a lead that bends it more is none
SHORTEST, LONGEST = 4 * SHIFTS, 20000  # samples looked at
SCALES = frozenset({"mass", "gain"})  # what changes all of G u alike


def early(plant: Plant, recording: Recording) -> Fault | None:
    """y so many samples before u, by what the model makes of u; None where another number of the model,
    or a force along the motion, says as much."""
    n = min(len(recording), LONGEST)
    if n < SHORTEST:
        return None
    u, y = recording.u[:n], recording.y[:n]
    mechanics = Simulator(plant).mechanics
    made, out = compared(plant, u, y)
    answers = [made]
    for c in corrections_of(mechanics):
        if c.name in SCALES or c.asked:
            continue
        other, _ = compared(corrected_plant(plant, mechanics, {c.name: c.scale}), u, y)
        answers.append((other - made) / c.scale)
    forces = [compared(plant, force, y, by=u)[0] for force in moved_by(plant, y)]
    if not all(np.all(np.isfinite(column)) for column in (*answers, *forces)):
        return None
    within = slice(0, len(out) - SHIFTS)

    def left(k: int) -> tuple[float, float]:
        """(share of y's variance that is left with u earlier by k samples, y per what the model makes)."""
        shifted = [column[k : len(column) - SHIFTS + k] for column in answers]
        return _left([*shifted, *(column[within] for column in forces)], out[within])

    shares = [left(k) for k in range(SHIFTS)]
    k = int(np.argmin([share for share, _ in shares]))
    (least, factor), stands = shares[k], shares[0][0]
    if k == 0 or least > min(ALIKE, CLEAR * stands) or not 1.0 / NEAR < factor < NEAR:
        return None
    late = "" if stated_delay(plant) < k else ", or take so much delay out of the plant file"
    return Fault(
        recording.source, "shift", "the time base",
        f"y answers u {k} sample{'s'[: k > 1]} ({k * plant.sample_time:.4g} s) before the model does: "
        f"align the columns{late}",
    )  # fmt: skip


def _left(columns: list[Array], wanted: Array) -> tuple[float, float]:
    """(share of the variance of `wanted` that no sum of the columns explains, weight of the first)."""
    table = np.column_stack(columns)
    scale = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
    weights = np.linalg.lstsq(table / scale, wanted, rcond=1e-9)[0]
    rest = wanted - table @ (weights / scale)
    return float(rest @ rest) / max(float(wanted @ wanted), 1e-300), float(weights[0] / scale[0])

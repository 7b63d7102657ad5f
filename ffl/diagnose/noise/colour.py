"""What colours the noise: the linear loop as it stands.

Noise goes round the loop that is there. Where a mode is 2 % off the stated one it is loud where that
is quiet, and a sine there finds 34 nats.
"""

from __future__ import annotations

import numpy as np

from ffl.diagnose.contest.scene import is_far
from ffl.diagnose.hypothesis.linear import loop_by_states
from ffl.diagnose.hypothesis.model import Model
from ffl.systems.loop import Loop

ROUNDING = 1e-9  # of a pole on the circle
NOISE_ALONE = 1.2  # mean square of a residual, in units of the noise, up to which it is all noise
MISTAKEN = 5.0  # times what is believed of a number of the linear model (a mass to 3 %)


def loop_of(model: Model) -> Loop:
    """The linear loop with the corrections of `model`; the stated one where that runs away (noise has no
    colour there)."""
    stated = model.base.loop
    other = loop_by_states(model.base.plant, model.simulator)
    radius = [float(np.abs(one.poles).max(initial=0.0)) for one in (other, stated)]
    return other if radius[0] <= max(1.0, radius[1]) + ROUNDING else stated


def colouring(model: Model, left: float) -> Loop:
    """The loop that colours noise beside `model`, which has `left` so much, mean square in units of the
    noise: the stated one where it is far off, or structure is left and it has numbers that no engineer
    mistakes so much. They stand for what is missing. (Where nothing is left they are the machine's: by a
    mode stated 8 % too high the noise was 1,441 nats less likely, and a sine found 105.) Where no noise
    is stated all that is left passes for it, and nobody knows."""
    known = model.base.plant.machine.states_noise
    beside = mistaken(model) and (left > NOISE_ALONE or not known)
    return model.base.loop if is_far(left, 1) or beside else loop_of(model)


def mistaken(model: Model) -> bool:
    """Whether a number of the linear part is further off than an engineer's."""
    numbers = zip(model.coordinates, model.theta, strict=True)
    return any(abs(at) > MISTAKEN * c.doubt for c, at in numbers if c.kind == "correction")

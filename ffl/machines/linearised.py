"""The linear part of a plant with effects: what a norm-optimal update may take for the machine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg

from ffl.effects import Mechanics, effect_of, is_speed, mechanics_of
from ffl.effects.linear_mechanics import IN_SERIES, mechanics_with_effects, times_of
from ffl.systems.plant import Plant
from ffl.systems.state_space import StateSpace, without_unseen


def linear_part(plant: Plant) -> Plant:
    """`plant` with its linear effects inside `system`, and no effects.

    Mass, viscous friction, stiffness and hung modes change the continuous mechanics (their
    `modify`); lags add a state and delays, fractions of a sample too, hold the command back; all
    of it is brought to discrete time under the zero-order hold by matrix exponentials, so nothing
    is approximated. Constant loads and centres of springs move the rest, not the response, and are
    dropped, as are all other effects: friction, cogging and the like are the business of a basis
    (kind "from_diagnosis"), which keeps the update convex. A plant without linear effects keeps its
    zeros, poles and gain to the last digit.
    """
    lag, delay = (times_of(plant.effects, name) for name in IN_SERIES)
    if not plant.effects:
        return plant
    mechanics = mechanics_with_effects(plant)
    stated = mechanics_of(plant.system, is_speed(plant.output_unit))
    unchanged = all(
        getattr(mechanics, name) is getattr(stated, name) for name in ("a", "b", "c", "d", "fast")
    )
    if unchanged and not lag and not sum(delay):
        return replace(plant, effects=())
    mechanics = _without_way(mechanics)
    return replace(plant, system=_discretise(mechanics, lag, sum(delay)), effects=())


def is_linear(plant: Plant) -> bool:
    """Whether `linear_part` leaves nothing out that changes how y answers f."""
    return all(e.name in IN_SERIES or effect_of(e).law is None for e in plant.effects)


def _without_way(mechanics: Mechanics) -> Mechanics:
    """`mechanics` of a speed less the way that it makes, where no force and no sensor sees it: a loop does
    not bring it back."""
    if mechanics.place is None:
        return mechanics
    a, b, c = without_unseen(mechanics.a, mechanics.b[:, None], mechanics.c[None, :], 0.0)
    return replace(mechanics, a=a, b=b[:, 0], c=c[0], place=None)


def _discretise(m: Mechanics, lags: list[float], delay: float) -> StateSpace:
    """States: plant and lags, `fast` (driven by the mean of the force over the sample, as in the
    kernel), commands under way."""
    n, h, f = m.order, m.sample_time, m.fast.order
    a, b = m.a, m.b
    for lag in lags:  # the lagged command takes the input's place
        k = len(a)
        a = np.block([[a, b[:, None]], [np.zeros((1, k)), np.full((1, 1), -1.0 / lag)]])
        b = np.append(np.zeros(k), 1.0 / lag)
    k = len(a)
    block = np.zeros((k + 2, k + 2))  # states, integral of the force, command
    block[:k, :k], block[:k, k + 1] = a, b
    block[k, n if lags else k + 1] = 1.0
    whole = int(np.floor(delay / h * (1 + 1e-12)))
    late = delay - whole * h
    late = late if late > 1e-9 * h else 0.0
    first, second = scipy.linalg.expm(block * late), scipy.linalg.expm(block * (h - late))
    # What each sample's states, and its command before and after the change, leave in the next.
    to_rows = np.vstack([np.eye(k, k + 1), np.outer(m.fast.b[:, 0], np.eye(k + 1)[k]) / h])
    step = to_rows @ second[:-1, :-1] @ first[:-1, :-1]
    old = to_rows @ second[:-1, :-1] @ first[:-1, -1]
    new = to_rows @ second[:-1, -1]
    age = whole + m.delay
    line = age + (1 if late else 0)
    size = k + f
    matrix, drive = np.zeros((size + line, size + line)), np.zeros(size + line)
    matrix[:size, :k], matrix[k:size, k:size] = step[:, :k], m.fast.a
    if age:
        matrix[:size, size + age - 1] = new
    else:
        drive[:size] = new
    if late:
        matrix[:size, size + age] = old
    if line:
        drive[size] = 1.0
        matrix[size + 1 :, size:-1] = np.eye(line - 1)
    c = np.concatenate([m.c, np.zeros(k - n), m.fast.c[0], np.zeros(line)])
    if m.delay:
        c[size + m.delay - 1] += m.d
    return StateSpace(matrix, drive[:, None], c[None, :], 0.0 if m.delay else m.d, h)

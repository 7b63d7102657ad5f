"""The state of a plant at its first sample, as its first samples tell it, and what a sensor makes of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ffl.diagnose.hypothesis.linear import discrete
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording
from ffl.systems.state_space import Array

NUDGE = 1e-6  # of a position: how far one looks for how steep its sensor is there
SETTLE = 12  # most rounds in which the position behind a sensor is found: its error is a small part


def plant_start(simulator: Simulator, u: Array, y: Array, noise: float) -> tuple[Array, Array]:
    """(state, covariance) of the plant at the first sample from a short piece of u and y.

    Least squares on the plant's free response and on that to a constant force beside u of up to half
    its size: the friction or load that the model lacks would else be taken for motion at the start.
    """
    n, rows = discrete(simulator.mechanics).order, shown_in(simulator, len(y))
    free = _free(simulator, rows)
    wanted = y[:rows] - np.atleast_1d(discrete(simulator.mechanics).filter(u[:rows]))
    wanted = wanted - _beside(simulator, u[:rows])
    prior = np.zeros(n + 1)
    prior[n] = noise / max(0.5 * float(np.sqrt(np.mean(u**2))), 1e-100)  # which squares
    table, wanted = np.vstack([free, prior]), np.append(wanted, 0.0)
    reader, spread = _reader(table)
    estimate = reader @ wanted
    level = max(noise, float(np.std(wanted - table @ estimate)))
    return estimate[:n], (spread @ spread.T * level**2)[:n, :n]


def shown_in(simulator: Simulator, most: int) -> int:
    """First samples in which the state of a plant that begins in motion is read, `most` at most."""
    return min(most, max(10 * discrete(simulator.mechanics).order, 60))


def start_behind(simulator: Simulator, added: Array) -> Array:
    """What the start that was read from y changes by, (n_states,) or (n_states, k), where y holds what
    a sensor has `added` to its first samples, (rows,) or (rows, k), as well: minus what `plant_start`
    reads from that alone."""
    n = discrete(simulator.mechanics).order
    reader, _ = _reader(_free(simulator, len(added)))
    out = np.zeros((simulator.n_states, *added.shape[1:]))
    out[_ordering(simulator)] = -(reader @ added)[:n]
    return out


def in_motion_from(simulator: Simulator, recording: Recording, noise: float) -> tuple[Array, Array]:
    """(start, doubt) of a plant that moves at the first sample; the controller's states stay zero."""
    n = simulator.n_plant + simulator.mechanics.delay
    start, doubt = np.zeros(simulator.n_states), np.zeros((n + simulator.controller.order,) * 2)
    drive = recording.u if recording.d is None else recording.u + recording.d
    estimate, spread = plant_start(simulator, drive, recording.y, noise)
    # What is missing in the model acts on the first samples too: a fifth of the command, say.
    other, _ = plant_start(simulator, 0.8 * drive, recording.y, noise)
    order = _ordering(simulator)
    start[order] = estimate
    doubt[np.ix_(order, order)] = spread + np.outer(other - estimate, other - estimate)
    return start, doubt


def behind_sensor(simulator: Simulator, start: Array, added: Callable[[float], float]) -> Array:
    """`start` of a loop at rest with the plant where a sensor that adds `added(position)` shows what
    `start` has."""
    unit = simulator.rest_unit[: simulator.n_plant]
    measured = float(unit @ start[: simulator.n_plant]) / float(unit @ unit)
    position, small = measured, NUDGE * max(abs(measured), abs(added(measured)), 1e-300)
    for _ in range(SETTLE):
        now, ahead = added(position), added(position + small)
        steep = max(1.0 + (ahead - now) / small, 1.0)  # a scale may bend to more than twice as much
        found = position + (measured - position - now) / steep
        if found == position:
            break
        position = found
    return np.append(start[: len(unit)] + (position - measured) * unit, start[len(unit) :])


def _free(simulator: Simulator, rows: int) -> Array:
    """y of the plant that is left alone from each of its states, and from rest under a constant force,
    (rows, n + 1)."""
    system = discrete(simulator.mechanics)
    n = system.order
    out = np.empty((rows, n + 1))
    state = np.eye(n)
    for k in range(rows):
        out[k, :n] = system.c[0] @ state
        state = system.a @ state
    out[:, n] = system.filter(np.ones(rows))
    return out


def _reader(table: Array) -> tuple[Array, Array]:
    """The pseudo-inverse of `table`, directions that it hardly shows left out, and a root of the
    covariance of what it reads from samples of unit noise."""
    scale = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
    left, values, right = np.linalg.svd(table / scale, full_matrices=False)
    kept = values > 1e-7 * values[0]
    spread = (right[kept].T / values[kept]) / scale[:, None]
    return spread @ left[:, kept].T, spread


def _beside(simulator: Simulator, u: Array) -> Array | float:
    """What the effects that the plant file states add to y, from rest at 0."""
    plant = simulator.plant
    if not plant.effects:
        return 0.0
    alone = Simulator(plant, open_loop=True)
    return alone.run(plant.effects, feedforward=u).y - alone.run((), feedforward=u).y


def _ordering(simulator: Simulator) -> Array:
    """Where the states of `discrete(mechanics)` stand in the simulator's start vector: its delay line has
    the latest command first, the simulator's ring the one that is due."""
    n, delay = simulator.n_plant, simulator.mechanics.delay
    return np.concatenate([np.arange(n, n + delay)[::-1], np.arange(n)])

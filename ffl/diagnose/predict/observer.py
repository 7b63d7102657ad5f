"""Where the controller is unknown and the plant integrates: predict through an observer.

u and y were recorded under a feedback that nobody stated. A free run of an integrating plant from u
drifts away with the first error, so the simulation is led back to the measured output by a
controller of our own, u_sim = u + K (y - y_sim): the loop of a known controller K with reference y
and feedforward u. Everything else, the sensitivities included, is as with a stated controller.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg

from ffl.recordings import Recording
from ffl.systems.loop import Controller
from ffl.systems.plant import Plant
from ffl.systems.state_space import StateSpace
from ffl.systems.zpk import as_state_space

DECAYS = 2 * np.pi * np.array([5.0, 2.0, 1.0])  # 1/s: slowest decay of the observer's loop
SAMPLED = 0.02  # s: of machines that are sampled slower all this lasts as much longer
QUIET = 0.01  # of the speed: noise that an observer may take for speed
SPAN = 0.05  # s over which the speed is read
MOVING = 0.05  # of the peak speed: what is slower at either end is standstill
STILL = 0.02  # of the way: it is, though it takes more than half of a recording,
LEAST = 5  # unless what moves is less than one part in so many
FIRM = 2.0  # most of |S|: a modulus margin of a half
GRID, LOWEST = (
    400,
    1e-5,
)  # frequencies at which it is looked at, from this share of the sampling rate
LIGHT = 0.3  # damping ratio below which a mode rings
EDGE = 1.0 - 1e-4  # poles beyond this magnitude count as integrating: a free run would remember


def needs_observer(model: Plant) -> bool:
    """An open-loop plant that remembers for thousands of samples."""
    poles = model.loop.poles
    return model.controller is None and len(poles) > 0 and float(np.abs(poles).max()) > EDGE


def decay_for(recordings: Sequence[Recording]) -> float:
    """The fastest decay whose observer does not take the sensor's noise for motion. One that is too
    slow leaves the simulated speed wrong by so much that friction cannot be told. (KUKA, axes 5 and 6,
    at 1 Hz. Of a vehicle under water, sampled at 10 Hz, 1 Hz is two samples: nothing had a name.)"""
    noise, speed = [], []
    longer = max(1.0, recordings[0].sample_time / SAMPLED)
    for r in recordings:
        m = min(max(1, round(SPAN * longer / r.sample_time)), len(r) // 4)
        noise.append(np.std(np.diff(r.y, 2)) / np.sqrt(6.0))
        speed.append(np.std(r.y[m:] - r.y[:-m]) / (m * r.sample_time))
    decays = DECAYS / longer
    fit = [d for d in decays if np.median(noise) * d < QUIET * np.median(speed)]
    return float(fit[0] if fit else decays[-1])


def with_observer(model: Plant, decay: float) -> Plant:
    """`model` under the gentlest LQG controller that lets no error live longer than 1/`decay`, but for
    errors in the vibrations that die by themselves: a controller that damps them holds for a mode at
    exactly the stated frequency, and its loop is lost where the machine's lies a per cent beside it."""
    system = as_state_space(model.system)
    led = _without_vibrations(system, decay)
    best = model
    for plant in _observed(model, led):
        if led is not system and best is not model and _loudness(plant) > FIRM:
            break
        best = plant
        if decay_of(replace(plant, system=led)) >= decay:
            break
    return best


def with_firm_observer(model: Plant) -> Plant:
    """`model` under the firmest LQG controller that leaves its loop a margin, |S| <= FIRM."""
    best = model
    for plant in _observed(model, as_state_space(model.system)):
        if best is not model and _loudness(plant) > FIRM:
            break
        best = plant
    return best


def _loudness(plant: Plant) -> float:
    """Largest |S|, its peaks at the loop's own frequencies included."""
    own = np.abs(np.angle(plant.loop.poles)) / (2 * np.pi)
    grid = np.concatenate([np.geomspace(LOWEST, 0.5, GRID), own[own > LOWEST]])
    return float(np.abs(plant.loop.system.response(grid / plant.sample_time)[:, 0, 3]).max())


def _without_vibrations(system: StateSpace, decay: float) -> StateSpace:
    """`system` without its stable, lightly damped modes above `decay` (rad/s); itself where it has none."""

    def stays(pole: complex) -> bool:
        rate = np.log(complex(pole) or 1e-300) / system.sample_time
        return abs(pole) > EDGE or abs(rate) <= decay or -rate.real > LIGHT * abs(rate)

    kept = sum(stays(pole) for pole in system.poles)
    if kept == system.order:
        return system
    a, turn, count = scipy.linalg.schur(system.a, sort=lambda re, im: stays(complex(re, im)))
    if count != kept:  # rounding moved a pole over the line: better all than half a mode
        return system
    mix = scipy.linalg.solve_sylvester(a[:kept, :kept], -a[kept:, kept:], -a[:kept, kept:])
    b, c = turn.T @ system.b, system.c @ turn
    return StateSpace(
        a[:kept, :kept], b[:kept] - mix @ b[kept:], c[:, :kept], system.d, system.sample_time
    )


def _observed(model: Plant, p: StateSpace) -> Iterator[Plant]:
    """`model` under LQG controllers made for `p`, from gentle to firm."""
    scale = np.sqrt(np.abs(np.diag(p.b @ p.b.T)).max())
    for exponent in np.arange(16.0, -16.0, -0.5):
        weight = 10.0**exponent * np.linalg.norm(p.c) ** 2 * max(scale, 1e-300) ** 2
        try:
            controller = _lqg(p, weight, 10.0**exponent)
        except (np.linalg.LinAlgError, ValueError):
            continue
        # The command as recorded is beyond the drive's limit already.
        machine = replace(model.machine, command_limit=None)
        plant = replace(model, controller=controller, machine=machine)
        if np.abs(plant.loop.poles).max() < 1.0:
            yield plant


def decay_of(model: Plant) -> float:
    """1/s, of what the loop forgets last."""
    return float(-np.log(np.abs(model.loop.poles).max()) / model.sample_time)


def _lqg(p: StateSpace, weight: float, ratio: float) -> Controller:
    c, b = p.c, p.b
    x = scipy.linalg.solve_discrete_are(p.a, b, c.T @ c, np.array([[weight]]))
    gain = np.linalg.solve(b.T @ x @ b + weight, b.T @ x @ p.a)
    measured = float((c @ b @ b.T @ c.T)[0, 0]) or float(np.linalg.norm(c) ** 2)
    y = scipy.linalg.solve_discrete_are(
        p.a.T, c.T, b @ b.T, np.array([[max(ratio, 1e-12) * measured]])
    )
    inject = p.a @ y @ c.T / float((c @ y @ c.T)[0, 0] + max(ratio, 1e-12) * measured)
    a = p.a - b @ gain - inject @ (c - p.d @ gain)
    return Controller.of_error(StateSpace(a, inject, gain, 0.0, p.sample_time))


def led(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings as the observer's loop sees them: reference y, feedforward u. Rest is told by u."""
    return [replace(r, r=r.y, f=r.u, missing=r.missing | {"r"}) for r in recordings]


def moving(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings without the standstill before the first and after the last motion.

    An unknown controller may hold a machine at rest with any force up to stiction, which after a
    long rest is more than twice the friction of motion (KUKA, axes 2 and 3): there the balance of
    forces, by which an observer tells friction from load, says nothing of either. (Three axes with
    Coulomb friction, which held them for more than half of a recording, were presliding friction with
    stiffness in doubt by its own size, or a play beside it; plain friction of all three without that.)
    """
    out = []
    for r in recordings:
        m = min(max(1, round(SPAN / r.sample_time)), len(r) // 4)
        speed = np.abs(r.y[m:] - r.y[:-m])
        fast = np.flatnonzero(speed >= MOVING * speed.max()) + m // 2
        first, last = int(fast[0]), int(fast[-1]) + 1
        outside = (speed[:first].sum() + speed[last:].sum()) / speed.sum()
        cut = last - first > len(r) // (LEAST if outside < STILL else 2)
        out.append(r[first:last] if cut else r)
    return out

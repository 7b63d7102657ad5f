"""The command as the controller asks for it, and as the drive sends it on: held to a limit.

A drive records what it sent. Where the plant file states the limit (`command_limit`), u is
    u = max(-limit, min(limit, f + C_r r - C_y y)),
the controller going on by its own output, which r and y tell at the limit too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.optimize

from ffl.recordings import Recording
from ffl.systems.loop import Controller
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array

NEAR = 1e-4  # of a limit: a command so close to it, as printed, stands at it
PASSES = 0.05  # of the RMS command: a dead zone that lets less through lets nothing through
# Of the commands: a limit that more of them go beyond leaves their signs. (Where a controller winds up
# 0.956 of them did, 15 times the limit in the median.)
BEYOND = 0.97
STILL = 1e-6  # of the largest command: less is none
INSIDE = 1.02  # times that limit: nearer is at it
EVERYTHING = (0.0, float("inf"))  # a limit and a dead zone beyond which nothing is lost
LONGEST = 10  # times the samples that tell the controller's states: where they are looked for


def limit_of(plant: Plant) -> float | None:
    """What the plant file states of the drive, where a controller knows nothing of it."""
    return plant.machine.command_limit if plant.controller is not None else None


def at_limit(u: Array, limit: float | None) -> Array:
    """(N,) where the command stands at the limit; nowhere without one."""
    return np.zeros(len(u), bool) if limit is None else np.abs(u) >= (1.0 - NEAR) * limit


def reached(plant: Plant, recordings: Sequence[Recording]) -> float | None:
    """The stated limit, if any of the recordings comes to it, or may have."""
    limit = limit_of(plant)
    unknown = any(not np.all(np.isfinite(r.u)) for r in recordings)
    return limit if unknown or any(at_limit(r.u, limit).any() for r in recordings) else None


def passing(recordings: Sequence[Recording]) -> tuple[float, float]:
    """(limit beyond which `BEYOND` of the commands go, half a dead zone that leaves `PASSES` of their RMS).
    What leaves less switches the drive off: it would make noise of all that a machine does. (Where
    friction takes most of the command a limit of a thousandth of it beat the friction.)"""
    sent = [r.u[np.isfinite(r.u)] for r in recordings]
    size = np.abs(np.concatenate(sent))
    wanted = PASSES**2 * float(np.sum(size**2))
    if not wanted > 0.0:
        return EVERYTHING
    moving = size[size > STILL * size.max()]
    zone = scipy.optimize.brentq(
        lambda at: np.sum(np.maximum(size - at, 0.0) ** 2) - wanted, 0.0, size.max()
    )
    return float(np.quantile(moving, 1.0 - BEYOND)), float(zone)


def lets_through(spec: EffectSpec, passing: tuple[float, float]) -> bool:
    """Whether a limit or a dead zone leaves more of the command than those of `passing` do. (Dry friction
    takes 98 % of a microscope stage's command: along the nominal motion, which asks for the rest alone,
    every limit is far below what was recorded, and one that a fit leaves at its bound is none.)"""
    limit, zone = passing
    if spec.name == "saturation":
        return bool(spec.parameters.get("limit", math.inf) > INSIDE * limit)
    if spec.name == "dead_zone":
        return bool(spec.parameters.get("half_width", 0.0) * INSIDE < zone)
    return True


def as_limited(plant: Plant, recording: Recording) -> Recording:
    """The recording with u as the drive sent it, where what was recorded goes beyond the limit."""
    limit = limit_of(plant)
    if limit is None or not np.any(np.abs(recording.u) > limit):
        return recording
    return replace(recording, u=np.clip(recording.u, -limit, limit))


def asked_for(plant: Plant, recording: Recording, fed_back: Array) -> Array | None:
    """The command that the controller asks for, f + `fed_back`, at the limit; elsewhere as recorded. None
    where the limit is never reached."""
    at = at_limit(recording.u, limit_of(plant))
    return np.where(at, recording.f + fed_back, recording.u) if at.any() else None


def feedback_of(
    controller: Controller, recording: Recording, limit: float | None = None
) -> tuple[Array, Array]:
    """(states at the start, u_fb) of the controller fed with the recorded r and y.

    The states are those that explain u - f best over the first samples below the `limit`: exact where the
    controller is the one that ran, since u_fb = C_r r - C_y y leaves nothing else free.
    """
    system = controller.state_space
    inputs = np.column_stack([recording.r, recording.y])
    forced = np.atleast_1d(system.filter(inputs))
    n = system.order
    if not n or not np.all(np.isfinite(recording.u)):
        return np.zeros(n), forced
    rows = min(len(recording), max(20 * n, 200))
    below = np.flatnonzero(~at_limit(recording.u[: LONGEST * rows], limit))[:rows]
    free = np.empty((len(below) and int(below[-1]) + 1, n))
    state = np.eye(n)
    for k in range(len(free)):
        free[k] = system.c[0] @ state
        state = system.a @ state
    wanted = (recording.u - recording.f - forced)[below]
    free = free[below]
    scale = np.maximum(np.linalg.norm(free, axis=0), 1e-300)
    states = np.linalg.lstsq(free / scale, wanted, rcond=1e-12)[0] / scale
    return states, np.atleast_1d(system.filter(inputs, states))

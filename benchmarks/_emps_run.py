"""The carriage of EMPS under a law of friction, free of its servo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from emps_open_loop import START
from numba import njit

from ffl.recordings import Recording

Array = np.ndarray
STEP = 1e-3  # s
STROKE = 0.2465  # m


@dataclass(frozen=True)
class Law:
    """m a = F - load - s (c_s(x) + b_s |v|), s = +1 up, -1 down; c_s straight between levels at places
    evenly over the stroke."""

    mass: float
    load: float
    viscous: tuple[float, float]
    up: Array
    down: Array

    def numbers(self) -> Array:
        return np.concatenate([[self.mass, self.load, *self.viscous], self.up, self.down])

    def levels(self, x: Array) -> tuple[Array, Array]:
        places = np.linspace(0, STROKE, len(self.up))
        return np.interp(x, places, self.up), np.interp(x, places, self.down)


@njit(error_model="numpy")
def _level(p, s, x):  # type: ignore[no-untyped-def]
    count = (len(p) - 4) // 2
    place = min(max(x / STROKE, 0.0), 1.0) * (count - 1)
    low = min(int(place), count - 2)
    first = low + (4 if s > 0.0 else 4 + count)
    return p[first] + (place - low) * (p[first + 1] - p[first])


@njit(error_model="numpy")
def _slide(p, s, x, v, force, time):  # type: ignore[no-untyped-def]
    """Velocity after `time` in direction s: level of the middle, viscous friction by the trapezoid."""
    level, viscous = _level(p, s, x + 0.5 * time * v), p[2] if s > 0.0 else p[3]
    inertia = p[0] / time
    return ((inertia - 0.5 * viscous) * v + force - s * level) / (inertia + 0.5 * viscous)


@njit(error_model="numpy")
def _leaves(p, x, force):  # type: ignore[no-untyped-def]
    """Direction in which the carriage leaves from rest, 0 where it sticks. A level below zero lets it
    leave either way; then the force decides."""
    s = 1.0 if force > 0.0 else -1.0
    return s if abs(force) > _level(p, s, x) else 0.0


@njit(error_model="numpy")
def _run(p, x, v, command, y):  # type: ignore[no-untyped-def]
    for k in range(len(y)):
        y[k] = x
        force, left = command[k] - p[1], STEP
        s = np.sign(v) if v != 0.0 else _leaves(p, x, force)
        if s == 0.0:
            continue
        end = _slide(p, s, x, v, force, left)
        if s * end < 0.0:  # stops within the step: the rest of it from rest, the other way or not
            spent = left * v / (v - end)
            x, v, left = x + 0.5 * spent * v, 0.0, left - spent
            if left <= 0.0 or -s * force <= _level(p, -s, x):
                continue
            end = _slide(p, -s, x, v, force, left)
        x, v = x + 0.5 * left * (v + end), end


@dataclass(frozen=True)
class Part:
    """Samples of a recording and the force that acts after each."""

    y: Array
    force: Array

    @classmethod
    def of(cls, recording: Recording, delay: float) -> Part:
        u = recording.u
        return cls(recording.y, (1 - delay) * u + delay * np.r_[u[0], u[:-1]])

    def cut(self, where: slice) -> Part:
        return Part(self.y[where], self.force[where])

    def errors(self, law: Law, offset: float = 0.0) -> Array:
        """y - yhat in mm, without the samples that position and velocity at the start are found from."""
        p, command = law.numbers(), self.force + offset

        def left(x: float, v: float, samples: int) -> Array:
            run = np.empty(samples)
            _run(p, x, v, command, run)
            return self.y[:samples] - run

        (x, v), unit = np.polyfit(STEP * np.arange(START), self.y[:START], 2)[:0:-1], 1e-5
        for _ in range(4):
            now = left(x, v, START)
            slope = (now - left(x, v + unit, START)) / unit
            change = np.linalg.lstsq(np.column_stack([np.ones(START), slope]), now, rcond=None)[0]
            x, v = x + change[0], v + change[1]
        return 1e3 * left(x, v, len(self.y))[START:]


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))

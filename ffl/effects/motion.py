"""The motion of a point of the machine, and what drives it: what an effect answers to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ffl.systems.state_space import Array


@dataclass(frozen=True)
class Extent:
    """How far recordings reach: `duration` of the longest, s; `travel`, from the least y of all to the
    largest, `lowest` and `highest`, and `largest` |y| beyond noise, in output units; top `speed`, those per
    second."""

    duration: float
    travel: float = np.inf
    largest: float = 0.0
    speed: float = np.inf
    lowest: float = -np.inf
    highest: float = np.inf


@dataclass(frozen=True)
class Motion:
    """Simulated signals of one recording, each of shape (N,).

    `t` s; `r` reference; `u` command as sent; `x`, `v`, `a` position, velocity and acceleration of
    the point where an effect acts (output units and their time derivatives), noise-free; `mass` of
    the moving part (force unit s^2 / output unit; 1/`Mechanics` residue); `warm` what the machine was
    warmed with before the first sample, in squares of the command; `turn` of a full turn where x is an
    angle, in units of x; `others` what else was recorded, by name.
    """

    t: Array
    r: Array
    u: Array
    x: Array
    v: Array
    a: Array
    sample_time: float
    mass: float = 1.0
    warm: float = 0.0
    turn: float = 2.0 * np.pi
    others: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def of_reference(cls, r: Array, sample_time: float, mass: float = 1.0) -> Motion:
        """The motion a reference asks for: central differences, v = dr/dt, a = d2r/dt2."""
        r = np.asarray(r, float)
        v = np.gradient(r, sample_time)
        t = sample_time * np.arange(len(r))
        return cls(t, r, np.zeros_like(r), r, v, np.gradient(v, sample_time), sample_time, mass)

    @classmethod
    def still(cls, position: float, sample_time: float, time: float = 0.0) -> Motion:
        """Two samples of standstill at a position and a time, without command."""
        at, zero = np.full(2, position), np.zeros(2)
        return cls(np.full(2, time), at, zero, at, zero, zero, sample_time)

    @property
    def mid_sample(self) -> Motion:
        """Half a sample later, where a force that is held over a sample is felt."""

        def later(q: Array) -> Array:
            return np.append(0.5 * (q[1:] + q[:-1]), q[-1])

        others = {name: later(q) for name, q in self.others.items()}
        return replace(self, x=later(self.x), v=later(self.v), a=later(self.a), others=others)

    @property
    def direction(self) -> Array:
        """Sign of v, straight through zero below a thousandth of the largest |v|: at standstill a
        simulated velocity is rounding, and its sign would be noise."""
        floor = 1e-3 * float(np.abs(self.v).max(initial=0.0))
        return np.clip(self.v / floor, -1.0, 1.0) if floor > 0 else np.zeros_like(self.v)

    @property
    def span(self) -> float:
        """Largest minus smallest position."""
        return float(np.ptp(self.x)) if len(self.x) else 0.0

    @property
    def middle(self) -> float:
        return 0.5 * float(self.x.max() + self.x.min())

"""A machine under construction: a body to which effects add masses, elements and electronics."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ffl.challenge import kernel
from ffl.challenge.body import Body
from ffl.challenge.linear import Servo

N_GRID = 33  # nodes of a friction table


class Draws(Protocol):
    """What the numbers of an effect are drawn from: a generator, or one that moves a number."""

    def uniform(
        self, low: float = ..., high: float = ..., size: int | None = ...
    ) -> float | np.ndarray: ...

    def choice(self, values: list, /) -> object: ...

    def random(self) -> float: ...


@dataclass(frozen=True)
class Scales:
    """Sizes of a machine's motion: peaks, the range of position and its standard deviation."""

    force: float  # N, peak of the actuator
    command: float  # input unit, peak
    command_levels: np.ndarray  # quantiles 0, 1/100, ... of |command|
    force_rms: float
    speed: float
    speed_rms: float
    acceleration: float
    low: float
    high: float
    position_rms: float
    sample_time: float
    duration: float
    quantum: float  # s: the small step; delays are whole multiples of it

    @property
    def stroke(self) -> float:
        return self.high - self.low


@dataclass
class Build:
    """Body, elements, amplifier and encoder, ready for the kernel."""

    body: Body
    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    motor: np.ndarray
    gauge: np.ndarray
    gauge_rate: np.ndarray
    ports: list[np.ndarray]
    elements: list[np.ndarray] = field(default_factory=list)
    tables: list[np.ndarray] = field(default_factory=list)
    actuator: np.ndarray = field(default_factory=lambda: np.zeros(kernel.N_ACTUATOR))
    sensor: np.ndarray = field(default_factory=lambda: np.zeros(kernel.N_SENSOR))
    knocks: list[tuple[float, float, float]] = field(default_factory=list)  # rate, N, s
    loss: float = 0.0  # probability that a command does not arrive

    @classmethod
    def of(cls, body: Body) -> Build:
        build = cls(
            body,
            body.mass.copy(),
            body.damping.copy(),
            body.stiffness.copy(),
            body.motor.copy(),
            body.gauge.copy(),
            body.gauge_rate.copy(),
            [body.motor.copy(), body.load.copy()],
        )
        return build

    @property
    def random(self) -> bool:
        """Something in it comes at random, and only where a run draws noise, be it none at all."""
        return bool(self.knocks or self.loss)

    def port(self, at: str) -> int:
        """Row of `ports` of the named point."""
        return {"motor": 0, "load": 1}[at]

    def add_port(self, direction: np.ndarray) -> int:
        self.ports.append(np.array(direction, float))
        return len(self.ports) - 1

    def add(self, code: int, port: int, *parameters: float) -> None:
        """One force element on a port."""
        row = np.zeros(kernel.N_COLUMNS)
        row[0], row[1] = code, port
        row[2 : 2 + len(parameters)] = parameters
        self.elements.append(row)

    def add_dry(
        self,
        port: int,
        up: float,
        down: float,
        ratio: float = 0.0,
        speed: float = 0.0,
        table: int = -1,
        share: float = 0.0,
    ) -> None:
        """Set-valued friction; up: level while the point moves in the positive direction."""
        self.add(kernel.DRY, port, up, down, ratio, speed, table, share)

    def add_mass(self) -> int:
        """One more degree of freedom without mass; returns its index."""
        n = len(self.motor) + 1
        for name in ("mass", "damping", "stiffness"):
            big = np.zeros((n, n))
            big[:-1, :-1] = getattr(self, name)
            setattr(self, name, big)
        for name in ("motor", "gauge", "gauge_rate"):
            setattr(self, name, np.append(getattr(self, name), 0.0))
        self.ports = [np.append(p, 0.0) for p in self.ports]
        return n - 1

    def run(
        self,
        servo: Servo | None,
        reference: np.ndarray,
        feedforward: np.ndarray,
        sample_time: float,
        steps: int,
        sensor_noise: np.ndarray | None = None,
        force_noise: np.ndarray | None = None,
        external: np.ndarray | None = None,
        lost: np.ndarray | None = None,
        start: float = 0.0,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Simulate. Returns y, u, and the true position and velocity of the motor's point."""
        h = sample_time / steps
        inverse = np.linalg.inv(self.mass + 0.5 * h * self.damping)
        keep = inverse @ (self.mass - 0.5 * h * self.damping)
        none = np.zeros(len(reference))
        width = 2 + 2 * N_GRID
        empty = np.zeros((0, 6))
        return kernel.simulate(
            inverse,
            keep,
            self.stiffness,
            self.motor,
            self.gauge,
            self.gauge_rate,
            self.body.constant,
            np.array(self.ports),
            np.array(self.elements).reshape(-1, kernel.N_COLUMNS),
            np.array(self.tables).reshape(-1, width),
            self.actuator,
            self.sensor,
            empty if servo is None else np.ascontiguousarray(servo.reference.sections),
            empty
            if servo is None or servo.output is None
            else np.ascontiguousarray(servo.output.sections),
            reference,
            feedforward,
            none if sensor_noise is None else sensor_noise,
            none if force_noise is None else force_noise,
            none if external is None else external,
            none if lost is None else lost,
            sample_time,
            steps,
            start,
        )

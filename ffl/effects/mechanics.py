"""Where forces act and motion is felt: the plant as a mechanical system with points.

A zeros-poles-gain says what the plant does from command to sensor, not where things are. Taken
apart into its modes, y = sum_i G_i u, each mode i has a shape phi_i(point) and
G_i = phi_i(motor) phi_i(sensor) / (s^2 + 2 zeta w s + w^2); a force at a point then drives mode i
with phi_i(point), and the motion of a point is sum_i phi_i(point) eta_i, so that a collocated
response (force and motion at one point) has positive residues only. The residues of the plant give
the products phi_i(motor) phi_i(sensor). What they leave open is settled by the two-mass picture:

* phi_i(motor)^2 = ratio * phi_0^2, and so phi_i(sensor)/phi_i(motor) = +-(residue_i/residue_0)/ratio,
  with the sign of the residue relative to the rigid body's. For two masses, ratio is the mass of the
  load side over that of the motor side.
* Without `mass_ratio`, sensor and motor are taken to move equally far in every mode: at a positive
  residue they are then one point, which two masses measured at the motor are; at a negative one they
  are the two ends. With it, the ratio holds for all modes (1 for a beam driven at its end).
* The load is the sensor where the residue is negative, else phi_i(load)/phi_i(motor) = -1/ratio.

Positions are in output units, forces in input units, masses therefore in input unit s^2 / output
unit.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ffl.effects.cascade import BETWEEN, OUT, stage_point
from ffl.effects.point import Point
from ffl.effects.resonance import pole_of, spring_for
from ffl.effects.two_masses import TwoMasses, across, collocated
from ffl.errors import InputError
from ffl.systems.state_space import Array, StateSpace

HUNG = "flexible_mode"  # the spring on which the load of a machine of one body hangs
SIDES = ("sensor", "motor", "load", "coupling", *BETWEEN, *OUT)


@dataclass(frozen=True)
class Mechanics:
    """The plant from command to noise-free output in continuous time, with its modes.

    dx/dt = `a` x + `b` u, y = `c` x + `d` u, u delayed by `delay` samples. `exact` holds the
    plant's own discrete matrices as long as nothing has been changed, so that the linear loop stays
    equal to the last digit. `fast` is a part that no continuous system can have under a zero-order
    hold (poles at or left of z = 0); it adds to y and feels no other force than u. `rest` reads the
    share of y that belongs to no mode. `sign` is -1 where u > 0 drives y down. `bias` are constant
    forces at points, which loads and centred springs bring. States that effects add come last;
    `hung` gives their start, at rest beside the plant, from the plant's own states. `sensor`
    replaces the sensor's point where an effect has moved it; `links` are the springs, by name, on
    which effects have hung a mass (force pair and stretch between the two). `origin` is the plant
    before any effect changed it, where its points are known; `push` and `pull` bring them here.
    `place` reads the position where y is a speed: the last state of such a plant is its integral.
    `inertia` is how many times the plant's own mass every mode has by now.
    """

    a: Array
    b: Array
    c: Array
    d: float
    sample_time: float
    delay: int
    rest: Array
    modes: tuple[Mode, ...]
    sign: float
    exact: StateSpace | None
    fast: StateSpace
    bias: tuple[tuple[Point, float], ...] = ()
    hung: Array = field(default_factory=lambda: np.zeros((0, 0)))
    sensor: Point | None = None
    links: tuple[tuple[str, Point], ...] = ()
    origin: Mechanics | None = None
    push: Array | None = None
    pull: Array | None = None
    place: Array | None = None
    inertia: float = 1.0

    @property
    def order(self) -> int:
        return self.a.shape[0]

    @property
    def own(self) -> int:
        """States of the plant itself, the integral of a measured speed left out."""
        return self.order - (self.place is not None)

    @property
    def position(self) -> Array:
        """The row that reads the position of the measured side."""
        return self.c if self.place is None else self.place

    @property
    def moving_mass(self) -> float:
        """1/(residue of the rigid body, or of the lowest mode), input unit s^2 / output unit."""
        if not self.modes:
            raise InputError(
                "the plant has no mode (fewer than two poles from input to output), so it moves no "
                "mass; effects on a mass do not apply to it"
            )
        return 1.0 / self.modes[0].residue

    def point(self, side: str = "sensor", mass_ratio: float | None = None) -> Point:
        """The point on `side`: 'sensor', 'motor', 'load', or 'coupling' (motor minus load); for a row
        of lags those of `ffl.effects.cascade`, with the share that arrives as `mass_ratio`."""
        if side in (names := dict(self.links)):
            return names[side]
        if side not in SIDES:
            raise InputError(f"side = '{side}' is unknown; take one of {', '.join(SIDES)}")
        if side == "sensor" and self.sensor is not None:
            return self.sensor
        if (
            side == "load"
            and HUNG in names
            and self.origin is not None
            and len(self.origin.modes) == 1
        ):
            return self.point("motor", mass_ratio).minus(
                names[HUNG]
            )  # of one body the part on a spring
        if self.origin is not None and self.push is not None and self.pull is not None:
            return self.origin.point(side, mass_ratio).mapped(self.push, self.pull)
        if side in (*BETWEEN, *OUT):
            return stage_point(self, side, mass_ratio)
        if not self.modes:
            return Point(self.b * self.sign, self.position, np.zeros(self.order))
        if (pair := self.two_masses(mass_ratio)) is not None:
            at = {"motor": pair.motor, "load": pair.load, "sensor": pair.sensor}
            return pair.motor.minus(pair.load) if side == "coupling" else at[side]
        if side == "coupling":
            return self._of_modes("motor", mass_ratio).minus(self._of_modes("load", mass_ratio))
        if side == "motor" and not self.rest.any():
            return self._motor(mass_ratio)
        return self._of_modes(side, mass_ratio)

    def two_masses(self, mass_ratio: float | None = None) -> TwoMasses | None:
        """The plant as two masses on a spring, where it is just that."""
        if len(self.modes) != 2 or self.rest.any():
            return None
        if self.modes[1].sign > 0:
            return self._collocated if mass_ratio is None else None
        ratio = mass_ratio or self.modes[1].residue / self.modes[0].residue
        if ratio not in self._across:
            self._across[ratio] = across(self.a, self.b * self.sign, self.position, ratio)
        return self._across[ratio]

    @cached_property
    def _across(self) -> dict[float, TwoMasses | None]:
        """By mass ratio; filled as asked for."""
        return {}

    @cached_property
    def _collocated(self) -> TwoMasses | None:
        return collocated(self.a, self.b * self.sign, self.position)

    def coupling(self, mass_ratio: float | None = None) -> tuple[float, float]:
        """Stiffness and damping of the spring between motor and load (of the first mode); with more mass
        in every mode (`inertia` times) it is as much stiffer, for the mode keeps its frequency."""
        if (pair := (self.origin or self).two_masses(mass_ratio)) is not None:
            return self.inertia * pair.stiffness, self.inertia * pair.damping
        mass = self.inertia / (self.origin or self).point("coupling", mass_ratio).mobility
        return self.modes[1].stiffness * mass, self.modes[1].damping * mass

    def _of_modes(self, side: str, mass_ratio: float | None) -> Point:
        """A point whose force accelerates every mode by its shape there, and nothing else."""
        force, position = np.zeros(self.order), np.array(self.rest)
        velocity = self.rest @ self.a
        for mode in self.modes:
            shape = mode.shape(side, mass_ratio, self.modes[0].residue)
            to_sensor = mode.shape("sensor", mass_ratio, self.modes[0].residue)
            force += mode.force * (mode.sign * shape)
            position += mode.position * (shape / to_sensor)
            velocity += mode.velocity * (shape / to_sensor)
        return Point(force, position, velocity)

    def _motor(self, mass_ratio: float | None) -> Point:
        """The point that u drives: its force vector is that of u, also where the sensor mixes in
        velocities (a non-minimum-phase sensor), and the response there has no zero per mode."""
        position, velocity = np.zeros(self.order), np.zeros(self.order)
        for mode in self.modes:
            to_sensor = mode.shape("sensor", mass_ratio, self.modes[0].residue)
            position += mode.motor_position * (mode.residue / abs(to_sensor))
            velocity += mode.motor_velocity * (mode.residue / abs(to_sensor))
        return Point(self.b * self.sign, position * self.sign, velocity * self.sign)

    def _changed(self, push: Array, pull: Array, **changes: Any) -> Mechanics:
        """With other states or inertia: forces go by `push` from here on, rows by `pull`."""
        n = self.order
        before = (np.eye(n), np.eye(n)) if self.push is None else (self.push, self.pull)
        return replace(
            self,
            b=push @ self.b,
            exact=None,
            bias=tuple((p.mapped(push, pull), f) for p, f in self.bias),
            links=tuple((name, p.mapped(push, pull)) for name, p in self.links),
            place=None if self.place is None else self.place @ pull,
            sensor=self.sensor and self.sensor.mapped(push, pull),
            origin=self.origin or self,
            push=push @ before[0],
            pull=before[1] @ pull,
            **changes,
        )

    def with_feedback(self, point: Point, position: float, velocity: float) -> Mechanics:
        """Adds the force position * x + velocity * v at `point` to the linear part."""
        row = position * point.position + velocity * point.velocity
        same = np.eye(self.order)
        return self._changed(same, same, a=self.a + np.outer(point.force, row))

    def with_load(self, point: Point, force: float) -> Mechanics:
        """Adds a constant force at `point`."""
        return replace(self, bias=(*self.bias, (point, force)))

    def as_command(self, point: Point) -> float:
        """The command that moves the output at low frequencies as a unit force at `point` does. It is
        `sign` where forces act as u does; zeros and lags that belong to no mode make it another."""
        poles = (
            np.abs(np.linalg.eigvals(self.a[: self.own, : self.own])) if self.own else np.ones(1)
        )
        slow = 1e-6 * float(min(poles[poles > 1e-9 * poles.max()], default=1.0))
        matrix = slow * np.eye(self.order) - self.a
        by_force, by_command = self.c @ np.linalg.solve(matrix, np.stack([point.force, self.b]).T)
        by_command += self.d + float(self.fast.at(np.exp(slow * self.sample_time))[0].real)
        return float(by_force / by_command)

    def with_part_on_spring(
        self,
        link: str,
        side: tuple[str, float | None],
        share: float,
        frequency: float,
        damping: float,
        sensed: bool,
        damped: bool = False,
        whole: bool = False,
    ) -> Mechanics:
        """Cuts `share` of the moving mass off at `side` and hangs it there on a spring and damper, so
        that it resonates at `frequency` Hz with `damping` against what else moves at that point, or
        (`whole`) so that the machine does. The spring is the point `link`; `sensed`: the sensor moves
        with the part cut off; `damped`: the rigid body's own damping acts on that part."""
        mass = share * self.moving_mass
        lighter = self.with_mass(self.point(*side), -mass)
        point = lighter.point(*side)
        if whole:
            law = spring_for(lighter.a, point, mass, pole_of(frequency, damping))
        else:
            pulsation, reduced = 2.0 * np.pi * frequency, 1.0 / (1.0 / mass + point.mobility)
            law = pulsation**2 * reduced, 2.0 * damping * pulsation * reduced
        own = self.modes[0].damping / self.modes[0].residue if damped else 0.0
        return lighter._with_hung_mass(link, point, mass, (*law, own), sensed)

    def _with_hung_mass(
        self, link: str, point: Point, mass: float, law: tuple[float, float, float], sensed: bool
    ) -> Mechanics:
        """`law`: stiffness and damping between the two, and damping that moves from `point` to the mass."""
        n, (stiffness, damping, own) = self.order, law
        row = stiffness * point.position + damping * point.velocity
        a = np.zeros((n + 2, n + 2))
        a[:n, :n] = self.a - np.outer(point.force, row - own * point.velocity)
        a[:n, n], a[:n, n + 1] = point.force * stiffness, point.force * damping
        a[n, n + 1] = 1.0
        a[n + 1, :n], a[n + 1, n:] = row / mass, [-stiffness / mass, -(damping + own) / mass]

        push, pull = np.eye(n + 2)[:, :n], np.eye(n + 2)[:n]
        base = self.hung.shape[1] or n
        known = np.vstack([np.eye(base), self.hung]) if len(self.hung) else np.eye(base)
        hung = np.vstack([known[base:], point.position @ known, point.velocity @ known])
        hung_point = Point(*(np.eye(n + 2)[[n + 1, n, n + 1]] * np.array([[1 / mass], [1], [1]])))
        changed = self._changed(push, pull, a=a, c=self.c @ pull, hung=hung)
        changed = replace(
            changed, links=(*changed.links, (link, point.mapped(push, pull).minus(hung_point)))
        )
        if not sensed:
            return changed
        row = hung_point.position if self.place is None else hung_point.velocity
        return replace(changed, c=row, sensor=hung_point)

    def with_inertia(self, factor: float) -> Mechanics:
        """`factor` times the mass in every mode: each force moves less, damping and spring of the first
        mode stay what they are as forces, and the other modes keep their frequency and damping."""
        gain, same, first = 1.0 / factor, np.eye(self.order), self.modes[0]
        force = first.force / first.residue
        row = first.damping * first.velocity + first.stiffness * first.position
        if self.push is not None and self.pull is not None:
            force, row = self.push @ force, row @ self.pull
        a = self.a - (gain - 1.0) * np.outer(force, row)
        fast = StateSpace(
            self.fast.a, self.fast.b, gain * self.fast.c, gain * self.fast.d, self.sample_time
        )
        inertia = factor * self.inertia
        return self._changed(gain * same, same, a=a, d=self.d * gain, fast=fast, inertia=inertia)

    def with_mass(self, point: Point, mass: float) -> Mechanics:
        """Adds the force -mass * acceleration at `point` to the linear part."""
        mobility = point.mobility
        if 1.0 + mass * mobility <= 0:
            raise InputError(
                f"a mass change of {mass:g} leaves no positive mass at the point (it has "
                f"{1 / mobility:g}); give a smaller reduction"
            )
        share = mass / (1.0 + mass * mobility)

        same = np.eye(self.order)
        push = same - np.outer(point.force, share * point.velocity)
        a = self.a - np.outer(point.force, share * (point.velocity @ self.a))
        return self._changed(push, same, a=a)


@dataclass(frozen=True)
class Mode:
    """One second-order part of the plant.

    `position` and `velocity` read its share of y and dy/dt from the state, `force` is the state
    derivative that gives its share of y the acceleration `residue` = |phi(motor) phi(sensor)|.
    `motor_position` and `motor_velocity` read the motion that u itself drives without a zero, with
    unit acceleration: phi(motor)^2 of them is the mode's share of the motor's motion. `sign` is the
    sign of that product relative to the rigid body's. Left alone, its share of y follows
    d2y/dt2 + `damping` dy/dt + `stiffness` y = 0.
    """

    force: Array
    position: Array
    velocity: Array
    motor_position: Array
    motor_velocity: Array
    residue: float
    sign: float
    stiffness: float
    damping: float
    rigid: bool

    def shape(self, side: str, mass_ratio: float | None, rigid_residue: float) -> float:
        """phi(side)/phi(motor), 1 for the rigid body."""
        if self.rigid or side == "motor":
            return 1.0
        relative = self.residue / rigid_residue
        ratio = relative if mass_ratio is None else mass_ratio
        if side == "load" and self.sign > 0:
            return -1.0 / ratio
        return self.sign * relative / ratio

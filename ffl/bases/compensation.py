"""Feedforward from a diagnosis: what cancels the found effects, as functions of the reference.

An effect pushes at its own point of the machine, the command at the motor. With P from command to
output, P_F from the effect's force to output and P_x from command to the position of the effect's
point, an output that follows the reference means

    position at the point   x = (P_x / P) r,
    command that cancels F  f = (P_F / P) F(x),

both bounded by two-sided filtering where P has zeros outside the unit disc. On a rigid machine both
quotients are 1. What f meets on its way to the motor is undone: where it arrives `ahead` late the reference
is read as much earlier, of a lag with pole a = exp(-T/tau) what comes in for c_k to come out in the mean
over sample k is

    (x_{k+1} - a x_k) / (1 - a),   x_{k+1} = c_k + (1 + tau/T - 1/(1 - a)) (c_{k+1} - c_k),

and a motor whose force per command is k(x) asks, with u_r = M (a + d v + c x) and the forces cancelled
what the machine takes, for (1/k(x) - 1) u_r beside that.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.interpolate
import scipy.linalg
from numpy.typing import ArrayLike

from ffl.bases.base import Basis
from ffl.effects import Mechanics, Motion, Point, effect_of
from ffl.effects.linear_mechanics import mechanics_with_effects, times_of
from ffl.errors import InputError
from ffl.systems import Plant, StateSpace, Zpk
from ffl.systems.state_space import Array
from ffl.systems.two_sided import two_sided_filter
from ffl.systems.zpk import as_zpk

FAR = 1e4  # sampling zeros lie within 25 for relative degrees up to 5; rounding's beyond 1e6


class Compensation(Basis):
    """The compensation of every effect of `plant` that has one, weighted freely.

    Columns are the effect's `compensation` for the motion that the reference asks of its point,
    with the non-linear parameters of the plant file, divided by the motor constant where it is
    known: the coefficients of Coulomb friction, cogging (sine, cosine), springs and the like are
    then newton, newton per metre, and learned trial by trial. Effects without a compensation
    (`without`: sensors, disturbances in time, most of what acts on the command) give no column. Raises
    `InputError` where no effect has one.
    """

    def __init__(self, plant: Plant, sample_time: float | None = None) -> None:
        self.plant = plant
        self.sample_time = plant.sample_time
        if sample_time is not None and abs(sample_time / self.sample_time - 1.0) > 1e-9:
            raise InputError(
                f"from_diagnosis: plant {plant.name} has sample_time = {self.sample_time:g} s, the "
                f"model {sample_time:g} s; give both the same"
            )
        self._mechanics = mechanics_with_effects(plant)
        probe = Motion.of_reference(np.linspace(0.0, 1.0, 8), self.sample_time)
        self._names: list[str] = []
        self._effects: list[Any] = []
        self.without: list[str] = []
        for spec in plant.effects:
            effect = effect_of(spec)
            chosen = {k: v for k, v in spec.options.items() if k in effect.options}
            nonlinear = {**effect.compensated_along(effect.check(spec)), **chosen}
            columns = effect.compensation(probe, **nonlinear)
            if columns is None:
                self.without.append(spec.name)
                continue
            count = columns.shape[1]
            kept = f"{spec.name}_{1 + sum(e.name == spec.name for _, e, _ in self._effects)}"
            name = kept if any(e.name == spec.name for _, e, _ in self._effects) else spec.name
            self._names += [name] if count == 1 else [f"{name}[{k}]" for k in range(count)]
            self._effects.append((spec, effect, nonlinear))
        if not self._effects:
            which = f" ({', '.join(self.without)} have none)" if self.without else ""
            raise InputError(
                f"from_diagnosis: plant {plant.name} has no effect with a compensation{which}; give "
                'the augmented.toml of a diagnosis, as plant = "augmented.toml" or as the model'
            )

    @property
    def names(self) -> list[str]:
        return list(self._names)

    @property
    def stated(self) -> Array:
        """The weights that the plant file's own parameters give."""
        parts = [effect.coefficients_of(effect.check(spec)) for spec, effect, _ in self._effects]
        return np.concatenate(parts)

    @property
    def preview(self) -> int:
        return -1

    @property
    def ahead(self) -> float:
        """Time (s) by which the machine gets a command late."""
        late = times_of(self.plant.effects, "input_delay")
        return self._mechanics.delay * self.sample_time + sum(late)

    def regressors(self, reference: ArrayLike) -> Array:
        r = _earlier(np.asarray(reference, float), self.ahead / self.sample_time)
        blocks: dict[int, Array] = {}
        driving = self._driving(r)
        # The motor turns into force what all others ask for: it comes last.
        for k in sorted(range(len(self._effects)), key=lambda k: self._at_motor(k)):
            spec, effect, nonlinear = self._effects[k]
            side = spec.options.get("side", effect.default_side)
            point = self._mechanics.point(side, spec.options.get("mass_ratio"))
            to_point, to_command = self._quotients(point)
            x = r if to_point is None else two_sided_filter(to_point, r, hold=True)
            mass = self._mechanics.moving_mass * self._constant if self._mechanics.modes else 1.0
            motion = Motion.of_reference(x, self.sample_time, mass)
            columns = effect.compensation(replace(motion, u=driving), **nonlinear)
            assert columns is not None
            if self._at_motor(k):
                blocks[k] = columns
                continue
            if to_command is None:
                columns = self._mechanics.sign * columns
            else:
                columns = np.column_stack(
                    [two_sided_filter(to_command, c, hold=True) for c in columns.T]
                )
            blocks[k] = columns / self._constant
            driving = driving + blocks[k] @ effect.coefficients_of(effect.check(spec))
        columns = np.hstack([blocks[k] for k in range(len(blocks))])
        for lag in times_of(self.plant.effects, "actuator_lag"):
            columns = _before_lag(columns, lag, self.sample_time)
        return columns

    @property
    def _constant(self) -> float:
        return self.plant.physics.motor_constant or 1.0

    def _at_motor(self, k: int) -> bool:
        return bool(self._effects[k][1].port == "command")

    def _driving(self, r: Array) -> Array:
        """(N,) the command that the first mode takes along `r`; zero where nothing is moved."""
        m = self._mechanics
        if not m.modes:
            return np.zeros_like(r)
        motion, first = Motion.of_reference(r, self.sample_time), m.modes[0]
        taken = motion.a + first.damping * motion.v + first.stiffness * motion.x
        return m.sign * m.moving_mass * taken

    def _quotients(self, point: Point) -> tuple[Zpk | None, Zpk | None]:
        """P_x/P and P_F/P; None where the point's motion is the output, its force the command's, or
        against it where the command drives y down."""
        m = self._mechanics
        moves_alike = np.allclose(point.position, m.c, rtol=1e-9, atol=1e-9 * np.abs(m.c).max())
        pushed_alike = np.allclose(
            point.force, m.b * m.sign, rtol=1e-9, atol=1e-9 * np.abs(m.b).max()
        )
        to_point = None if moves_alike else self._quotient(m.b, point.position)
        if pushed_alike:
            return to_point, None
        return to_point, self._quotient(point.force, m.c)

    def _quotient(self, force: Array, row: Array) -> Zpk:
        """(response from `force` to `row`) / (response from the command to the output)."""
        m = self._mechanics
        top, bottom = _finite(sampled(m, force, row)), _finite(sampled(m, m.b, m.c))
        return Zpk(top.zeros, bottom.zeros, top.gain / bottom.gain, m.sample_time)


def _earlier(r: Array, samples: float) -> Array:
    """`r` so many samples earlier, a spline between samples, the last value held."""
    if not samples or len(r) < 4:
        return r
    whole = int(samples)
    held = np.append(r[whole:], np.full(min(whole, len(r)), r[-1]))
    if samples == whole:
        return held
    n = np.arange(len(r) + 1.0)
    spline = scipy.interpolate.CubicSpline(n, np.append(held, held[-1]))
    return np.asarray(spline(n[:-1] + (samples - whole)))


def _before_lag(columns: Array, time_constant: float, sample_time: float) -> Array:
    """What comes into a lag for `columns` to come out, in the mean over each sample."""
    step = sample_time / time_constant
    pole = np.exp(-step)
    # Where the lag must be at the samples' ends for its mean over each to be the column's.
    later = 1.0 + 1.0 / step - 1.0 / (1.0 - pole)
    ends = columns + later * (np.vstack([columns[1:], columns[-1:]]) - columns)
    begun = np.vstack([columns[:1], ends[:-1]])
    return np.asarray((ends - pole * begun) / (1.0 - pole))


def _finite(system: StateSpace) -> Zpk:
    """Zeros, poles and gain; a zero that only rounding brought in from infinity becomes gain."""
    zpk = as_zpk(system)
    far = np.abs(zpk.zeros) > FAR
    gain = zpk.gain * float(np.prod(-zpk.zeros[far]).real)
    return Zpk(zpk.zeros[~far], zpk.poles, gain, zpk.sample_time)


def sampled(mechanics: Mechanics, force: Array, row: Array) -> StateSpace:
    """Zero-order hold of the continuous mechanics from a force vector to a row of its states."""
    n, h = mechanics.order, mechanics.sample_time
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = mechanics.a * h, force * h
    whole = scipy.linalg.expm(block)
    return StateSpace(whole[:n, :n], whole[:n, n:], row[None, :], 0.0, h)

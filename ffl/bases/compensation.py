"""Feedforward from a diagnosis: what cancels the found effects, as functions of the reference.

An effect pushes at its own point of the machine, the command at the motor. With P from command to
output, P_F from the effect's force to output and P_x from command to the position of the effect's
point, an output that follows the reference means

    position at the point   x = (P_x / P) r,
    command that cancels F  f = (P_F / P) F(x),

both bounded by two-sided filtering where P has zeros outside the unit disc. On a rigid machine both
quotients are 1.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ffl.bases.base import Basis
from ffl.effects import Mechanics, Motion, Point, effect_of
from ffl.effects.linear_mechanics import mechanics_with_effects
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
    (`without`: sensors, disturbances in time, what acts on the command) give no column. Raises
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
            nonlinear = {**effect.nonlinear_of(effect.check(spec)), **chosen}
            columns = None if effect.port != "force" else effect.compensation(probe, **nonlinear)
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
    def theta(self) -> Array:
        """The weights that the plant file's own parameters give."""
        parts = [effect.coefficients_of(effect.check(spec)) for spec, effect, _ in self._effects]
        return np.concatenate(parts)

    @property
    def preview(self) -> int:
        return -1

    def regressors(self, reference: ArrayLike) -> Array:
        r = np.asarray(reference, float)
        constant = self.plant.physics.motor_constant or 1.0
        blocks = []
        for spec, effect, nonlinear in self._effects:
            side = spec.options.get("side", effect.default_side)
            point = self._mechanics.point(side, spec.options.get("mass_ratio"))
            to_point, to_command = self._quotients(point)
            x = r if to_point is None else two_sided_filter(to_point, r, hold=True)
            mass = self._mechanics.moving_mass * constant if self._mechanics.modes else 1.0
            columns = effect.compensation(
                Motion.of_reference(x, self.sample_time, mass), **nonlinear
            )
            assert columns is not None
            if to_command is not None:
                columns = np.column_stack(
                    [two_sided_filter(to_command, c, hold=True) for c in columns.T]
                )
            blocks.append(columns / constant)
        return np.hstack(blocks)

    def _quotients(self, point: Point) -> tuple[Zpk | None, Zpk | None]:
        """P_x/P and P_F/P; None where the point's motion is the output, its force the command's."""
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
        return Zpk(top.zeros, bottom.zeros, top.gain / bottom.gain, m.sample_time, -m.delay)


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

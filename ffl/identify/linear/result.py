"""A fitted linear model: the system, how sure it is, and what the data say against it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ffl.effects import is_speed, mechanics_of
from ffl.errors import InputError
from ffl.identify.linear.coordinates import Point, Structure
from ffl.identify.linear.noise import ResidualTest, Uncertainty
from ffl.identify.linear.problem import Problem
from ffl.identify.linear.roots import RootEstimate, offset_std, response_std
from ffl.identify.linear.search import Method, predictor_of
from ffl.identify.linear.signals import Scale, as_signals
from ffl.systems import Controller, EffectSpec, Physics, Plant, StateSpace, Zpk, series
from ffl.systems.state_space import Array, ComplexArray

FAR = 1e-6  # p-value below which a test of the residual is worth a sentence
SIGNIFICANT = 3.0  # standard errors beyond which a load is more than noise
EXACT = 1e-9  # NRMSE below which the residual is rounding


@dataclass(frozen=True)
class Rung:
    """One rung of the order ladder.

    `held_out` is the NRMSE on blocks left out of the fit (each block's own start estimated and paid
    for), `estimation` that on all data; `excess` and `std_error` the mean excess of the held-out
    squared error over the best rung, paired over blocks, and its standard error (both relative to
    the output's variance).
    """

    structure: Structure
    held_out: float
    estimation: float
    excess: float
    std_error: float
    status: str


@dataclass(frozen=True)
class Overlay:
    """What the model makes of a recording: `output` beside `measured`, both (N,), from `x0`."""

    time: Array
    measured: Array
    output: Array
    x0: Array
    rmse: float
    nrmse: float


@dataclass(frozen=True)
class LinearModel:
    """y = P(q) q^-delay (u + d) with its noise, uncertainty and tests; see `fit_linear`.

    `system`: as it goes into a plant file (zeros, poles, gain and delay). `state_space`: the same
    without delay, in the units of the data. `offset`: constant at `structure.offset` (u or y unit).
    `noise_std`: of the residual. `innovation_gain` (n,): K of x+ = A x + B u + K e, zero for
    simulation methods. `poles`, `zeros`: with standard errors. `whiteness`, `independence`: residual
    tests. `ladder`: the orders tried, where `best_linear` chose. `status`: how the search ended.
    """

    state_space: StateSpace
    structure: Structure
    method: Method
    offset: float
    noise_std: float
    innovation_gain: Array
    poles: tuple[RootEstimate, ...]
    zeros: tuple[RootEstimate, ...]
    nrmse: float
    whiteness: ResidualTest
    independence: ResidualTest
    status: str
    iterations: int
    ladder: tuple[Rung, ...]
    sources: tuple[str, ...]
    settings: Mapping[str, Any]
    version: str
    point: Point = field(repr=False)
    scale: Scale = field(repr=False)
    uncertainty: Uncertainty = field(repr=False)
    controller: Controller | None = field(repr=False)

    @property
    def sample_time(self) -> float:
        return self.state_space.sample_time

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the residual says against the model, in sentences; empty where it is white or nothing."""
        if self.nrmse < EXACT or self.whiteness.p_value > FAR:
            return ()
        said = f"the residual is far from white (p = {self.whiteness.p_value:.1g}) "
        if self.independence.p_value > FAR:
            return (f"{said}but does not answer to the input: the noise is coloured",)
        return (
            f"{said}and answers to the input (p = {self.independence.p_value:.1g}): the model misses "
            "something; try more orders, or ask `ffl diagnose` what it is",
        )

    @cached_property
    def system(self) -> Zpk | StateSpace:
        """Zeros, poles, gain and delay; the state space where zpk would not reproduce it to 1e-8."""
        zeros = np.array([z.value for z in self.zeros], complex)
        poles = np.array([p.value for p in self.poles], complex)
        points = (
            1.2 * max(1.0, np.abs(poles).max(initial=0.0)) * np.exp(1j * np.linspace(0.0, np.pi, 9))
        )
        truth = self.state_space.at(points)
        try:
            unit = Zpk(zeros, poles, 1.0, self.sample_time)
            gain = float(np.median((truth / unit.at(points)).real))
            candidate = Zpk(zeros, poles, gain, self.sample_time, self.structure.delay)
            found = candidate.at(points) * points**self.structure.delay
            if np.abs(found - truth).max() <= 1e-8 * np.abs(truth).max():
                return candidate
        except InputError:
            pass
        if not self.structure.delay:
            return self.state_space
        line = Zpk([], [], 1.0, self.sample_time, self.structure.delay)
        return series(line.state_space(), self.state_space)

    def response(self, frequencies_hz: ArrayLike) -> ComplexArray:
        """P(exp(i 2 pi f T)), delay included."""
        return self.system.response(frequencies_hz)

    def plot(self, ax: Any, z: float = 1.959964) -> Any:
        """Draws poles (crosses) and zeros (circles) with `z` standard errors on matplotlib axes `ax`."""
        angle = np.linspace(0.0, 2.0 * np.pi, 361)
        ax.plot(np.cos(angle), np.sin(angle), color="black", linewidth=0.6)
        marks = ((self.poles, "x", "C0", "poles"), (self.zeros, "o", "C1", "zeros"))
        for roots, marker, colour, name in marks:
            if roots:
                ax.errorbar(
                    [r.value.real for r in roots],
                    [r.value.imag for r in roots],
                    xerr=[z * r.std_real for r in roots],
                    yerr=[z * r.std_imag for r in roots],
                    fmt=marker,
                    markerfacecolor="none",
                    color=colour,
                    capsize=2.0,
                    label=f"{name}, {z:.3g} standard errors",
                )
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_xlabel("real part [1]")
        ax.set_ylabel("imaginary part [1]")
        ax.legend()
        return ax

    def response_std(self, frequencies_hz: ArrayLike) -> Array:
        """sqrt(E |P^ - P|^2) at the frequencies in Hz, by the delta method."""
        unit = self.scale.y / self.scale.u
        return unit * response_std(
            self.point,
            self.uncertainty.directions,
            self.uncertainty.covariance,
            frequencies_hz,
            self.sample_time,
        )

    @property
    def load(self) -> float | None:
        """The offset as a constant force at the input; None where the plant has no static gain."""
        if self.structure.offset != "output":
            return self.offset
        if self.structure.integrators:
            return None
        static = float(self.state_space.at(1.0)[0].real)
        return self.offset / static if static else None

    @cached_property
    def offset_std(self) -> float:
        """Standard error of `offset`, 0 where there is none."""
        return self._offset_std[0]

    @cached_property
    def _offset_std(self) -> tuple[float, float | None]:
        """Of offset and load. What the start's prior alone decides has no noise in the sandwich form: a
        loop whose controller integrates hides an offset of y, and only `as_white` says so."""
        of = self.point, self.structure, self.scale, self.uncertainty.directions
        coloured, white = (
            offset_std(*of, covariance)
            for covariance in (self.uncertainty.covariance, self.uncertainty.as_white)
        )
        return coloured if coloured[0] > white[0] else white

    def constant_load(self, is_speed: bool = False) -> tuple[float, float] | None:
        """Force of the effect `constant_load` that stands for the offset, and its standard error, in the
        input's unit; None where the offset lies within `SIGNIFICANT` standard errors of nothing."""
        load, load_std = self.load, self._offset_std[1]
        if not load or load_std is None or abs(self.offset) <= SIGNIFICANT * self.offset_std:
            return None
        mechanics = mechanics_of(self.system, is_speed)
        per_force = mechanics.as_command(mechanics.point())
        return load / per_force, load_std / abs(per_force)

    def overlay(self, recording: Any, start_samples: int | None = None) -> Overlay:
        """The recording as the model reproduces it: free run for `output_error` (from u) and
        `closed_loop` (from r and f), one-step prediction for `prediction_error`.

        The initial state is estimated from the first `start_samples` samples (all, where None), with
        what the inputs can reach as its prior: states that few samples do not show stay small.
        """
        (piece,) = as_signals(recording, self.controller)
        scaled = self.scale.apply(piece)
        predictor = predictor_of(self.method, self.structure, self.controller, self.scale)
        stop = len(piece) if start_samples is None else start_samples + self.structure.delay
        problem = Problem(predictor, self.structure, (scaled,))
        noise = max(self.nrmse, 1e-6)
        x0 = problem.residual(self.point, scaled.cut(0, stop), noise).x0
        output = problem.output(self.point, scaled, x0) * self.scale.y + self.scale.y_mean
        lost = len(piece) - output.size
        measured = piece.y[lost:]
        rmse = float(np.sqrt(np.mean((measured - output) ** 2)))
        spread = float(np.std(measured))
        return Overlay(
            (lost + np.arange(output.size)) * self.sample_time,
            measured,
            output,
            x0,
            rmse,
            rmse / spread if spread else np.inf,
        )

    def plant(
        self,
        name: str,
        input_unit: str = "",
        output_unit: str = "",
        source: str = "",
        physics: Physics | None = None,
        with_load: bool = False,
    ) -> Plant:
        """A `Plant` to be written by `save_plant`.

        `with_load` states the fitted offset as the effect `constant_load`, where it is significant.
        """
        said = source or (
            f"ffl identify linear, {self.method}, order {self.structure.order}, from "
            + ", ".join(self.sources)
        )
        effects: tuple[EffectSpec, ...] = ()
        if with_load and (found := self.constant_load(is_speed(output_unit))) is not None:
            effects = (EffectSpec("constant_load", {"force": found[0]}),)
        return Plant(
            name=name,
            system=self.system,
            controller=self.controller,
            input_unit=input_unit,
            output_unit=output_unit,
            source=said,
            physics=physics or Physics(),
            effects=effects,
        )

    def summary(self) -> dict[str, Any]:
        """Plain numbers and strings for JSON and tables."""

        def listed(roots: tuple[RootEstimate, ...]) -> list[dict[str, float]]:
            return [
                {
                    "real": r.value.real,
                    "imag": r.value.imag,
                    "std_real": r.std_real,
                    "std_imag": r.std_imag,
                    "frequency_hz": r.frequency_hz,
                    "damping": r.damping,
                    "std_frequency_hz": r.std_frequency_hz,
                    "std_damping": r.std_damping,
                }
                for r in roots
                if np.isfinite(r.frequency_hz)
            ]

        return {
            "method": self.method,
            "order": self.structure.order,
            "integrators": self.structure.integrators,
            "delay": self.structure.delay,
            "feedthrough": self.structure.feedthrough,
            "nrmse": self.nrmse,
            "noise_std": self.noise_std,
            "offset": self.offset,
            "offset_std_error": self.offset_std,
            "status": self.status,
            "poles": listed(self.poles),
            "zeros": listed(self.zeros),
            "whiteness_p": self.whiteness.p_value,
            "independence_p": self.independence.p_value,
            "ladder": [
                {
                    "order": r.structure.order,
                    "integrators": r.structure.integrators,
                    "delay": r.structure.delay,
                    "feedthrough": r.structure.feedthrough,
                    "held_out": r.held_out,
                    "estimation": r.estimation,
                }
                for r in self.ladder
            ],
        }

"""The simulated machine: runs a trial and hands back a recording, as a real machine does."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ffl.errors import InputError, WorkError
from ffl.machines.simulator import Simulation, Simulator
from ffl.recordings import Recording
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

REST_VELOCITY = 1e-2  # of the largest step of the reference: a first step above it is no rest


class SimulatedMachine:
    """The closed loop of `plant` as it would be built: effects, encoder, noise, command limit.

    u = C_r r - C_y y + f clipped at `command_limit` is what is recorded as sent. Force noise acts
    beside it on the plant; the sensor's value, its noise and the encoder's rounding are in the y
    that is recorded and fed back. Raises `InputError` for an unstable loop and for effects that the
    plant cannot have.
    """

    def __init__(self, plant: Plant) -> None:
        plant.require_stable()
        self.plant = plant
        self.simulator = Simulator(plant)
        self.simulator.run(
            plant.effects, np.zeros(1)
        )  # refuses unfit effects before the first trial

    def run(
        self,
        reference: ArrayLike,
        feedforward: ArrayLike | None,
        rng: Generator,
        load: ArrayLike | None = None,
        start: ArrayLike | None = None,
    ) -> Recording:
        """One trial over the samples of `reference`; `feedforward` None is zero.

        Noise comes from `rng` alone (give every run its own child generator): trials differ, and the
        result depends neither on the order of runs nor on which of the noises are switched on.
        `load` is a known force beside u in input units, recorded as d. `start` is a state as in
        `Simulator`; without it the machine starts at rest at 0 and the reference must too.
        """
        r = _signal(reference, "reference", None)
        f = np.zeros_like(r) if feedforward is None else _signal(feedforward, "feedforward", len(r))
        d = None if load is None else _signal(load, "load", len(r))
        machine = self.plant.machine
        if start is None:
            self._require_rest(r, machine.encoder_resolution)
        force_noise, sensor_noise = rng.standard_normal((2, len(r)))
        force = machine.force_noise * force_noise
        simulation = self.simulator.run(
            self.plant.effects,
            r,
            f,
            force=force if d is None else force + d,
            noise=machine.sensor_noise * sensor_noise,
            start=start,
            command_limit=machine.command_limit,
            encoder_resolution=machine.encoder_resolution,
        )
        self._require_finite(simulation)
        units = {"r": self.plant.output_unit, "y": self.plant.output_unit}
        units |= {name: self.plant.input_unit for name in ("f", "u", "d")}
        return Recording(
            self.plant.sample_time * np.arange(len(r)),
            r,
            f,
            simulation.u,
            simulation.y,
            d,
            sample_time=self.plant.sample_time,
            units=units,
            source=f"simulated {self.plant.name}",
        )

    def _require_rest(self, r: Array, resolution: float) -> None:
        scale = float(np.abs(r).max(initial=0.0))
        if len(r) and abs(r[0]) > max(resolution, 1e-12 * scale):
            raise InputError(
                f"the reference starts at {r[0]:g} {self.plant.output_unit}, not at 0 where machine "
                f"{self.plant.name} rests; subtract its first value, or give a start state"
            )
        steps = np.abs(np.diff(r))
        if len(steps) and steps[0] > max(resolution, REST_VELOCITY * steps.max()):
            raise InputError(
                f"the reference starts with velocity {steps[0] / self.plant.sample_time:g} "
                f"{self.plant.output_unit}/s; begin it with a sample of rest and a smooth start"
            )

    def _require_finite(self, simulation: Simulation) -> None:
        if simulation.diverged:
            first = int(np.argmax(np.isnan(simulation.y)))
            raise WorkError(
                f"machine {self.plant.name} diverged at t = {first * self.plant.sample_time:g} s: with "
                "its effects the loop is unstable; lower the controller's gain or the effects"
            )


def _signal(values: ArrayLike, name: str, length: int | None) -> Array:
    signal = np.asarray(values, float)
    if signal.ndim != 1 or (length is not None and len(signal) != length):
        raise InputError(
            f"{name} has shape {signal.shape}; give one value per sample"
            + (f", {length} like the reference" if length is not None else "")
        )
    if not np.all(np.isfinite(signal)):
        raise InputError(f"{name} holds NaN or infinity; give finite numbers")
    return signal

"""What noise leaves on the machine itself, effects included: the same runs again with noise drawn.

A linear loop passes noise on as its transfer functions say. A machine that sticks and slips does not:
force noise of 0.1 % decides when it breaks away, and what that leaves in y is louder than the loop
alone would make it, and comes in bursts. Neither is missing physics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.signal
from numpy.random import Generator

from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.commands import limit_of
from ffl.diagnose.recorded.trials import Trial, start_of
from ffl.errors import InputError
from ffl.machines.simulator import Simulation, Simulator
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

DRAWS = 4
LEAD = 500  # samples at rest before a recording that begins there: noise has been at work for long
TRUST = 1.5  # times the stated noise: what an engineer's figure may be short of


@dataclass(frozen=True)
class Imitation:
    """One draw: what noise adds to y (output units) and u (input units), recording by recording."""

    y: list[Array]
    u: list[Array]


def imitated(
    plant: Plant, trials: Sequence[Trial], noise: Noise, rng: Generator, draws: int = DRAWS
) -> list[Imitation]:
    """Runs of the plant, effects included, with noise less the run without.

    Force noise stands beside the command, sensor noise is added to the measured y; both white and
    first-order parts as `noise` has them, at most half as loud again as the plant file states: what
    was read from residuals holds the machine's answer to noise already. Empty where the plant runs
    away.
    """
    simulator, step = Simulator(plant), plant.sample_time
    noise = believable(noise, plant)

    def run(trial: Trial, force: Array | float = 0.0, sensor: Array | None = None) -> Simulation:
        load = 0.0 if trial.load is None else trial.load
        return simulator.run(
            program,
            trial.reference,
            trial.feedforward,
            force=np.zeros(len(trial)) + load + force,
            noise=sensor,
            start=start_of(simulator, plant.effects, trial),
            start_time=trial.start_time,
            command_limit=None if trial.asked is None else limit_of(plant),
            **trial.before_it,
        )

    out = []
    leads = [min(LEAD, len(t)) if t.at_rest else 0 for t in trials]
    trials = [t.held_before(lead) for t, lead in zip(trials, leads, strict=True)]
    try:
        program = simulator.prepare(plant.effects)
        still = [run(t) for t in trials]
        for _ in range(draws):
            one = Imitation([], [])
            for trial, calm, lead in zip(trials, still, leads, strict=True):
                n = len(trial)
                force = drawn(noise.force, noise.force_coloured, noise.force_corner, step, n, rng)
                sensor = drawn(
                    noise.sensor, noise.sensor_coloured, noise.sensor_corner, step, n, rng
                )
                loud = run(trial, force, sensor)
                one.y.append((loud.y - calm.y)[lead:])
                one.u.append((loud.u - calm.u)[lead:])
            out.append(one)
    except InputError:
        return []
    return out if all(np.all(np.isfinite(e)) for one in out for e in one.y) else []


def believable(noise: Noise, plant: Plant) -> Noise:
    """`noise` with sensor and force parts at most TRUST times what the plant file states, if it does."""
    m = plant.machine
    sensor = force = 1.0
    if m.sensor_noise:
        stated = TRUST * float(np.hypot(m.sensor_noise, m.encoder_resolution / np.sqrt(12.0)))
        sensor = stated / max(float(np.hypot(noise.sensor, noise.sensor_coloured)), stated)
    if m.force_noise:
        stated = TRUST * m.force_noise
        force = stated / max(float(np.hypot(noise.force, noise.force_coloured)), stated)
    return replace(
        noise,
        sensor=sensor * noise.sensor,
        sensor_coloured=sensor * noise.sensor_coloured,
        force=force * noise.force,
        force_coloured=force * noise.force_coloured,
    )


def drawn(
    white: float, coloured: float, corner: float, step: float, n: int, rng: Generator
) -> Array:
    """White noise and a stationary first-order process with its corner at `corner` Hz, (n,)."""
    total = white * rng.standard_normal(n)
    if not coloured:
        return total
    a = np.exp(-2 * np.pi * corner * step)
    drive = np.sqrt(1 - a * a) * rng.standard_normal(n)
    begin = np.array([a * rng.standard_normal()])
    return total + coloured * scipy.signal.lfilter([1.0], [1.0, -a], drive, zi=begin)[0]

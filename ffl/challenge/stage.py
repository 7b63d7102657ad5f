"""A machine with its effects on the stage: assembled, and run through an experiment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffl.challenge import kernel
from ffl.challenge.build import Build, Draws, Scales
from ffl.challenge.draw import Experiment, Setup
from ffl.challenge.linear import Noise
from ffl.challenge.outside import OUTSIDE
from ffl.challenge.physics import EFFECTS


@dataclass(frozen=True)
class Part:
    """One effect of a case: its name, where it acts, its own seed and the factor on its size."""

    name: str
    at: str
    seed: int
    size: float

    def generator(self) -> Draws:
        """Of the numbers the effect is drawn by."""
        return np.random.default_rng(self.seed)

    def apply(self, build: Build, scales: Scales) -> dict:
        return self.make(build, self.generator(), scales)

    def make(self, build: Build, rng: Draws, scales: Scales) -> dict:
        make = EFFECTS[self.name].make if self.name in EFFECTS else OUTSIDE[self.name].make
        return make(build, rng, scales, self.at, self.size)


def assemble(setup: Setup, parts: list[Part], scales: Scales) -> tuple[Build, list[dict]]:
    """The true machine with its effects, and their parameters.

    Effects that change matrices come before those that read them.
    """
    build = Build.of(setup.true)
    order = sorted(range(len(parts)), key=lambda k: parts[k].name != "backlash")
    parameters: list[dict] = [{} for _ in parts]
    for k in order:
        parameters[k] = parts[k].apply(build, scales)
    return build, parameters


def run(
    build: Build,
    setup: Setup,
    e: Experiment,
    noise: Noise | None,
    rng: np.random.Generator | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """y and u of one recording; noise-free without `noise`."""
    y, u = whole_run(build, setup, e, noise, rng)
    return y[e.skip :], u[e.skip :]


def whole_run(
    build: Build,
    setup: Setup,
    e: Experiment,
    noise: Noise | None,
    rng: np.random.Generator | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """`run` from where the machine starts, the samples before the recording included."""
    n = len(e.reference)
    sensor = force = external = lost = None
    if noise is not None:
        assert rng is not None  # what noise is drawn from
        sensor, force = noise.draw(n, setup.sample_time, rng)
        build.sensor[kernel.RESOLUTION] = noise.resolution
        if build.knocks:
            external = np.zeros(n)
            for rate, size, width in build.knocks:
                for at in np.flatnonzero(rng.random(n) < rate * setup.sample_time):
                    k = np.arange(min(round(width / setup.sample_time), n - int(at)))
                    pulse = np.sin(np.pi * k * setup.sample_time / width)
                    external[at + k] += size * rng.choice([-1, 1]) * pulse
        if build.loss > 0:
            lost = (rng.random(n) < build.loss).astype(float)
    y, u, *_ = build.run(
        setup.servo,
        e.reference,
        e.feedforward,
        setup.sample_time,
        setup.steps,
        sensor,
        force,
        external,
        lost,
        e.start,
    )
    build.sensor[kernel.RESOLUTION] = 0.0
    return y, u

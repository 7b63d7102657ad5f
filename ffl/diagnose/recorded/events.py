"""What comes and goes by itself: stretches of a residual much louder than the rest of it.

A knock, a cable that catches, a bus that stalls: no map of the motion repeats them, and over whole
segments they pass for loud noise. Here the noise is what the quieter short windows show; under it
the power of a window of pure noise stays near that of half of its recording's, and that of a window with
an event does not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.stats

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.noise.imitate import believable
from ffl.diagnose.noise.noise import Noise, fit_noise
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

SHORT = 128  # samples of a segment from which the quiet noise is read
QUIETER = 0.4  # quantile over the segments
WINDOW = 64  # samples whose mean power is judged
LOUD = 2.5  # times the median that the loudest 2 % of the windows must reach (nulls: at most 1.6)
PLAINLY = 10.0  # the same where the noise is held to what is stated (nulls: at most 3)
SHARE = 0.02
FEW = 8  # windows that tell neither growth nor a beginning


@dataclass(frozen=True)
class Events:
    """`ratio`: power of the loudest 2 % of all windows over the median one; `excess`: sum of squares
    beyond noise; `stretches`: (start, end) in s of the events of the first recording that has some;
    `limit`: the ratio that noise alone does not reach."""

    ratio: float
    excess: float
    stretches: tuple[tuple[float, float], ...]
    limit: float = LOUD

    @property
    def found(self) -> bool:
        return self.ratio > self.limit


def events(scene: Scene, residuals: list[Array], plant: Plant | None = None) -> Events:
    """Events in the residuals of a scene's recordings. With `plant` no louder noise is believed in
    than it states: where the loop is slow, what a knock leaves lasts until the next one and passes
    for force noise in the quieter windows too. Then they must be plain to see."""
    noise = quiet_noise(scene, residuals)
    if plant is not None:
        noise = believable(noise, plant)
    whiteners = replace(scene, noise=noise).whiteners
    powers, spans = [], []
    for trial, whitener, e in zip(scene.trials, whiteners, residuals, strict=True):
        n = len(e) // WINDOW
        power = (whitener(e)[: n * WINDOW].reshape(n, WINDOW) ** 2).mean(axis=1)
        power = power / _growth(power)
        if n >= FEW:  # the first tells where the recording began, which is estimated
            power[0] = min(power[0], float(np.median(power)))
            power = power / max(float(np.median(power)), 1e-300)  # one may be noisier than another
        powers.append(power)
        spans.append(trial.start_time + trial.sample_time * WINDOW * np.arange(n + 1))
    together = np.concatenate(powers)
    middle = float(np.median(together))
    ratio = float(np.quantile(together, 1 - SHARE)) / middle
    excess = float(np.sum(np.maximum(together / middle - 1.0, 0.0))) * WINDOW
    limit = LOUD if plant is None else PLAINLY
    return Events(ratio, excess, _stretches(powers, spans, LOUD * middle), limit)


def quiet_noise(scene: Scene, residuals: list[Array]) -> Noise:
    """The noise of the quieter short stretches."""
    return fit_noise(
        scene.loop, residuals, scene.noise, floor=scene.floor, coloured=False, quantile=QUIETER,
        segment=SHORT,
    )  # fmt: skip


def _growth(power: Array) -> Array:
    """The level of noise that grows or dies away over a recording, over its median: a straight line through
    the logarithms of the windows, half of which events leave alone."""
    if len(power) < FEW or not np.all(power > 0.0):
        return np.ones(len(power))
    rate = float(scipy.stats.theilslopes(np.log(power)).slope)
    return np.exp(rate * (np.arange(len(power)) - 0.5 * (len(power) - 1)))


def _stretches(powers: list[Array], spans: list[Array], level: float):  # type: ignore[no-untyped-def]
    for power, span in zip(powers, spans, strict=True):
        hot = np.concatenate([[0], (power > level).astype(int), [0]])
        edges = np.flatnonzero(np.diff(hot))
        if len(edges):
            pairs = zip(edges[::2], edges[1::2], strict=True)
            return tuple((round(float(span[a]), 4), round(float(span[b]), 4)) for a, b in pairs)
    return ()

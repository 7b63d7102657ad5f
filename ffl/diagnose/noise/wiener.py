"""The least signal that explains a residual: Wiener's two-sided filter.

conj(G) e/(|G|^2 + noise/expected), frequency by frequency: band-limited to where the data carry it, and
as good on a plant whose zeros lie outside the circle.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.noise.noise import Paths
from ffl.systems.loop import Loop
from ffl.systems.state_space import Array, ComplexArray

SLOW = 5.0  # Hz: corner of the unexplained signal that is expected


class Wiener:
    """From a residual of `samples` samples to the signal behind `path`, a frequency response."""

    def __init__(
        self, scene: Scene, samples: int, path: Callable[[Array], ComplexArray] | None = None
    ) -> None:
        self.samples, self.step = samples, scene.loop.system.sample_time
        lowest = 1e-3 / self.step / (2 * samples)
        self.frequencies = np.maximum(np.fft.rfftfreq(2 * samples, self.step), lowest)
        self.path = path(self.frequencies) if path else of_force(scene.loop, self.frequencies)
        self.noise = scene.noise.density(Paths.of(scene.loop, self.frequencies))

    def __call__(self, e: Array, size: float, slow: float | None = SLOW) -> Array:
        """The signal, (N,), behind the residual `e`, of which a mean square `size` is expected, below
        `slow` Hz or at all frequencies."""
        expected = max(size, 1e-300)
        if slow is not None:
            expected = (
                expected * 2 * np.pi * slow * self.step / (1 + (self.frequencies / slow) ** 2)
            )
        spectrum = np.conj(self.path) * np.fft.rfft(e, 2 * self.samples)
        spectrum = spectrum / (np.abs(self.path) ** 2 + self.noise / expected)
        return np.fft.irfft(spectrum, 2 * self.samples)[: self.samples]


def of_force(loop: Loop, frequencies: Array) -> ComplexArray:
    """From a force beside the command (input units) to y."""
    return loop.system.response(frequencies)[:, 0, 2]

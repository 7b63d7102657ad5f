"""Pushes that come at times of their own, each too faint to make its stretch of a residual loud.

In the power of a stretch a push of a few samples to a few hundred hides, in its shape it does not. The
residual, whitened by the noise of the quieter stretches, is held against what a push does to it,
h = W S_p pulse, S_p the process sensitivity:

    z(k) = sum_i h(i) w(k + i)

over z's own median deviation in the recording, of which noise of any colour reaches about five.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import fftconvolve, find_peaks

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.noise.whitening import Whitener
from ffl.diagnose.recorded.events import Events, quiet_noise
from ffl.systems.state_space import Array

LASTING = (4, 8, 16, 32, 64, 128)  # samples that a push is tried to last
FAR = 5.5  # median deviations that the third of them must reach (nulls: below 4.5)
APART = 32  # samples between one push and the next, at least
THIRD = 3
MEMORY = 4096  # samples of what a push does, at most
PART = 8  # of a recording: a push that lasts longer is none
NORMAL = 1.4826  # standard deviations to a median one


def knocks(scene: Scene, residuals: list[Array]) -> Events:
    """Pushes in the `residuals` of a scene's recordings: `ratio` is how far the third of those stands out
    that last as long as the clearest, in median deviations."""
    quiet = replace(scene, noise=quiet_noise(scene, residuals))
    white = [w(e) for w, e in zip(quiet.whiteners, residuals, strict=True)]
    clearest = Events(0.0, 0.0, (), FAR)
    for samples in LASTING:
        heights = [np.zeros(THIRD)]
        stretches: tuple[tuple[float, float], ...] = ()
        for trial, whitener, w in zip(quiet.trials, quiet.whiteners, white, strict=True):
            if len(w) < PART * samples:
                continue
            trace = trace_of_push(quiet, whitener, samples, min(MEMORY, len(w)))
            z = _deviations(trace, w, samples)
            at, found = find_peaks(np.abs(z), height=0.0, distance=max(2 * samples, APART))
            heights.append(found["peak_heights"])
            begun = trial.start_time + trial.sample_time * (
                samples + at[found["peak_heights"] > FAR]
            )
            stretches = stretches or tuple(
                (round(float(t), 4), round(float(t + samples * trial.sample_time), 4))
                for t in begun
            )
        sizes = np.sort(np.concatenate(heights))[::-1]
        if sizes[THIRD - 1] > clearest.ratio:
            excess = float(np.sum(sizes[sizes > FAR] ** 2))
            clearest = Events(float(sizes[THIRD - 1]), excess, stretches, FAR)
    return clearest


def trace_of_push(scene: Scene, whitener: Whitener, samples: int, n: int) -> Array:
    """What a push by the unit force that lasts `samples` does to the whitened residual, (n,)."""
    push = np.zeros(n)
    push[:samples] = 1.0
    return whitener.steady(np.atleast_1d(scene.loop.process_sensitivity.filter(push)))


def _deviations(trace: Array, white: Array, samples: int) -> Array:
    """z from `samples` on, where the start of a recording is no longer in doubt, to what lasts as long at
    the end."""
    z = fftconvolve(np.append(white, np.zeros(len(trace) - 1)), trace[::-1], "valid")[
        samples:-samples
    ]
    z = z - np.median(z)
    return z / max(NORMAL * float(np.median(np.abs(z))), 1e-300)

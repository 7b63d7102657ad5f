"""Where no noise of the loop describes what is left, it is taken as white at the output.

Structure that a slow process integrates passes for force noise, and a fit that whitens by it follows
every short wiggle while the free run drifts off (two tanks: noise "found" with 8 times the power of
all that was left). Fits then minimise the error of the free run itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.judging import effective, raw_residuals
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.noise import Paths

LOUD = 4.0  # times what is left: more noise than that is none


def weighed(scene: Scene, model: Model) -> Scene:
    """The scene with samples worth less, as what `model` leaves is coloured; what the right model
    leaves is less so: half-way, in logarithms."""
    white = scene.whiten(raw_residuals(scene, model))
    return replace(scene, worth=float(np.sqrt(effective(white) / len(white))))


def too_loud(scene: Scene, model: Model) -> bool:
    """The noise that the residuals' short-time spectrum asks for would leave far more than is left:
    structure that a slow process integrates passes for force noise. False where the noise is stated:
    what is louder than that is structure, not noise, and the contest's own noise is held to it (a
    mode of 45 Hz that a stage of 19 Hz and 4 % damping lacks asked for 10 times what was left, most of
    it at the resonance, and was then looked for in white noise: in vain)."""
    if scene.loudest is not None:
        return False
    residuals = raw_residuals(scene, model)
    noise = scene.with_noise_of(residuals).noise
    n = 4096
    frequencies = (np.arange(n) + 0.5) / n * 0.5 / scene.loop.system.sample_time
    asked = float(np.mean(noise.density(Paths.of(scene.loop, frequencies))))
    return asked > LOUD * float(np.mean(np.concatenate(residuals) ** 2))

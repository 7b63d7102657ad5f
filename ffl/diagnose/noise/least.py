"""The least noise that residuals show: maps are fitted under it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffl.diagnose.contest.judging import QUIET
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.imitate import TRUST
from ffl.diagnose.noise.noise import Noise, fit_noise
from ffl.diagnose.recorded.events import SHORT
from ffl.systems.state_space import Array


def least_noise(scene: Scene, model: Model, residuals: Sequence[Array]) -> Noise:
    """The quietest of three opinions, part by part: an envelope over long segments, one over short
    ones (an effect that is everywhere hides from the first, a slow one from the second), and the
    plant file's own, where it states one."""
    machine = model.base.plant.machine
    opinions = [
        fit_noise(
            scene.loop, residuals, scene.noise, floor=scene.floor, coloured=False,
            quantile=QUIET, segment=segment,
        )
        for segment in (None, SHORT)
    ]  # fmt: skip
    sensor, force = min(o.sensor for o in opinions), min(o.force for o in opinions)
    if machine.states_noise:
        stated = float(np.hypot(machine.sensor_noise, scene.floor))
        sensor, force = min(sensor, TRUST * stated), min(force, TRUST * machine.force_noise)
    return Noise(sensor, force)

"""The noise beside what stands, under which its rivals are judged."""

from __future__ import annotations

from ffl.diagnose.contest.judging import QUIET, Judged, raw_residuals
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.noise.unrest import unrest_of, with_unrest
from ffl.diagnose.recorded.starts import with_starts

QUIETER = 2.0  # times: noise that is so much less beside who took a place is heard anew


def in_its_noise(scene: Scene, held: Scene | None, standing: Judged) -> tuple[Scene, Scene | None]:
    """The fitted and the held-out recordings under the noise that `standing` leaves: white and no louder
    than what is left, for slow physics must not pass for slow noise."""
    left = raw_residuals(scene, standing.model)
    quiet = with_starts(scene.with_noise_of(left, coloured=False, quantile=QUIET), standing.model)
    quiet = with_unrest(quiet, standing.model)
    if held is not None:
        held = unrest_of(with_starts(held.like(quiet), standing.model), standing.model)
    return quiet, held


def quieter(quiet: Scene, base: Judged) -> bool:
    """Whether the noise that `base` leaves is much less than that under which it was judged. (A drag and
    a hysteresis had left 17 times a motor's noise; under that dry friction, which took the hysteresis's
    place, was told in the wrong form and off by 7 standard errors.) Not of a process: nothing shakes it,
    and what is left is other stages' physics. (Of the cascaded tanks overflow, bend and outflow were lost
    to it, 0.116 for 0.083 of held-out error.)"""
    if base.model.base.is_process:
        return False
    anew = in_its_noise(quiet, None, base)[0].noise
    return max(quiet.noise.sensor / anew.sensor, quiet.noise.force / anew.force) > QUIETER

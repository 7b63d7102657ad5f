"""Who stays though held-out recordings are against it: they show a mode elsewhere."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.contest.believed import stays_in_a_believed_model
from ffl.diagnose.contest.earning import stays
from ffl.diagnose.contest.judging import judge, levelled
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.systems import EffectSpec, multisine

OFF = {"mode_1_frequency": 0.012, "mode_1_damping": 0.2}  # what the form of a friction made of them


@pytest.fixture(scope="module")
def seen(two_masses, references):
    """(scene of moves, of a multisine, drag) of a machine with a drag."""
    drag = EffectSpec("quadratic_drag", {"coefficient": 60.0}, {"side": "motor"})
    rng, base = np.random.default_rng(3), Base.of(two_masses)
    device = SimulatedMachine(replace(two_masses, effects=(drag,)))
    shaken = multisine((1.0, 90.0), 2e-3, 4.0, two_masses.sample_time, rng, 0.1)
    trials = [
        prepare(base.simulator, device.run(r, np.zeros_like(r), rng), 1e-6)
        for r in (references[0], shaken)
    ]
    noise = Noise(1e-6, 0.01)
    scene, held = (Scene(two_masses.loop, (trial,), noise) for trial in trials)
    return scene, held, Model(base), drag


@pytest.mark.parametrize(("times", "kept"), [(1.0, True), (-1.0, False)])
def test_an_effect_stays_that_a_mode_hid_from_who_judges(seen, times, kept):
    """A drag in its place, and one that pushes, said to fit the recordings as well."""
    scene, held, model = seen[:3]
    size = {"coefficient": times * seen[3].parameters["coefficient"]}
    model = replace(model, corrections=OFF)
    without = judge(scene, held, Model(model.base), 0)
    effect = replace(seen[3], parameters=size)
    judged = judge(scene, held, model.with_effect(effect), 0)
    judged = replace(judged, fitted=without.fitted + 2000.0)
    judged, without = levelled([judged, without])
    assert judged.held_out < without.held_out
    assert not stays(judged, without, 20.0)
    assert stays_in_a_believed_model(scene, judged, without, 20.0) is kept
    assert not stays_in_a_believed_model(
        scene, replace(judged, fitted=without.fitted + 100.0), without, 20.0
    )

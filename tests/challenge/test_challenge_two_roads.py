"""Two machines that share no code, one answer: the challenge's and the product's simulation.

The catalogue's parameters in the truth must be those that `ffl.machines` understands; what is left
is the other form of the physics (beam with a second mode, offsets of an arctangent encoder).
"""

from dataclasses import replace

import numpy as np
import pytest

from ffl.challenge import write
from ffl.challenge.build import Build
from ffl.challenge.draw import draw_setup, measure
from ffl.challenge.linear import Noise
from ffl.challenge.physics import EFFECTS
from ffl.challenge.stage import Part, assemble, run
from ffl.machines.simulated import SimulatedMachine
from ffl.systems import load_plant
from ffl.systems.plant import EffectSpec

# Share of the effect's trace that may be left; measured values are at most half of it.
LEFT = {
    "presliding_friction": 0.01,
    "flexible_mode": 0.02,
    "encoder_ripple": 0.03,
    "backlash": 0.01,
}


@pytest.mark.parametrize("name", [n for n in EFFECTS if n != "sensor_nonlinearity"])
def test_truths_mean_the_same_to_both_machines(name, tmp_path):
    setup = replace(draw_setup("rigid", "exact", np.random.default_rng(2)), physics_known=True)
    scales = measure(setup)
    at = "output" if name == "backlash" else "motor"
    build, (parameters,) = assemble(setup, [Part(name, at, 2, 1.0)], scales)
    e = replace(setup.fit[0], start=0.0, skip=0)
    y, _ = run(build, setup, e, None)
    plain, _ = run(Build.of(setup.true), setup, e, None)
    path = tmp_path / "plant.toml"
    path.write_text(write.plant_text(setup, Noise(), None))
    plant = load_plant(path)
    options = {"kind": "maxwell_slip"} if name == "presliding_friction" else {}
    effect = EffectSpec(name, parameters, options)
    plant = replace(plant, effects=(effect,), machine=type(plant.machine)())
    other = SimulatedMachine(plant).run(e.reference, e.feedforward, np.random.default_rng(0)).y
    assert np.std(other - y) < LEFT.get(name, 0.004) * np.std(y - plain)

"""A mass that all but stops, where the level of its friction changes on the way."""

import numpy as np
import pytest

from ffl.machines import Simulator
from ffl.systems import Move, moves
from ffl.systems.plant import EffectSpec
from ffl.systems.plant_file import plant_from_dict

STEP = 0.001
STAGE = plant_from_dict(
    {
        "name": "stage",
        "sample_time": STEP,
        "source": "made here",
        "units": {"input": "A", "output": "m"},
        "plant": {"form": "zpk", "zeros": [-1.0], "poles": [1.0, 1.0], "gain": 1e-6},
        "controller": {"form": "zpk", "zeros": [0.969], "poles": [0.754], "gain": 12000.0},
        "physics": {"mass": 6.0, "motor_constant": 12.0},
    }
)
PATH = [
    Move(0.25 + 0.65 * k, 0.05 * s, 0.25 - 0.03 * k, 4.0, 200.0)
    for k, s in enumerate((1, -1, 1, -1))
]

GRID = np.linspace(-0.02, 0.1, 9)
WAVE = 3.0 + np.sin(2 * np.pi * GRID / 0.12)


def table(shift: float) -> EffectSpec:
    levels = {"positive": (WAVE - shift).tolist(), "negative": (WAVE + shift).tolist()}
    return EffectSpec("position_dependent_friction", {"table": {"grid": GRID.tolist(), **levels}})


@pytest.mark.parametrize("shift", [0.0, 0.5, 1.5])
@pytest.mark.parametrize("load", [-3.0, 0.0, 4.0])
def test_a_sample_is_as_good_as_sixty_four_steps(shift, load):
    """Pushed on by a hair more than its friction held, it was thrown back the other way: 8 um in a loop
    that follows to 0.1 nm."""
    closed, r = Simulator(STAGE), moves(PATH, 3.0, STEP)
    effects = (table(shift), EffectSpec("constant_load", {"force": load - shift}))
    coarse, fine = (closed.run(closed.prepare(effects, n), r).y for n in (1, 64))
    assert np.abs(coarse - fine).max() < 5e-9
    same = (table(0.0), EffectSpec("constant_load", {"force": load}))
    other = closed.run(closed.prepare(same, 64), r).y
    assert np.abs(fine - other).max() < 1e-11

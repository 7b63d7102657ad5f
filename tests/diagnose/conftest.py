"""A rigid stage under a lead controller, and recordings of it made by the project's simulator."""

from __future__ import annotations

from contextlib import contextmanager

import numpy as np
import pytest

from ffl.diagnose import diagnosis
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.systems import Controller, Move, Physics, Plant, Zpk, moves
from ffl.systems.plant import Imperfections
from ffl.systems.plant_file import plant_from_dict

STEP = 0.001
MASS, CONSTANT = 6.0, 12.0


@pytest.fixture(scope="session")
def stage() -> Plant:
    """6 kg, 12 N/A, a lead with 15 Hz bandwidth."""
    zero, pole = np.exp(-2 * np.pi * 5.0 * STEP), np.exp(-2 * np.pi * 45.0 * STEP)
    w = 2 * np.pi * 15.0
    gain = CONSTANT * STEP**2 / (2 * MASS)
    system = Zpk(np.array([-1.0]), np.array([1.0, 1.0]), gain, STEP)
    lead = Zpk(np.array([zero]), np.array([pole]), 1.0, STEP)
    size = abs(lead.response([15.0])[0] * CONSTANT / (MASS * w**2))
    controller = Zpk(np.array([zero]), np.array([pole]), 1.0 / size, STEP)
    return Plant(
        "stage", system, Controller.of_error(controller), "A", "m", "made for the tests",
        Physics(MASS, CONSTANT), Imperfections(1e-7, 1e-7, 2e-3, None),
    )  # fmt: skip


@pytest.fixture(scope="session")
def play_left_alone():  # type: ignore[no-untyped-def]
    """Within `with play_left_alone():` what a contest leaves is not looked at for a play, which takes
    longer than all the rest where more is left than the stated noise; tests in predict/ do look."""

    def untouched(scene, held, outcome, *_):  # type: ignore[no-untyped-def]
        return outcome

    @contextmanager
    def patched():  # type: ignore[no-untyped-def]
        with pytest.MonkeyPatch.context() as patch:
            for search in ("with_rattling", "with_loose_head"):
                patch.setattr(diagnosis, search, untouched)
            yield

    return patched


@pytest.fixture
def no_play_sought(play_left_alone):  # type: ignore[no-untyped-def]
    with play_left_alone():
        yield


@pytest.fixture(scope="session")
def references() -> tuple[np.ndarray, np.ndarray]:
    """A path of moves to learn from and another to judge by, 3 s each."""
    out = []
    for signs in ((1, -1, 1, -1), (1, 1, -1, -1)):
        steps = [
            Move(0.25 + 0.65 * k, 0.05 * s, 0.25 - 0.03 * k, 4.0, 200.0)
            for k, s in enumerate(signs)
        ]  # fmt: skip
        out.append(moves(steps, 3.0, STEP))
    return out[0], out[1]


@pytest.fixture(scope="session")
def record(references):  # type: ignore[no-untyped-def]
    """Recordings (fit, validation) of a machine."""

    def run(machine: Plant, seed: int = 0):  # type: ignore[no-untyped-def]
        rng = np.random.default_rng(seed)
        device = SimulatedMachine(machine)
        return tuple(device.run(r, np.zeros_like(r), rng) for r in references)

    return run


@pytest.fixture(scope="session")
def scenes(stage):  # type: ignore[no-untyped-def]
    """The scene of the first recording, that of the others, and the model without effects."""

    def of(runs, plant=stage):  # type: ignore[no-untyped-def]
        base, stated = Base.of(plant), plant.machine
        first, *others = (prepare(base.simulator, r, stated.sensor_noise) for r in runs)
        noise = Noise(stated.sensor_noise, stated.force_noise)
        return (
            Scene(plant.loop, (first,), noise),
            Scene(plant.loop, tuple(others), noise),
            Model(base),
        )

    return of


@pytest.fixture(scope="session")
def two_masses() -> Plant:
    """Two masses on a spring of 50 Hz, driven and measured at the one."""
    zeros = np.array([-0.9974, 0.9620 + 0.2508j, 0.9620 - 0.2508j])
    poles = np.array([0.99935, 1.0, 0.94026 + 0.31177j, 0.94026 - 0.31177j])
    servo = Zpk(np.array([0.98228, -1.0]), np.array([0.76352, 0.72278]), 1319.55, STEP)
    return Plant(
        "stage", Zpk(zeros, poles, 1.05038e-6, STEP), Controller.of_error(servo), "A", "m",
        "made for the tests", Physics(11.741, 15.74), Imperfections(0.0, 1e-6, 0.01, None),
    )  # fmt: skip


@pytest.fixture(scope="session")
def on_a_spring():  # type: ignore[no-untyped-def]
    """Makes a mass on a spring that no servo holds, 1 N per input unit."""

    def of(mass, frequency, damping, step, unit="A", **noise):  # type: ignore[no-untyped-def]
        pole = 2 * np.pi * frequency * np.array([-damping, np.sqrt(1 - damping**2)])
        return plant_from_dict(
            {
                "name": "spring",
                "sample_time": step,
                "units": {"input": unit, "output": "m"},
                "plant": {
                    "form": "czpk", "zeros": [], "gain": 1.0 / mass,
                    "poles": [pole.tolist(), (pole * [1, -1]).tolist()],
                },
                "machine": noise,
            }
        )  # fmt: skip

    return of

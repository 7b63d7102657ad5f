"""A bent scale on a stage that a spring holds: no recording tells it from a gain by position."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.maps.gains import elsewhere
from ffl.diagnose.maps.unnamed import Gained
from ffl.machines import SimulatedMachine

STEP, CURVATURE = 1e-3, 300.0  # s, 1/m


def part(port):  # type: ignore[no-untyped-def]
    words = {"output": "at the sensor", "command": "beside the command"}[port]
    return SimpleNamespace(
        place=SimpleNamespace(port=port, words=words), term=SimpleNamespace(variables=("position",))
    )


def found(port="output", parts=1, alike=()):  # type: ignore[no-untyped-def]
    return SimpleNamespace(parts=[part(port)] * parts, alike=[part(port) for port in alike])


def stands(*names, proven=()):  # type: ignore[no-untyped-def]
    return SimpleNamespace(names=names, proven=frozenset(proven))


GAIN, SCALE = "position_dependent_gain", "at the sensor: places along the stroke"


@pytest.mark.parametrize(
    ("standing", "alone", "gains", "said"),
    [
        (stands(GAIN), found(), (8.3, -0.3), SCALE),
        (stands(GAIN), found(), (8.3, -4.0), ""),  # the recordings that judge tell them apart
        (stands(GAIN), found("command"), (8.3, 2.0), ""),  # the same, without its name
        (stands(GAIN), found("command", alike=["output"]), (2.8, 3.2), SCALE),
        (stands(GAIN, "drift"), found(), (8.3, 2.0), ""),
        (stands(GAIN), found(parts=2), (8.3, 2.0), ""),
        (stands(GAIN, proven=[GAIN]), found(), (8.3, 2.0), ""),
        (stands(GAIN), None, (0.0, 0.0), ""),
    ],
)
def test_a_map_elsewhere_that_explains_as_much_is_said(standing, alone, gains, said):
    assert elsewhere(standing, alone, gains) == said


@pytest.fixture(scope="module")
def bent(on_a_spring):  # type: ignore[no-untyped-def]
    """What is found of slow moves of the stage, its sensor's scale bent: y = x + c x^2."""
    stage = on_a_spring(2.0, 40.0, 0.06, STEP, sensor_noise=2e-8, force_noise=0.02)
    device, rng, runs = SimulatedMachine(stage), np.random.default_rng(7), []
    t = STEP * np.arange(2000)
    for slow, fast in ((0.7, 1.9), (1.3, 2.1)):
        move = 10.0 * np.sin(2 * np.pi * slow * t) * np.sin(2 * np.pi * fast * t)
        run = device.run(0.0 * t, move, rng)
        runs.append(replace(run, y=run.y + CURVATURE * run.y**2))
    return diagnose(stage, runs[:1], runs[1:])


def test_neither_is_said_to_be_sure(bent):
    """8 ahead where it was fitted, and the gain was told with 0.97."""
    (told,) = bent.findings
    assert told.name == GAIN
    assert told.confidence <= 0.5
    assert any("explains as much" in note and "at the sensor" in note for note in bent.notes)


@pytest.mark.parametrize(
    ("fitted", "held", "likely", "wins"),
    [
        (24.0, 4.9, 5.8, True),
        (24.0, 2.0, 5.8, False),
        (24.0, 2.9, 0.1, False),
        (18.0, 4.9, 5.8, False),
        (24.0, 9.0, 300.0, False),
        (24.0, 11.0, 300.0, True),
        (45.0, 0.1, 300.0, True),
    ],
)
def test_a_map_wins_that_gains_what_may_be_hoped_for_where_little_shows(fitted, held, likely, wins):  # type: ignore[no-untyped-def]
    assert Gained(fitted, held, likely).ahead == wins

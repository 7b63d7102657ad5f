"""An arm that its weight pulls down is told from a spring where it turns far enough for them to differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.machines import SimulatedMachine
from ffl.systems import Controller, Move, Physics, Plant, Zpk, moves
from ffl.systems.plant import EffectSpec, Imperfections


@pytest.mark.slow(40)
@pytest.mark.parametrize(
    ("reach", "unit", "turn"),
    [(1.2, "rad", 2.0 * np.pi), (69.0, "deg", 360.0), (0.1, "rad", 2.0 * np.pi), (1.2, "m", None)],
)
def test_gravity_is_named_where_an_angle_goes_far(stage, references, reach, unit, turn):  # type: ignore[no-untyped-def]
    plant = replace(stage, output_unit=unit)
    radian = (turn or 2.0 * np.pi) / (2.0 * np.pi)
    true = {"amplitude": 4.0 * radian, "centre": 0.2 * radian, "turn": 2.0 * np.pi * radian}
    pull = EffectSpec("gravity_torque", true)
    machine = SimulatedMachine(replace(plant, effects=(pull,)))
    rng = np.random.default_rng(4)
    fit, held = (
        machine.run(r, np.zeros_like(r), rng)
        for r in (r[:1200] * reach / np.max(np.abs(r[:1200])) for r in references)
    )
    answer = diagnose(plant, [fit], [held]).answer()
    names = {effect["name"] for effect in answer["effects"]}
    if reach > 1.0 and turn:
        assert answer["verdict"] == "explained"
        assert names == {"gravity_torque"}
        found = answer["effects"][0]["parameters"]
        assert found["turn"]["value"] == turn
        for name in ("amplitude", "centre"):
            within = 4.0 * found[name]["std_error"] + 1e-3 * true[name]
            assert abs(found[name]["value"] - true[name]) < within
    else:
        assert "gravity_torque" not in names
        assert answer["verdict"] in ("explained", "partly_explained", "unnamed")


def joint() -> Plant:
    """A robot's joint of 0.83 kg m^2 under a slow lead without an integrator; its file states no noise."""
    step, inertia = 0.002, 0.83
    zero, pole = np.exp(-2 * np.pi * 2.0 * step), np.exp(-2 * np.pi * 18.0 * step)
    w = 2 * np.pi * 6.0
    lead = Zpk(np.array([zero]), np.array([pole]), 1.0, step)
    size = abs(lead.response([6.0])[0]) / (inertia * w**2)
    controller = Zpk(np.array([zero]), np.array([pole]), 1.0 / size, step)
    system = Zpk(np.array([-1.0]), np.array([1.0, 1.0]), step**2 / (2 * inertia), step)
    return Plant(
        "joint", system, Controller.of_error(controller), "N m", "rad", "made for the tests",
        Physics(inertia, 1.0), Imperfections(),
    )  # fmt: skip


@pytest.mark.slow(45)
def test_gravity_and_friction_hide_one_another_where_no_noise_is_stated():
    """Alone gravity leaves 1,000 times what both leave, and all that is left passes for noise of the
    drive; along the measured motion a limit and a dead zone as wide explained it better still."""
    plant = joint()
    friction = {"coulomb_level": 6.2, "static_level": 9.1, "stribeck_velocity": 0.12}
    effects = (
        EffectSpec("stribeck_friction", friction),
        EffectSpec("gravity_torque", {"amplitude": 21.0, "centre": 0.0}),
    )
    noise = Imperfections(encoder_resolution=4.8e-5, sensor_noise=2e-5, force_noise=0.05)
    machine = SimulatedMachine(replace(plant, effects=effects, machine=noise))
    rng = np.random.default_rng(8)
    paths = (
        ([Move(0.2, 1.6, 2.5, 12.0, 200.0), Move(1.2, -0.2, 0.1, 2.0, 50.0)], 3.6),
        ([Move(0.2, 1.1, 0.6, 5.0, 100.0), Move(2.3, -1.5, 1.8, 8.0, 100.0)], 3.6),
    )
    references = (moves(path, until, 0.002) for path, until in paths)
    *fit, held = (machine.run(r, np.zeros_like(r), rng) for r in references)
    answer = diagnose(plant, fit, [held]).answer()
    assert answer["verdict"] == "explained"
    found = {e["name"]: e["parameters"] for e in answer["effects"]}
    assert set(found) == {"stribeck_friction", "gravity_torque"}
    assert found["gravity_torque"]["amplitude"]["value"] == pytest.approx(21.0, rel=0.002)
    for name, true in friction.items():
        assert found["stribeck_friction"][name]["value"] == pytest.approx(true, rel=0.02)

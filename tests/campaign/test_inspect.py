"""What `ffl inspect` and `ffl check` say of files that can be read and do not fit."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffl.cli import execute
from ffl.effects.stated_mass import mass_said
from ffl.recordings import Recording, write_recording
from ffl.systems import load_plant

T = 1e-3
PLANTS = Path(__file__).resolve().parents[2] / "plants"


@pytest.fixture
def inspect(capfd):
    def run(*args):
        assert execute(["inspect", *map(str, args), "--json"]) == 0
        return json.loads(capfd.readouterr().out)

    return run


@pytest.fixture
def recording(tmp_path):
    u = np.random.default_rng(1).standard_normal(400)
    path = tmp_path / "rec.csv"
    write_recording(Recording.from_signals(T, u=u, y=np.cumsum(u)), path)
    return path


def test_a_sample_time_against_the_time_column_is_a_finding_as_it_is_refused(
    recording, tmp_path, inspect, capfd
):
    assert "findings" not in inspect(recording)
    columns = '[columns]\nt = "t"\nu = "u"\ny = "y"\n'
    (tmp_path / "m.toml").write_text(f"sample_time = 0.002\n{columns}")
    (found,) = inspect(recording, "--map", tmp_path / "m.toml")["findings"]
    said = "column t has a sample time of 0.001 s, the mapping says 0.002 s; correct one"
    assert found.startswith(f"fault: {said}")
    args = ["identify", "linear", "--data", recording, "--map", tmp_path / "m.toml"]
    assert execute([str(a) for a in args]) == 2
    assert said in capfd.readouterr().err
    (tmp_path / "m.toml").write_text(f"sample_time = 0.0010005\n{columns}")
    assert "findings" not in inspect(recording, "--map", tmp_path / "m.toml")


def test_margins_stand_with_their_frequencies(inspect):
    facts = inspect("emps")
    assert facts["gain_margin"] > 1
    assert facts["crossover_hz"] < facts["gain_margin_hz"]
    assert "gain_reduction_margin" not in facts  # the gain may vanish


@pytest.mark.parametrize("path", sorted(PLANTS.glob("*.toml")), ids=lambda path: path.stem)
def test_the_mass_of_a_shipped_plant_is_the_one_it_moves(path):
    assert mass_said(load_plant(path)) == ""


@pytest.mark.parametrize("name", ["emps", "flatbed_printer", "kuka_axis4"])
@pytest.mark.parametrize("factor", [0.1, 0.6, 1.6, 1000.0])
def test_a_mass_that_the_plant_does_not_move_is_said(name, factor):
    plant = load_plant(name)
    physics = plant.physics
    wrong = replace(plant, physics=replace(physics, mass=factor * physics.mass))
    said = mass_said(wrong)
    assert f"physics.mass = {factor * physics.mass:.4g}, but" in said
    moved = float(said.split("the plant moves ")[1].split()[0])
    assert moved == pytest.approx(physics.mass, rel=1e-3)
    wrong = replace(plant, physics=replace(physics, motor_constant=factor * physics.motor_constant))
    assert mass_said(wrong)


def test_check_and_inspect_tell_a_wrong_power_of_ten(write_campaign, tmp_path, inspect, capfd):
    campaign, plant = write_campaign(), tmp_path / "model.toml"
    stated = "[physics]\nmass = 1.0\nmotor_constant = 1.0\n"
    plant.write_text(plant.read_text() + stated)
    said = "physics.mass = 1, but by its gain and physics.motor_constant = 1 the plant moves 10 N s^2/m"
    assert said in inspect(plant)["note"]
    for path, place in ((plant, "note: "), (campaign, "note: model: ")):
        assert execute(["check", str(path)]) == 0
        assert f"{place}{said}" in capfd.readouterr().out


def test_the_example_of_init_states_its_own_masses(tmp_path, capfd):
    assert execute(["init", str(tmp_path / "stage")]) == 0
    for path, mass in (("stage_model.toml", 10.0), ("stage_machine.toml", 10.42)):
        plant = load_plant(tmp_path / "stage" / path)
        zero, gain = -1.0, plant.system.gain
        assert plant.physics.mass == pytest.approx(T**2 / (gain * (1 - zero)), rel=1e-3) == mass

"""What `ffl inspect` and `ffl check` say of files that can be read and do not fit."""

import json
import re
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from ffl.campaign import load_campaign, run_campaign
from ffl.cli import execute
from ffl.effects.stated_mass import mass_said
from ffl.recordings import Recording, read_recording, write_recording
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


@pytest.fixture
def refuse(capfd, tmp_path):
    def run(*args):
        capfd.readouterr()
        assert execute([str(a) for a in args]) == 2
        (line,) = capfd.readouterr().err.splitlines()
        return line

    return run


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("poles = [0.75]\ngain = 5.0e5", "poles = [0.75]", "key 'controller.gain' is missing"),
        ("gain = 5.0e5", "gain = true", "controller.gain = True: must be a number"),
        (
            "[machine]",
            '[[effects]]\nname = "hysteresis"\n[effects.parameters]\nside = "motor"\n[machine]',
            "effects[0]: effect hysteresis: unknown parameter 'side'; it stands beside parameters",
        ),
        (
            "[machine]",
            '[[effects]]\nname = "linear_stiffness"\nparameters = { stiffness = -1e6 }\n[machine]',
            "effects[0] (linear_stiffness) takes the loop, stable without it, its stability",
        ),
    ],
)
def test_a_plants_mistake_says_what_it_is(old, new, says, write_campaign, tmp_path, refuse):
    write_campaign()
    path = tmp_path / "model.toml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    assert says in refuse("check", path)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("trials = 3", "trials = 0", "trials = 0: must be at least 1"),
        (
            "error = 1.0",
            'error = { form = "zpk", zeros = [0.5], poles = [], gain = 1.0 }',
            "weights.error: more zeros than poles, so it needs the future; add poles",
        ),
    ],
)
def test_a_campaigns_mistake_says_what_it_is(old, new, says, write_campaign, refuse):
    line = refuse("check", write_campaign((old, new)))
    assert says in line
    assert "Input should" not in line


def test_columns_that_nothing_is_made_of_are_told(recording, tmp_path, inspect):
    """A diagnosis looks at them: another axis, a temperature."""
    assert "other_columns" not in inspect(recording)
    header, *rows = recording.read_text().splitlines()
    named = [f"{header},motor_degC", *(f"{row},{20 + k}" for k, row in enumerate(rows))]
    (tmp_path / "warm.csv").write_text("\n".join(named) + "\n")
    assert inspect(tmp_path / "warm.csv")["other_columns"] == ["motor_degC"]


def test_a_mappings_mistake_names_the_mapping(recording, tmp_path, refuse):
    path = tmp_path / "m.toml"
    path.write_text('[columns]\nt = "t"\nu = "u"\n')
    line = refuse("inspect", recording, "--map", path)
    assert "no column y in the mapping, the measured output; add it to its [columns]" in line
    assert str(path) in line
    path.write_text('[columns]\nu = "u"\ny = "y"\n')
    assert 'or map t = "t": the file has such a column' in refuse(
        "inspect", recording, "--map", path
    )
    path.write_text('rows = [5, 2]\n[columns]\nu = "u"\ny = "y"\n')
    line = refuse("check", path)
    assert "rows: give [start] or [start, stop]" in line
    assert "Value error" not in line


def test_check_of_a_recording_points_to_inspect(recording, refuse):
    assert "is a recording by its ending" in (line := refuse("check", recording))
    assert "ffl inspect" in line


def test_a_basis_that_is_there_twice_is_noted(write_campaign, capfd):
    table = '{ kind = "fir", preview = 2, lag = 2 }'
    assert execute(["check", str(write_campaign((table, f"{table}, {table}")))]) == 0
    assert "; note: runs[1].basis[1] repeats basis[0]" in capfd.readouterr().out
    assert execute(["check", str(write_campaign())]) == 0
    assert "note" not in capfd.readouterr().out


@pytest.mark.parametrize("trials", [1, 3])
def test_a_stored_trial_is_a_recording(write_campaign, tmp_path, inspect, trials):
    run_campaign(load_campaign(write_campaign(trials=trials)), tmp_path / "out")
    facts = inspect(tmp_path / "out" / "fir.h5")
    assert facts["trials"] == trials
    columns = facts["as a recording"].split("[columns] ")[1].split(";")[0]
    path = tmp_path / "trial.toml"
    path.write_text("[columns]\n" + re.sub(r", (?=[fuyr] =)", "\n", columns))
    found = read_recording(tmp_path / "out" / "fir.h5", path)
    with h5py.File(tmp_path / "out" / "fir.h5") as file:
        np.testing.assert_array_equal(found.y, file["y"][-1])
        np.testing.assert_array_equal(found.r, file["reference"][()])

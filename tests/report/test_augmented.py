"""An augmented.toml at work: as model and machine of `ffl run`, and in `ffl step`."""

import json
from dataclasses import replace

import numpy as np
import pytest

from ffl.cli import execute
from ffl.machines import SimulatedMachine
from ffl.recordings import write_recording
from ffl.systems import EffectSpec, Move, load_plant, moves, plant_to_dict
from ffl.systems.toml_text import to_toml

T = 1e-3
EFFECTS = (
    EffectSpec("coulomb_friction", {"level": 20.0}),
    EffectSpec("viscous_friction", {"coefficient": 150.0}),
    EffectSpec("cogging", {"amplitude": 6.0, "period": 0.03, "phase": 0.4}),
)
CAMPAIGN = """
name = "augmented"
trials = 4
model = "augmented.toml"
machine = "augmented.toml"
[reference]
kind = "moves"
moves = [{ start = 0.2, distance = 0.1, velocity = 0.3, acceleration = 3.0, jerk = 60.0 }]
duration = 1.0
[[runs]]
name = "physics"
basis = "from_diagnosis"
weights = { error = 1e9, feedforward = 1e-9 }
[[runs]]
name = "linear"
basis = [{ kind = "derivatives", orders = ["acceleration", "velocity"] }]
update = "closed_form"
weights = { error = 1e9, feedforward = 1e-9 }
[[runs]]
name = "free"
basis = [{ kind = "free" }]
weights = { error = 1e9, feedforward = 1e-4 }
"""


@pytest.fixture
def augmented(tmp_path):
    plant = replace(load_plant("emps"), effects=EFFECTS)
    path = tmp_path / "augmented.toml"
    path.write_text(to_toml(plant_to_dict(plant)))
    return path, plant


@pytest.mark.slow(20)
def test_a_campaign_runs_with_it_as_model_and_machine(augmented, tmp_path, capfd, undrawn):
    campaign = tmp_path / "campaign.toml"
    campaign.write_text(CAMPAIGN)
    out = tmp_path / "out"
    assert execute(["run", str(campaign), "--out", str(out), "--quiet"]) == 0
    results = json.loads((out / "results.json").read_text())
    norms = {run["name"]: run["error_norm"] for run in results["runs"]}
    assert all(run["status"] == "done" for run in results["runs"])
    # The model is the machine: what is left is what its basis and the sampling of friction leave.
    assert norms["physics"][-1] < 0.01 * norms["physics"][0]
    assert norms["physics"][-1] < 0.1 * norms["linear"][-1]
    assert norms["free"][-1] < 0.2 * norms["free"][0]
    assert execute(["rerun", str(out), "--out", str(tmp_path / "again"), "--quiet"]) == 0
    capfd.readouterr()


def test_a_step_foretells_the_error_and_checks_it_on_another_recording(augmented, tmp_path, capfd):
    path, plant = augmented
    machine = SimulatedMachine(plant)
    files = []
    for k, (distance, velocity) in enumerate(((0.1, 0.3), (-0.15, 0.2))):
        r = moves([Move(0.3, distance, velocity, 3.0, 60.0)], 1.5, T)
        recording = machine.run(r, np.zeros(len(r)), np.random.default_rng(k))
        files.append(tmp_path / f"trial_{k}.csv")
        write_recording(recording, files[-1])
    basis = tmp_path / "basis.toml"
    basis.write_text('basis = "from_diagnosis"\nweights = { error = 1.0, feedforward = 1e-20 }\n')
    out = tmp_path / "step"
    arguments = ["step", "--model", str(path), "--basis", str(basis), "--trial", str(files[0])]
    assert execute([*arguments, "--check", str(files[1]), "--out", str(out), "--json"]) == 0
    answer = json.loads(capfd.readouterr().out)
    assert len(answer["foretold"]) == 2
    for entry in answer["foretold"]:
        assert entry["before"] == pytest.approx(entry["measured"], rel=1e-3)
        assert entry["after"] < 0.05 * entry["before"]
    # What was foretold is what the machine does with the command that was written.
    table = np.genfromtxt(out / "feedforward.csv", delimiter=",", names=True)
    run = machine.run(table["r"], table["f"], np.random.default_rng(0))
    after = float(np.sqrt(np.mean((table["r"] - run.y) ** 2)))
    assert after == pytest.approx(answer["foretold"][0]["after"], rel=0.02)
    assert "Foretold by the model" in (out / "report.html").read_text()

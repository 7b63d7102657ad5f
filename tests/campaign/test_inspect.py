"""What `ffl inspect` and `ffl check` say of files that can be read and do not fit."""

import json

import numpy as np
import pytest

from ffl.cli import execute
from ffl.recordings import Recording, write_recording

T = 1e-3


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

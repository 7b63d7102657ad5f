"""A run's folder in which something is missing, cut or altered: said in one line, or by rerun."""

import json
import shutil

import h5py
import pytest

from ffl.campaign import load_campaign, run_campaign
from ffl.cli import execute
from ffl.errors import InputError
from ffl.systems.atomic import write_text

pytestmark = pytest.mark.usefixtures("undrawn")  # pages are written, and none is looked at


@pytest.fixture
def folder(finished, tmp_path, monkeypatch):
    """done/, a finished run."""
    monkeypatch.chdir(tmp_path)
    return shutil.copytree(finished, tmp_path / "done")


@pytest.fixture
def line(capfd):
    """The one line on stderr of a command that ends with `code`, and what stdout said."""

    def run(*arguments, code=2):
        capfd.readouterr()
        assert execute([str(argument) for argument in arguments]) == code
        captured = capfd.readouterr()
        assert len(captured.err.splitlines()) == 1
        return captured.err, captured.out

    return run


def edit(folder, change):
    path = folder / "results.json"
    results = json.loads(path.read_text())
    change(results)
    path.write_text(json.dumps(results))


def set_in(*keys):
    def change(results):
        *way, last = keys
        for key in way:
            results = results[key]
        results[last] *= 1 + 1e-15

    return change


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (set_in("runs", 1, "cost", 2), "cost[2]"),
        (set_in("runs", 1, "update", 1, "kkt_residual"), "update[1].kkt_residual"),
        (set_in("runs", 0, "second_reference", "error_norm"), "second_reference.error_norm"),
        (set_in("sample_time"), "sample_time"),
        (lambda results: results["runs"][2].update(parameters=501), "parameters"),
    ],
)
def test_rerun_compares_every_number(folder, line, change, named):
    edit(folder, change)
    err, out = line("rerun", "done", "--quiet", code=1)
    assert f"differs: {named}" in out
    assert out.count("differs") == 1
    assert "the numbers differ from those on disk" in err


def test_rerun_leaves_wall_times_out(folder, capfd):
    edit(folder, lambda results: results["runs"][1]["update"][0].update(seconds=7.0))
    with h5py.File(folder / "fir.h5", "a") as file:
        file["seconds"][1] = 7.0
    assert execute(["rerun", "done", "--quiet"]) == 0


@pytest.mark.parametrize("name", ["e", "theta", "second/y"])
def test_rerun_compares_the_signals(folder, line, name):
    with h5py.File(folder / "fir.h5", "a") as file:
        row = file[name][-1]
        file[name][-1] = row * (1 + 1e-15)
    out = line("rerun", "done", "--quiet", code=1)[1]
    assert f"differs: signal {name}" in out
    assert out.count("same") == 2


def test_rerun_says_where_there_are_no_signals_to_compare(folder, capfd):
    (folder / "fir.h5").unlink()
    assert execute(["rerun", "done", "--quiet"]) == 0
    assert "same (fir.h5 is not there)" in capfd.readouterr().out


@pytest.mark.parametrize("verb", ["report", "rerun"])
def test_a_run_missing_from_results_is_said_and_mended_as_said(folder, line, verb):
    edit(folder, lambda results: results["runs"].pop(1))
    err = line(verb, "done")[0]
    mend = "run done/campaign.toml --out done --resume"
    assert f"done/results.json: run 'fir' is missing; write the file again with: ffl {mend}" in err
    assert execute([*mend.split(), "--quiet"]) == 0
    assert execute([verb, "done"]) == 0
    edit(folder, lambda results: results["runs"].append(results["runs"][0]))
    assert "run 'derivatives' is there twice" in line(verb, "done")[0]
    edit(folder, lambda results: results["runs"][-1].update(name="other"))
    assert "run 'other' is not one of campaign.toml" in line(verb, "done")[0]


EXPORT = ("export", "done", "--run", "fir", "--format", "json", "--out", "f.json")
RESUME = ("run", "done/campaign.toml", "--out", "done", "--resume", "--quiet")


def made_again(folder):
    """What `RESUME` does, but for its report."""
    run_campaign(load_campaign(folder / "campaign.toml"), folder, resume=True)


@pytest.mark.parametrize("command", [EXPORT, ("report", "done")], ids=["export", "report"])
def test_missing_signals_are_said_with_the_mend(folder, line, command):
    (folder / "fir.h5").unlink()
    err = line(*command)[0]
    again = "make it again with: ffl run done/campaign.toml --out done --resume"
    assert f"done/fir.h5: is missing; {again}" in err
    made_again(folder)
    assert execute(list(command)) == 0


@pytest.mark.slow(5)
@pytest.mark.parametrize("command", [EXPORT, ("report", "done"), RESUME, ("rerun", "done")])
def test_cut_signals_are_said_with_the_mend(folder, line, command):
    path = folder / "fir.h5"
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    err = line(*command)[0]
    assert "done/fir.h5: is damaged (" in err
    assert "remove it, then make it again with: ffl run done/campaign.toml --out done" in err
    path.unlink()
    if command != RESUME:
        made_again(folder)
    assert execute(list(command)) == 0
    assert path.read_bytes()[:8] == content[:8]


def test_signals_without_a_dataset_are_damaged(folder, line):
    with h5py.File(folder / "fir.h5", "a") as file:
        del file["theta"]
    assert "done/fir.h5: is damaged (" in line(*EXPORT)[0]


def test_an_output_that_cannot_be_written_is_named_itself(folder, line, tmp_path):
    (tmp_path / "taken").mkdir()
    with pytest.raises(InputError, match=r"taken: cannot be written: Is a directory; give another"):
        write_text(tmp_path / "taken", "x")
    assert list((tmp_path / "taken").parent.glob(".*.part")) == []
    # the run's folder is complete, but the page's place is taken by a folder
    shutil.rmtree(tmp_path / "taken")
    (folder / "report.html").mkdir()
    err = line("report", "done")[0]
    assert "ffl: done/report.html: cannot be written: Is a directory" in err
    assert ".part" not in err

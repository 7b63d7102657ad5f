"""`ffl report` and `ffl export` write over their own earlier files only."""

import pytest

from ffl.campaign import load_campaign, run_campaign
from ffl.cli import execute

FORMATS = ("json", "c", "mat", "csv")


@pytest.fixture
def done(write_campaign, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_campaign(load_campaign(write_campaign(trials=2)), tmp_path / "done")
    return tmp_path / "done"


def export(kind, out, run="fir"):
    return execute(["export", "done", "--run", run, "--format", kind, "--out", str(out)])


def refused(capfd, path, *command):
    before = path.read_bytes()
    capfd.readouterr()
    assert execute([str(c) for c in command]) == 2
    err = capfd.readouterr().err
    assert len(err.splitlines()) == 1
    assert f"{path}: stands there already and is no earlier output of this command" in err
    assert path.read_bytes() == before


def test_another_file_is_not_lost(done, tmp_path, capfd):
    table = tmp_path / "mine.csv"
    table.write_text("t,r,f\n0.0,0.0,1.0\n")
    page = tmp_path / "page.html"
    page.write_text("<html><footer>Written by ffl 1.0.</footer></html>")
    results = done / "results.json"
    for path in (results, tmp_path / "model.toml", table, page, done / "fir.h5"):
        refused(capfd, path, "report", "done", "--out", path)
        for kind in FORMATS:
            refused(capfd, path, "export", "done", "--run", "fir", "--format", kind, "--out", path)


@pytest.mark.usefixtures("undrawn")
def test_an_earlier_output_of_the_same_command_is_replaced(done, tmp_path, capfd):
    for kind in FORMATS:
        out = tmp_path / f"out.{kind}"
        assert export(kind, out) == 0
        first = out.read_bytes()
        assert export(kind, out, run="derivatives") == 0
        assert out.read_bytes() != first
        for other in FORMATS:
            if other != kind:
                refused(
                    capfd, out, "export", "done", "--run", "fir", "--format", other, "--out", out
                )
        refused(capfd, out, "report", "done", "--out", out)
    for _ in range(2):
        assert execute(["report", "done", "--out", "page.html"]) == 0


@pytest.mark.usefixtures("undrawn")
def test_a_comparison_says_where_it_went(done, write_campaign, tmp_path, capfd):
    run_campaign(load_campaign(write_campaign(trials=2)), tmp_path / "again")
    assert execute(["report", "done", "again"]) == 0
    assert f"report: {tmp_path / 'comparison.html'}" in capfd.readouterr().out

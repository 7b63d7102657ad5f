import io
import sys
from types import SimpleNamespace

import pytest

from ffl.report import terminal


class Screen(io.StringIO):
    def isatty(self):
        return True


def test_a_table_sets_numbers_right(capsys):
    terminal.print_table(["run", "error"], [["fir", 0.039412], ["obf", 2.0], ["free", None]])
    assert capsys.readouterr().out.splitlines() == [
        "run     error",
        "----  -------",
        "fir   0.03941",
        "obf         2",
        "free",
    ]


@pytest.mark.parametrize(("patience", "shown"), [(0.0, True), (60.0, False)])
def test_a_bar_appears_once_it_takes_long(patience, shown, monkeypatch):
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(terminal, "PATIENCE", patience)
    with terminal.progress("learning", 10) as advance:
        advance(1, "first")
        advance(2, "second")
    assert ("learning" in screen.getvalue()) is shown


@pytest.mark.parametrize("quiet", [True, False])
def test_no_bar_where_nobody_looks(quiet, monkeypatch):
    screen = Screen() if quiet else io.StringIO()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(terminal, "PATIENCE", 0.0)
    with terminal.progress("learning", 10, quiet) as advance:
        advance(1, "first")
    assert screen.getvalue() == ""


def test_work_of_unknown_length_is_silent_off_a_terminal(capfd):
    from ffl.report.terminal import working

    with working("identify"):
        pass
    assert capfd.readouterr() == ("", "")


def test_work_of_unknown_length_shows_a_bar_after_a_while(monkeypatch, capfd):
    import sys
    import time

    from ffl.report import terminal

    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(terminal, "PATIENCE", 0.0)
    with terminal.working("identify kernel"):
        time.sleep(0.3)
    assert "identify kernel" in capfd.readouterr().err


@pytest.mark.parametrize("quiet", [True, False])
def test_a_diagnosis_says_how_far_it_is_off_a_terminal_too(quiet, tmp_path, monkeypatch, capfd):
    """A job whose stderr goes to a file shows that it lives; stdout is the answer alone."""
    import json

    import ffl.report.diagnosis as page
    from ffl.cli import execute

    def diagnosed(plant, recordings, validation, progress):
        for line in ("checking the recordings: sound", "nothing: log-likelihood 1.0"):
            if progress:
                progress(line)
        return SimpleNamespace(answer=lambda: {"verdict": "nothing_missing"})

    monkeypatch.setattr(page, "diagnose", diagnosed)
    monkeypatch.setattr(page, "read_recording", lambda *a, **k: None)
    (tmp_path / "run.csv").write_text("t,u,y\n")
    command = ["diagnose", "--model", "emps", str(tmp_path / "run.csv"), "--json"]
    assert execute([*command, "--quiet"] if quiet else command) == 0
    out, err = capfd.readouterr()
    assert json.loads(out) == {"verdict": "nothing_missing"}
    assert err.splitlines() == (
        [] if quiet else ["ffl: checking the recordings: sound", "ffl: nothing: log-likelihood 1.0"]
    )

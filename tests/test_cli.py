"""The command line: exit codes, one line per mistake, nothing half-written."""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ffl.cli import execute

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def refuse(capfd, tmp_path, monkeypatch):
    """Runs a command that must be refused: exit 2, one line on stderr, nothing written."""
    monkeypatch.chdir(tmp_path)

    def run(*args, says, code=2):
        before = sorted(str(p) for p in tmp_path.rglob("*"))
        assert execute([str(arg) for arg in args]) == code
        captured = capfd.readouterr()
        lines = captured.err.splitlines()
        assert len(lines) == 1, captured.err
        assert lines[0].startswith("ffl: ")
        for part in [says] if isinstance(says, str) else says:
            assert part in lines[0]
        assert captured.out == ""
        assert "Traceback" not in captured.err
        assert sorted(str(p) for p in tmp_path.rglob("*")) == before
        return lines[0]

    return run


CAMPAIGN_MISTAKES = {
    "a typo in a key": (("trials =", "trails ="), "unknown key 'trails'; did you mean 'trials'"),
    "a typo in a run": (("weights =", "wieghts ="), "unknown key 'runs[0].wieghts'; did you mean"),
    "a typo in a weight": (("error = 1.0", "eror = 1.0"), "runs[0].weights.eror"),
    "a typo in a basis": (("preview = 2", "previw = 2"), "runs[1].basis[0].previw: unknown key"),
    "an unknown basis": (('"fir"', '"firr"'), "did you mean 'fir'?"),
    "an unknown plant": (('"model.toml"', '"flatbed_priter"'), "did you mean 'flatbed_printer'?"),
    "no such plant file": (('"model.toml"', '"other.toml"'), "no such file"),
    "a zero weight": (("error = 1.0", "error = 0.0"), "weights.error = 0 must be positive"),
    "a negative weight": (("feedforward = 1e-14", "feedforward = -1.0"), "must not be negative"),
    "a weight in words": (("error = 1.0", 'error = "strong"'), "runs[0].weights.error"),
    "a weight of NaN": (("error = 1.0", "error = nan"), "runs[0].weights.error"),
    "a vector of wrong length": (("error = 1.0", "error = [1.0, 2.0]"), "2 values, the reference"),
    "no trial": (("trials = 3", "trials = 0"), "trials = 0"),
    "a trial and a half": (("trials = 3", "trials = 1.5"), "trials = 1.5"),
    "a negative seed": (("seed = 3", "seed = -1"), "seed = -1"),
    "a name that is a path": (('name = "small"', 'name = "../small"'), "name = '../small'"),
    "two runs of one name": (('name = "fir"', 'name = "derivatives"'), "used twice"),
    "two runs of one file": (('name = "fir"', 'name = "Derivatives"'), "in whatever case"),
    "an unknown reference": (('kind = "moves"', 'kind = "jumps"'), "reference"),
    "a move before rest": (("start = 0.05", "start = 0.0"), "must be at rest"),
    "a move without speed": (("velocity = 0.4", "velocity = 0.0"), "velocity = 0.0"),
    "a move past the end": (("duration = 0.5", "duration = 0.1"), "lengthen it"),
    "a jerk of no machine": (("jerk = 300.0", "jerk = 1e308"), "too large or too small"),
    "a year of reference": (("duration = 0.5", "duration = 3e7"), "holds more than 1e+08 samples"),
    "a kind that is no name": (('kind = "fir"', "kind = [1]"), "runs[1].basis"),
    "not TOML": (("trials = 3", "trials = = 3"), "not valid TOML"),
    "a preview past the end": (("preview = 2", "preview = 600"), "the taps reach 600"),
    "bounds that exclude each other": (
        (
            'name = "fir"',
            'name = "fir"\nconstraints = { feedforward = 1e-3, parameters = [5.0, 6.0] }',
        ),
        ("runs[1]", "no parameters meet the bounds together"),
    ),
    "a bound below zero": (('name = "fir"', 'name = "fir"\nconstraints = { feedforward = -1.0 }'),
                           "constraints.feedforward = -1 must be positive"),
    "bounds the wrong way round": (
        ('name = "fir"', 'name = "fir"\nconstraints = { feedforward = [2.0, 1.0] }'),
        "lies above upper bound",
    ),
    "an update that does not fit": (('name = "fir"', 'name = "fir"\nupdate = "riccati"'),
                                    "update = 'riccati' does not fit"),
    "a basis pole on the unit circle": (
        ('{ kind = "fir", preview = 2, lag = 2 }', '{ kind = "obf", poles = [1.0] }'),
        "on the unit circle",
    ),
    "a basis pole on the wrong side": (
        ('{ kind = "fir", preview = 2, lag = 2 }', '{ kind = "obf", poles = [1.1] }'),
        "put it under 'outside'",
    ),
    "a basis pole without its conjugate": (
        ('{ kind = "fir", preview = 2, lag = 2 }', '{ kind = "obf", poles = [[0.9, 0.1]] }'),
        "without its conjugate",
    ),
}  # fmt: skip


@pytest.mark.parametrize("mistake", CAMPAIGN_MISTAKES)
def test_every_mistake_in_a_campaign_is_one_line(mistake, write_campaign, refuse, tmp_path):
    replace, says = CAMPAIGN_MISTAKES[mistake]
    path = write_campaign(replace)
    for verb, options in (("check", ()), ("run", ("--out", tmp_path / "out"))):
        line = refuse(verb, path, *options, says=says)
        assert "small.toml" in line or mistake.startswith("a preview") or "runs[" in line


PLANT_MISTAKES = {
    "an unstable loop": (("gain = 5.0e5", "gain = 5.0e9"), "the closed loop is unstable"),
    "a pole without its conjugate": (("[1.0, 1.0]", "[1.0, [0.9, 0.1]]"), "without its conjugate"),
    "an unstable machine without controller": (("poles = [1.0, 1.0]", "poles = [1.2, 1.0]"),
                                               "unstable"),
    "a delay without end": (("gain = 5e-08", "gain = 5e-08\ndelay = 100000"), "plant.delay = 100000"),
    "a number in quotes": (("gain = 5e-08", 'gain = "5e-08"'), "plant.gain"),
    "a typo": (("sample_time", "sampletime"), "did you mean 'sample_time'"),
    "no gain": (("gain = 5e-08", ""), "'plant.gain' is missing"),
    "a negative noise": (("force_noise = 0.01", "force_noise = -1"), "machine.force_noise = -1"),
    "an unknown effect": (
        ("[machine]", '[[effects]]\nname = "coulomb_frition"\nparameters = { level = 1.0 }\n[machine]'),
        "did you mean 'coulomb_friction'",
    ),
    "a spring that drives": (
        (
            "[machine]",
            '[[effects]]\nname = "linear_stiffness"\nparameters = { stiffness = -1e7 }\n[machine]',
        ),
        "unstable",
    ),
    "a wrong effect parameter": (
        ("[machine]", '[[effects]]\nname = "coulomb_friction"\nparameters = { levle = 1.0 }\n[machine]'),
        "level",
    ),
}  # fmt: skip


@pytest.mark.parametrize("mistake", PLANT_MISTAKES)
def test_every_mistake_in_a_plant_is_one_line(mistake, write_campaign, refuse, tmp_path):
    (old, new), says = PLANT_MISTAKES[mistake]
    campaign = write_campaign()
    plant = tmp_path / "model.toml"
    assert old in plant.read_text()
    plant.write_text(plant.read_text().replace(old, new))
    refuse("check", plant, says=says)
    refuse("run", campaign, says=says)


REFERENCES = {
    "not a number": ("0.001,nan", "line 3"),
    "a ragged row": ("0.001", "line 3"),
    "a gap in time": ("0.004,0.0", "time"),
    "text": ("0.001,zero", "line 3"),
    "not at rest": ("0.001,0.02", "does not start at rest"),
}


@pytest.mark.parametrize("mistake", REFERENCES)
def test_a_reference_file_is_checked(mistake, write_campaign, refuse, tmp_path):
    row, says = REFERENCES[mistake]
    rows = [f"{k / 1000:.3f},{0.02 * min(k / 50, 1):.6f}" for k in range(200)]
    rows[1] = row
    (tmp_path / "path.csv").write_text("\n".join(["t,r", *rows]) + "\n")
    text = write_campaign().read_text()
    head, tail = text[: text.index("[reference]")], text[text.index("[[runs]]") :]
    path = tmp_path / "small.toml"
    path.write_text(f'{head}[reference]\nkind = "file"\nfile = "path.csv"\n{tail}')
    refuse("run", path, says=says)


def test_a_folder_is_no_reference_and_an_open_model_learns_no_closed_machine(
    write_campaign, refuse, tmp_path
):
    path = write_campaign()
    text = path.read_text()
    head, tail = text[: text.index("[reference]")], text[text.index("[[runs]]") :]
    (tmp_path / "log").mkdir()
    (tmp_path / "x.toml").write_text(f'{head}[reference]\nkind = "file"\nfile = "log"\n{tail}')
    refuse("check", tmp_path / "x.toml", says="recording 'log': is a folder")
    refuse("inspect", "nothing.csv", says="no such file")
    model = tmp_path / "model.toml"
    kept = model.read_text()
    first = kept.index("[controller]")
    last = min(at for mark in ("[physics]", "[machine]") if (at := kept.find(mark, first)) > 0)
    model.write_text(kept[:first] + kept[last:])
    refuse("check", path, says=("has no [controller]", "copy the [controller]"))


def test_a_missing_recording_says_where_it_was_looked_for(write_campaign, refuse, tmp_path):
    text = write_campaign().read_text()
    head, tail = text[: text.index("[reference]")], text[text.index("[[runs]]") :]
    path = tmp_path / "small.toml"
    path.write_text(f'{head}[reference]\nkind = "file"\nfile = "emps/none.mat"\n{tail}')
    refuse("run", path, says=("no such file", "FFL_DATA"))


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["rnu"], "No such command 'rnu'"),
        (["run"], "Missing argument"),
        (["run", "none.toml"], "no such file"),
        (["run", "none.toml", "--jbos", "2"], "No such option"),
        (["run", "none.toml", "--jobs", "two"], "--jobs"),
        (["check", "."], "is a folder"),
        (["report", "nowhere"], "no results.json"),
        (["rerun", "nowhere"], "no results.json"),
        (["inspect", "nowhere.csv"], "no such file"),
        (["inspect", "flatbed_priner"], "did you mean 'flatbed_printer'"),
        (
            ["export", "nowhere", "--run", "fir", "--format", "c", "--out", "f.h"],
            "no campaign.toml",
        ),
        (["export", "nowhere", "--run", "fir", "--format", "xml", "--out", "f.h"], "format 'xml'"),
        (["new", "kernel", "mine"], "new 'kernel'"),
        (["new", "plant", "../mine"], "lower case"),
        (["reproduce", "printer2019"], "did you mean 'printer2018'"),
    ],
)
def test_usage_mistakes_are_one_line(args, says, refuse):
    refuse(*args, says=says)


def test_seed_and_jobs_are_checked(write_campaign, refuse):
    path = write_campaign()
    refuse("run", path, "--seed", "-3", says="seed = -3")
    refuse("run", path, "--jobs", "0", says="jobs = 0")


def test_a_run_that_cannot_be_completed_is_exit_1(write_campaign, tmp_path, capfd):
    path = write_campaign(duration=4.0)
    plant = tmp_path / "machine.toml"
    change = '[[effects]]\nname = "mass_change"\nparameters = { change = -0.95 }\n'
    plant.write_text(plant.read_text() + "[physics]\nmass = 10.0\nmotor_constant = 1.0\n" + change)
    assert execute(["run", str(path), "--out", str(tmp_path / "out")]) == 1
    captured = capfd.readouterr()
    assert len(captured.err.splitlines()) == 1
    assert "diverged" in captured.err
    assert captured.out == ""
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert {run["status"] for run in results["runs"]} == {"diverged"}


@pytest.mark.slow(10)
def test_run_report_export_inspect_rerun(write_campaign, tmp_path, capfd, monkeypatch, refuse):
    """The page of `--resume` and that of `report` are the same; of the others none is read, so they are
    written without their pictures."""

    def undrawn(*command):
        with monkeypatch.context() as patch:
            patch.setattr("ffl.report.page.image_source", lambda figure: "data:,")
            return execute([*command])

    monkeypatch.chdir(tmp_path)
    assert undrawn("run", str(write_campaign()), "--quiet") == 0
    captured = capfd.readouterr()
    assert "runs/small/report.html" in captured.out
    assert captured.err == ""
    folder = tmp_path / "runs" / "small"
    refuse("run", "small.toml", says="not empty; add --resume")
    assert execute(["run", "small.toml", "--resume", "--json"]) == 0
    assert json.loads(capfd.readouterr().out) == json.loads((folder / "results.json").read_text())
    assert execute(["rerun", str(folder)]) == 0
    assert capfd.readouterr().out.count("same") == 3
    assert execute(["report", "runs/small", "--out", "again.html"]) == 0
    assert (tmp_path / "again.html").read_text() == (folder / "report.html").read_text()
    assert undrawn("report", "runs/small", "--out", "pages") == 0  # no ending: a folder
    assert (tmp_path / "pages" / "report.html").is_file()
    assert undrawn("report", "runs/small", "runs/small", "--out", "pages") == 0
    assert (tmp_path / "pages" / "comparison.html").is_file()
    capfd.readouterr()
    for kind in ("json", "c", "mat", "csv"):
        out = tmp_path / f"f.{kind}"
        assert (
            execute(["export", str(folder), "--run", "fir", "--format", kind, "--out", str(out)])
            == 0
        )
        assert out.stat().st_size > 500
        assert Path(capfd.readouterr().out.strip()) == out
    refuse("export", folder, "--run", "fri", "--format", "c", "--out", "g.h", says="mean 'fir'")
    refuse("export", folder, "--run", "free", "--format", "c", "--out", "g.h", says="not a filter")
    capfd.readouterr()
    for what in (folder, "small.toml", "model.toml", "f.csv", "flatbed_printer"):
        code = execute(["inspect", str(what), "--json"])
        if what == "f.csv":
            assert code == 2  # a table without an output is no recording
            continue
        assert code == 0
        assert json.loads(capfd.readouterr().out)["kind"]


def test_a_free_signal_counts_as_results_do(write_campaign, capfd):
    assert execute(["inspect", str(write_campaign()), "--json"]) == 0
    assert "free, 500 parameters" in json.loads(capfd.readouterr().out)["run free"]


def test_check_says_what_is_sound(write_campaign, capfd):
    path = write_campaign()
    assert execute(["check", str(path), "--json"]) == 0
    answer = json.loads(capfd.readouterr().out)
    assert answer["valid"] is True
    for file in sorted((ROOT / "plants").glob("*.toml")):
        assert execute(["check", str(file)]) == 0, file
    for file in sorted((ROOT / "plants" / "maps").glob("*.toml")):
        assert execute(["check", str(file)]) == 0, file


def test_init_gives_a_campaign_that_runs(tmp_path, capfd, refuse):
    folder = tmp_path / "my stage"
    assert execute(["init", str(folder)]) == 0
    assert execute(["check", str(folder / "my_stage.toml")]) == 0
    capfd.readouterr()
    refuse("init", folder, says="exists and is not empty")


def test_new_refuses_what_is_in_the_catalogue(tmp_path, capfd, refuse):
    refuse("new", "effect", "cogging", says="in the catalogue already")
    refuse("new", "basis", "fir", says="in the catalogue already")
    assert execute(["new", "effect", "belt_wave", "--out", str(tmp_path)]) == 0
    assert "import BeltWave from ffl.effects.belt_wave" in capfd.readouterr().err


@pytest.mark.parametrize("what", ["plant", "basis", "effect"])
def test_new_files_are_sound(what, tmp_path, capfd, refuse):
    import runpy

    import numpy as np

    assert execute(["new", what, "my_own", "--out", str(tmp_path)]) == 0
    path = Path(capfd.readouterr().out.strip())
    if what == "plant":
        assert execute(["check", str(path)]) == 0
    else:
        made = runpy.run_path(str(path))["MyOwn"]()
        if what == "basis":
            assert made.regressors(np.arange(5.0)).shape == (5, made.n_parameters)
        else:
            assert made.name == "my_own"
    capfd.readouterr()
    refuse("new", what, "my_own", "--out", tmp_path, says="exists already")


def test_help_is_fast_and_needs_nothing_heavy():
    code = (
        "import sys, ffl.cli; ffl.cli.execute(['--help']);"
        "heavy = {'numpy', 'scipy', 'numba', 'matplotlib', 'cvxpy', 'h5py', 'pydantic', 'rich'};"
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)"
    )
    start = time.process_time()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"
    assert "run" in done.stdout
    assert time.process_time() - start < 1.0


def test_a_broken_pipe_is_clean():
    command = [sys.executable, "-m", "ffl.cli", "inspect", "flatbed_printer"]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=os.environ, cwd=ROOT
    )
    process.stdout.close()
    with process.stderr:
        assert process.stderr.read() == b""
    assert process.wait(60) == 0


def test_an_internal_error_is_one_line_too(monkeypatch, refuse, tmp_path):
    def broken(path):
        raise ZeroDivisionError("float division by zero")

    monkeypatch.setattr("ffl.campaign.inspect.check_file", broken)
    refuse("check", "x.toml", says="internal error, ZeroDivisionError", code=1)


@pytest.fixture
def stage_recording(write_campaign, tmp_path):
    """A stage recorded in closed loop with noise on its command."""
    import numpy as np

    from ffl.machines import SimulatedMachine
    from ffl.recordings import write_recording
    from ffl.systems import load_plant

    write_campaign()
    machine = SimulatedMachine(load_plant(tmp_path / "machine.toml"))
    rng = np.random.default_rng(0)
    feedforward = np.concatenate([np.zeros(5), 5.0 * rng.standard_normal(1500)])
    recording = machine.run(np.zeros(len(feedforward)), feedforward, rng)
    write_recording(recording, tmp_path / "trial.csv")
    return tmp_path / "trial.csv"


@pytest.mark.parametrize("method", ["least_squares", "linear"])
def test_identify_writes_its_answer(method, stage_recording, tmp_path, capfd):
    from ffl.systems import load_plant

    out = tmp_path / "found"
    command = ["identify", method, "--data", str(stage_recording), "--out", str(out), "--json"]
    command += ["--n-ac", "3", "--n-c", "3", "--order", "2"]
    assert execute([*command, "--model", str(tmp_path / "model.toml")]) == 0
    answer = json.loads(capfd.readouterr().out)
    assert answer == json.loads((out / "answer.json").read_text())
    assert answer["method"] == method
    but = "--model but for its sample time: it knows no controller"
    idle = [but, "--order"] if method == "least_squares" else ["--n-ac", "--n-c"]
    assert [n for n in answer["notes"] if "no use" in n] == [
        f"{method} makes no use of {option}" for option in idle
    ]
    assert "<figure>" in (out / "report.html").read_text()
    if method == "linear":
        plant, true = load_plant(out / "plant.toml"), load_plant(tmp_path / "machine.toml")
        found, expected = plant.system.response([20.0, 60.0]), true.system.response([20.0, 60.0])
        assert abs(found / expected - 1).max() < 0.1
    else:
        assert [tap["lag"] for tap in answer["taps"]] == [-3, -2, -1, 0, 1, 2, 3]


@pytest.mark.usefixtures("undrawn")
def test_identify_says_what_feedback_alone_teaches(stage_recording, tmp_path, capfd):
    """No f: a regression of u on y then finds minus the controller as soon as there is noise."""
    import numpy as np

    from ffl.machines import SimulatedMachine
    from ffl.recordings import write_recording
    from ffl.systems import Move, load_plant, moves

    plant = load_plant(tmp_path / "machine.toml")
    r = moves([Move(0.1, 0.05, 0.3, 3.0, 100.0)], 0.6, plant.sample_time)
    trial = SimulatedMachine(plant).run(r, np.zeros(len(r)), np.random.default_rng(0))
    write_recording(trial, tmp_path / "fed_back.csv")
    for file, told in ((stage_recording, False), (tmp_path / "fed_back.csv", True)):
        command = ["identify", "least_squares", "--data", str(file), "--n-ac", "3", "--n-c", "3"]
        assert execute([*command, "--out", str(tmp_path / "found")]) == 0
        assert ("minus the controller" in capfd.readouterr().out) is told


def test_identify_refuses_in_one_line(stage_recording, refuse):
    refuse("identify", "kernal", "--data", stage_recording, says="did you mean 'kernel'")
    refuse("identify", "kernel", "--data", "none.csv", says="no such file")
    twice = ("--data", stage_recording, "--data", stage_recording)
    refuse("identify", "kernel", *twice, says="give --data once")
    refuse("identify", "instrumental", "--data", stage_recording, says="give --model")


def test_diagnose_refuses_in_one_line(stage_recording, refuse, tmp_path):
    model = tmp_path / "model.toml"
    refuse("diagnose", stage_recording, says="--model")
    refuse("diagnose", "--model", model, says="recordings")
    refuse("diagnose", "--model", model, "none.csv", says="no such file")
    refuse("diagnose", "--model", "none.toml", stage_recording, says="no such file")
    validate = ("--validate", "none.csv")
    refuse("diagnose", "--model", model, stage_recording, *validate, says="no such file")
    refuse("diagnose", "--model", model, stage_recording, "--out", model, says="is a file")


def test_a_report_of_another_command_is_kept(stage_recording, refuse, tmp_path, capfd):
    """A second answer of the same kind takes its place; a learning run's report stays."""
    out = tmp_path / "found"
    identify = ["identify", "least_squares", "--data", str(stage_recording), "--out"]
    for _ in range(2):
        assert execute([*identify, str(out), "--n-ac", "3", "--n-c", "3"]) == 0
    capfd.readouterr()
    (out / "answer.json").unlink()
    page = (out / "report.html").read_text()
    refuse(*identify, out, says="holds the report of another command; give another --out")
    model = tmp_path / "model.toml"
    refuse("diagnose", "--model", model, stage_recording, "--out", out, says="another command")
    assert (out / "report.html").read_text() == page


def test_it_says_which_version_it_is(capsys):
    assert execute(["--version"]) == 0
    assert re.fullmatch(r"ffl \d+\.\d+\.\d+\S*\n", capsys.readouterr().out)

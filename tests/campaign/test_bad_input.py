"""Mistakes in a campaign and its files: exit code 2 and one line that says what, where and the mend."""

import json

import pytest

from ffl.campaign import load_campaign, run_campaign
from ffl.cli import execute


@pytest.fixture
def said(capfd, tmp_path, monkeypatch):
    """The one line on stderr of a command that must be refused and write nothing."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        before = sorted(tmp_path.rglob("*"))
        capfd.readouterr()
        assert execute([str(argument) for argument in arguments]) == 2
        captured = capfd.readouterr()
        assert len(captured.err.splitlines()) == 1
        assert captured.out == ""
        assert sorted(tmp_path.rglob("*")) == before
        return captured.err

    return run


def with_file_reference(path, keys):
    """The campaign at `path` with the reference of path.csv: 0.2 s, columns t and pos."""
    rows = [f"{k / 1000:.3f},{0.02 * max(0, min((k - 20) / 100, 1)):.6f}" for k in range(200)]
    (path.parent / "path.csv").write_text("\n".join(["t,pos", *rows]) + "\n")
    text = path.read_text()
    head, tail = text[: text.index("[reference]")], text[text.index("[[runs]]") :]
    path.write_text(f'{head}[reference]\nkind = "file"\nfile = "path.csv"\n{keys}\n{tail}')


def test_a_byte_order_mark_is_read_and_another_encoding_is_said(write_campaign, said):
    path = write_campaign()
    plain = path.read_bytes()
    path.write_bytes(b"\xef\xbb\xbf" + plain)
    assert execute(["check", str(path)]) == 0
    path.write_bytes("# für\n".encode("latin-1") + plain)
    assert "small.toml: not UTF-8 (byte 0xfc at position 3); save it as UTF-8" in said(
        "check", path
    )


def test_a_reference_longer_than_its_file_is_refused(write_campaign, said):
    path = write_campaign()
    with_file_reference(path, 'column = "pos"\nduration = 0.5')
    assert "reach beyond path.csv, which holds 0.2 s; shorten" in said("check", path.name)
    with_file_reference(path, 'column = "pos"\nduration = 0.2')
    assert execute(["check", path.name]) == 0


def test_a_missing_reference_column_is_named_with_those_that_are_there(write_campaign, said):
    path = write_campaign()
    with_file_reference(path, "")
    line = said("check", path.name)
    assert "reference.column = 'r': path.csv does not hold that column (there is t, pos)" in line


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "error = 1.0",
            "error = [1.0, 2.0]",
            "small.toml: runs[0] (derivatives): weights.error has 2",
        ),
        ("trials = 3", "trials = true", "trials = True: must be a whole number"),
        ("duration = 0.5", 'duration = "0.5"', "reference.duration = '0.5'"),
    ],
)
def test_what_only_a_run_finds_out_names_the_file_too(old, new, says, write_campaign, said):
    path = write_campaign()
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    assert says in said("run", path)


def test_a_basis_that_is_no_table_is_said_in_the_files_own_words(write_campaign, said):
    path = write_campaign()
    lines = path.read_text().splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("basis"))
    path.write_text("\n".join([*lines[:at], 'basis = "fir"', *lines[at + 1 :]]))
    assert "runs[0].basis = 'fir': give a list of tables" in said("check", path)


def test_a_folder_that_is_not_finished_is_not_run_again(write_campaign, said, tmp_path):
    run_campaign(load_campaign(write_campaign()), tmp_path / "done")
    results = json.loads((tmp_path / "done" / "results.json").read_text())
    results["runs"][0] |= {"status": "running", "error_norm": results["runs"][0]["error_norm"][:1]}
    (tmp_path / "done" / "results.json").write_text(json.dumps(results))
    line = said("rerun", "done")
    assert (
        "has 1 of 3 trials; finish it first: ffl run done/campaign.toml --out done --resume" in line
    )
    (tmp_path / "folder").mkdir()
    line = said("export", "done", "--run", "fir", "--format", "csv", "--out", "folder")
    assert "folder: is a folder; give a file for --out" in line


def bounded(basis, bounds):
    """Edits of the campaign: its run "derivatives" with another basis, and with bounds."""
    line = 'basis = [{ kind = "derivatives", orders = ["velocity", "acceleration"] }]\n'
    weights = "weights = { error = 1.0, feedforward = 1e-14 }\n"
    return line + weights, f"basis = [{basis}]\n{weights}constraints = {bounds}\n"


def test_bounds_that_exclude_one_another_are_found_beside_one_on_the_command(write_campaign, said):
    """Which commands the trial leaves is not known beforehand, so that bound is left out."""
    bounds = "{ feedforward = [1.0, 20.0], command = [-60.0, 60.0] }"
    path = write_campaign(bounded('{ kind = "fir", preview = 2, lag = 2 }', bounds))
    line = said("check", path)
    assert "constraints: no parameters meet the lower bound 1 on feedforward at t = 0 s" in line


def test_a_free_signal_may_have_bounds_without_zero(write_campaign, said):
    allowed = write_campaign(bounded('{ kind = "free" }', "{ feedforward = [0.5, 30.0] }"))
    assert execute(["check", str(allowed)]) == 0
    crossed = "{ feedforward = [1.0, 20.0], feedforward_rate = [1e6, 2e6] }"
    line = said("check", write_campaign(bounded('{ kind = "free" }', crossed)))
    assert "runs[0] (derivatives): constraints: no signal meets the bounds together" in line


@pytest.mark.parametrize(
    ("basis", "says"),
    [
        ('{ kind = "from_diagnosis", plant = "part.toml" }', "sound: 3 parameters\n"),
        ('{ kind = "from_diagnosis" }', "sound: 2 parameters and those of the model's effects\n"),
    ],
)
def test_a_step_file_is_checked_without_the_model_it_is_for(
    basis, says, write_campaign, tmp_path, capfd
):
    write_campaign()
    friction = '[[effects]]\nname = "coulomb_friction"\nparameters = { level = 1.0 }\n'
    (tmp_path / "part.toml").write_text((tmp_path / "model.toml").read_text() + friction)
    path = tmp_path / "step.toml"
    derivatives = '{ kind = "derivatives", orders = ["velocity", "acceleration"] }'
    path.write_text(f"basis = [{derivatives}, {basis}]\nweights = {{ error = 1.0 }}\n")
    assert execute(["check", str(path)]) == 0
    assert capfd.readouterr().out.endswith(says)


def test_an_effect_that_a_plant_cannot_have_is_found_by_check(said, tmp_path):
    path = tmp_path / "lag.toml"
    path.write_text(
        'name = "lag"\nsample_time = 0.001\n[plant]\nform = "zpk"\npoles = [0.4]\ngain = 0.6\n'
        '[[effects]]\nname = "coulomb_friction"\nparameters = { level = 3.0 }\n'
    )
    assert "lag.toml: effect coulomb_friction: plant lag has no moving mass" in said("check", path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[]", "not the results of 'ffl run'"),
        ("{", "not valid JSON"),
        ('{"schema": 1, "runs": []}', "campaign is missing or damaged"),
        ("run without a status", "runs[0].status is missing or damaged; run the campaign again"),
        ("run that is no table", "runs[0] is no table"),
    ],
)
def test_damaged_results_are_said_by_every_verb_that_reads_them(
    text, says, write_campaign, said, tmp_path
):
    run_campaign(load_campaign(write_campaign(trials=1)), tmp_path / "done")
    path = tmp_path / "done" / "results.json"
    results = json.loads(path.read_text())
    if text == "run without a status":
        del results["runs"][0]["status"]
        text = json.dumps(results)
    elif text == "run that is no table":
        text = json.dumps(results | {"runs": [3]})
    path.write_text(text)
    for verb in ("report", "inspect", "rerun"):
        line = said(verb, "done")
        assert "results.json: " in line
        assert says in line


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["new", "plant", "abc", "--out", "file"], "file: is a file; give a folder for --out"),
        (["init", "file/stage"], "file: is a file; give a folder"),
        (["challenge", "make", "--out", "a", "--truth", "file", "--seed", "1"], "for --truth"),
        (["challenge", "make", "--out", "file/a", "--truth", "b", "--seed", "1"], "for --out"),
        (["challenge", "make", "--out", "a", "--truth", "b", "--seed", "-1"], "seed = -1"),
        (
            ["challenge", "make", "--out", "a", "--truth", "b", "--seed", "1", "--jobs", "-2"],
            "jobs = -2 must be at least 1",
        ),
        (["challenge", "solve", "cases", "--out", "file"], "file: is a file"),
        (["challenge", "score", "cases", "a", "--truth", "b", "--out", "s"], "not valid JSON"),
        (["challenge", "score", "other", "a", "--truth", "b", "--out", "s"], "not the commitments"),
    ],
)
def test_outputs_and_numbers_that_cannot_be(arguments, says, said, tmp_path):
    (tmp_path / "file").write_text("taken")
    for name, text in (("cases", "{"), ("other", '{"root": "a"}')):
        (tmp_path / name / "case_0001").mkdir(parents=True)
        (tmp_path / name / "commitments.json").write_text(text)
        (tmp_path / name / "case_0001" / "plant.toml").write_text("")
        (tmp_path / name / "case_0001" / "fit_1.csv").write_text("")
    assert says in said(*arguments)


@pytest.mark.usefixtures("undrawn")
def test_a_report_does_not_write_below_a_file(write_campaign, said, tmp_path):
    run_campaign(load_campaign(write_campaign(trials=1)), tmp_path / "done")
    assert "is a file; give a folder" in said("report", "done", "--out", "model.toml/x.html")


FRICTION = '[[effects]]\nname = "coulomb_fritcion"\nparameters = { level = 1.0 }\n'


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("[machine]", f"{FRICTION}[machine]", "model.toml: effects[0]: unknown effect"),
        (
            "zeros = [-1.0]",
            "zeros = [[1.0, 2.0, 3.0]]",
            "plant.zeros[0]: List should have at most 2",
        ),
        (
            'form = "zpk"\nzeros = [0.98]\npoles = [0.75]',
            'form = "czpk"\nzeros = [-1.0, -2.0]\npoles = [-3.0]',
            "controller: more zeros than poles, so it needs the future; add poles",
        ),
    ],
)
def test_a_plants_mistake_names_its_file_and_a_key_that_is_there(
    old, new, says, write_campaign, said, tmp_path
):
    write_campaign()
    path = tmp_path / "model.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    line = said("check", "model.toml")
    assert "ffl: model.toml: " in line
    assert says in line


def test_a_campaign_says_which_plant_has_the_mistake_and_looks_once(write_campaign, said, tmp_path):
    path = write_campaign()
    machine = tmp_path / "machine.toml"
    machine.write_text(machine.read_text() + FRICTION)
    assert "small.toml: machine = 'machine.toml': effects[0]: unknown" in said("check", path)
    machine.unlink()
    assert said("check", "small.toml").rstrip().endswith("(looked in machine.toml)")


def test_a_plant_that_its_input_does_not_reach_is_named(said, tmp_path):
    (tmp_path / "dead.toml").write_text(
        'name = "dead"\nsample_time = 0.001\n[plant]\nform = "ss"\nA = [[0.9]]\nB = [0.0]\nC = [1.0]\n'
    )
    assert "dead.toml: plant: gain = 0.0 must be" in said("inspect", "dead.toml")

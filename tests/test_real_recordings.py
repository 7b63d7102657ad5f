"""benchmarks/real_recordings.py as far as it needs no recording."""

import importlib
import sys
from pathlib import Path

import pytest

from ffl.recordings import load_mapping
from ffl.systems import load_plant

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def script():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "benchmarks")
        yield importlib.import_module("real_recordings")


def test_every_plant_and_every_part_of_a_map_is_shipped(script):
    for case in script.CASES:
        assert load_plant(ROOT / "plants" / f"{case.plant}.toml").sample_time > 0
        parts = {part.name for part in load_mapping(case.mapping).recordings}
        for file in (*case.fit, *case.judge):
            _, _, part = file.partition("::")
            assert not part or part in parts, f"{case.name}: {file}"


def test_nothing_judges_what_it_was_fitted_to(script):
    assert len(script.KNOWN) == len(script.CASES)
    for case in script.CASES:
        assert not set(case.fit) & set(case.judge)


def test_the_command_is_the_one_that_the_report_gives(script, tmp_path, monkeypatch):
    monkeypatch.setenv("FFL_DATA", str(tmp_path))
    for file in ("DATA_EMPS.mat", "DATA_EMPS_PULSES.mat"):
        (tmp_path / "emps").mkdir(exist_ok=True)
        (tmp_path / "emps" / file).touch()
    said = [word.replace(str(tmp_path), "DATA") for word in script.KNOWN["emps"].arguments("OUT")]
    assert said == [
        "diagnose", "--model", "plants/emps.toml", "DATA/emps/DATA_EMPS.mat",
        "--validate", "DATA/emps/DATA_EMPS_PULSES.mat", "--map", "emps", "--out", "OUT", "--quiet",
    ]  # fmt: skip


def test_every_picture_belongs_to_recordings_and_stands_in_the_report(script):
    pictures = importlib.import_module("_real_pictures").PICTURES
    report = (ROOT / "reports" / "real_recordings.md").read_text()
    for file, (needs, _) in pictures.items():
        assert set(needs) <= set(script.KNOWN)
        assert f"({file})" in report


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [(["nope"], 2, "no recording 'nope'"), (["ced"], 2, "DATAUNIF.csv")],
)
def test_a_name_or_a_file_that_is_not_there(
    script, arguments, code, says, tmp_path, monkeypatch, capsys
):
    monkeypatch.setenv("FFL_DATA", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["real_recordings.py", *arguments])
    assert script.main() == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert says in err

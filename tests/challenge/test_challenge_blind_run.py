"""Make, seal, solve, score: with solvers whose score is known because they were built for it."""

import json
import math
import sys

import pytest

from ffl.challenge import Share, bars, find_cases, make, score, shipped_diagnosis, solve
from ffl.challenge.compose import COUNTS, compose
from ffl.challenge.physics import EFFECTS
from ffl.errors import InputError


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    root = tmp_path_factory.mktemp("challenge")
    make(root / "cases", root / "truth", seed=4, fraction=0.006)
    return root


def truth_of(root, case):
    return json.loads((root / "truth" / f"{case.name}.json").read_text())


def perfect(root):
    def run(case, out):
        truth = truth_of(root, case)
        verdict = truth["verdicts"][0]
        effects = [
            {
                "name": e["name"],
                "location": e["location"],
                "confidence": 0.9,
                "parameters": {
                    k: {"value": v, "std_error": 0.01}
                    for k, v in e["parameters"].items()
                    if isinstance(v, float)
                },
            }
            for e in truth["effects"]
        ]
        if truth["kind"] in ("outside", "weak", "fault"):
            effects = []
        floors = list(truth["oracle"].values())
        mean = {
            k: math.sqrt(sum(f[k] ** 2 for f in floors) / len(floors))
            for k in (floors[0] if floors else {})
        }
        component = truth["effects"][0]["location"] if truth["effects"] else None
        return {
            "verdict": verdict,
            "effects": effects,
            "location": {"component": component, "depends_on": truth.get("depends_on", [])},
            "validation": mean,
        }

    return run


def alarmist(case, out):
    return {
        "verdict": "explained",
        "effects": [{"name": "saturation", "location": "actuator", "confidence": 0.99}],
    }


def test_the_composition_is_the_one_of_the_contract():
    plans = compose(1)
    kinds = [p.kind for p in plans]
    assert {k: kinds.count(k) for k in COUNTS} == COUNTS
    singles = [p for p in plans if p.kind == "single"]
    for effect in EFFECTS:
        assert sum(p.effects == (effect,) for p in singles) == 6
    assert all(
        len({EFFECTS[n].family for n in p.effects}) == len(p.effects)
        for p in plans
        if p.kind == "several"
    )
    tenth = [p.kind for p in compose(1, 0.1)]
    assert {k: tenth.count(k) for k in COUNTS} == {k: math.ceil(n / 10) for k, n in COUNTS.items()}
    assert compose(1) == plans != compose(2)


def test_case_names_and_files_tell_nothing(made):
    cases = find_cases(made / "cases")
    assert len(cases) == len(compose(4, 0.006))
    for case in cases:
        assert case.name.startswith("case_")
        text = case.plant.read_text()
        assert not any(name in text for name in EFFECTS)


def test_a_perfect_solver_scores_full_marks(made, tmp_path):
    assert solve(made / "cases", tmp_path / "a", solver=perfect(made)) == len(compose(4, 0.006))
    result = score(made / "cases", tmp_path / "a", made / "truth", tmp_path / "s")
    assert result.seed == 4
    assert result.f1_micro == 1.0
    assert result.shares["false alarms, nothing missing"].k == 0
    near = "held-out error within 1.2 of the "
    for name in (
        "exact set, single", "exact set, several", "outside: unnamed, right variables",
        near + "oracle's, single", near + "noise, several",
    ):  # fmt: skip
        assert result.shares[name].value == 1.0
    assert result.noise_ratio[0] == pytest.approx(1.0)
    assert 0.8 < result.nrmse_ratio[0] <= 1.0  # the oracle has to learn its numbers
    assert result.parameter_errors
    assert all(m == 0 for _, m, _ in result.parameter_errors.values())
    missed = [b.what for b in bars(result) if b.met is False]
    assert missed == ["stated confidences of 85 to 95 %"]  # 0.9 stated and always right
    document = json.loads((tmp_path / "s" / "score.json").read_text())
    assert document["shares"]["exact set, single"]["n"] == result.shares["exact set, single"].n
    text = (tmp_path / "s" / "score.md").read_text()
    assert document["root"] in text
    assert "nan" not in text


def test_an_alarmist_is_found_out(made, tmp_path):
    solve(made / "cases", tmp_path / "a", solver=alarmist)
    result = score(made / "cases", tmp_path / "a", made / "truth", tmp_path / "s")
    assert result.shares["false alarms, nothing missing"].value == 1.0
    assert result.shares["fault: not called physics"].k == 0
    assert result.shares["outside: explained by a wrong name"].value == 1.0
    assert result.calibration[-1][2] == pytest.approx(0.99)
    assert result.confusion.sum() == len(result.rows)
    assert result.confusion[:, result.confusion_columns.index("saturation")].sum() == len(
        result.rows
    )


def test_solve_resumes_and_survives_a_solver_that_breaks(made, tmp_path):
    calls = []

    def breaks(case, out):
        calls.append(case.name)
        raise RuntimeError("out of ideas")

    total = len(find_cases(made / "cases"))
    assert solve(made / "cases", tmp_path / "a", solver=breaks) == total
    (tmp_path / "a" / "case_0001" / "solved.json").unlink()
    calls.clear()
    seen = []
    assert solve(made / "cases", tmp_path / "a", 2, breaks, lambda k, n: seen.append((k, n))) == 1
    assert calls == ["case_0001"]
    assert seen == [(1, 1)]
    result = score(made / "cases", tmp_path / "a", made / "truth", tmp_path / "s")
    assert result.shares["answered"].k == 0
    answer = json.loads((tmp_path / "a" / "case_0001" / "answer.json").read_text())
    assert answer["message"] == "RuntimeError: out of ideas"


@pytest.mark.parametrize(
    ("script", "verdict", "message"),
    [
        ('print(\'{"verdict": "explained"}\')', "explained", None),
        ("import sys; sys.exit('plant.toml: odd')", "failed", "plant.toml: odd"),
        ("import sys; print('bad', file=sys.stderr); sys.exit(2)", "refused", "bad"),
        ("print('hello')", "failed", "stdout is not JSON"),
        ("import time; time.sleep(30)", "failed", "more than 1 s"),
    ],
)
def test_the_shipped_command_is_run_as_a_user_would(script, verdict, message, made, tmp_path):
    run = shipped_diagnosis(1.0, (sys.executable, "-S", "-c", script))
    answer = run(find_cases(made / "cases")[0], tmp_path)
    assert answer["verdict"] == verdict
    assert answer.get("message") == message


def test_a_truth_or_a_recording_that_was_changed_is_refused(made, tmp_path):
    (tmp_path / "a").mkdir()
    for path in (
        made / "truth" / "case_0002.json",
        made / "cases" / "case_0002" / "plant.toml",
        made / "truth" / "challenge.seed",
    ):
        text = path.read_text()
        path.write_text(text + " ")
        with pytest.raises(InputError, match="committed to"):
            score(made / "cases", tmp_path / "a", made / "truth", tmp_path / "s")
        path.write_text(text)
    path = made / "cases" / "commitments.json"
    text = path.read_text()
    path.write_text(text.replace('"truth": "', '"truth": "0', 1))
    with pytest.raises(InputError, match="published root hash"):
        score(made / "cases", tmp_path / "a", made / "truth", tmp_path / "s")
    path.write_text(text)
    hidden = made / "truth" / "case_0001.json"
    hidden.rename(hidden.with_suffix(".away"))
    with pytest.raises(InputError, match="is missing"):
        score(made / "cases", tmp_path / "a", made / "truth", tmp_path / "s")
    hidden.with_suffix(".away").rename(hidden)
    with pytest.raises(InputError, match="no commitments"):
        score(tmp_path, tmp_path / "a", made / "truth", tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_make_resumes_and_keeps_truth_apart(made, tmp_path):
    before = (made / "truth" / "case_0001.json").stat().st_mtime_ns
    make(made / "cases", made / "truth", seed=4, fraction=0.006)
    assert (made / "truth" / "case_0001.json").stat().st_mtime_ns == before
    with pytest.raises(InputError, match="must not lie in the folder of the cases"):
        make(tmp_path, tmp_path / "truth", 1, 0.01)
    with pytest.raises(InputError, match="fraction"):
        make(tmp_path / "a", tmp_path / "b", 1, 0.0)
    with pytest.raises(InputError, match="no case"):
        find_cases(tmp_path)
    (tmp_path / "c" / "x").mkdir(parents=True)
    (tmp_path / "c" / "x" / "plant.toml").write_text("")
    with pytest.raises(InputError, match="no fit_"):
        find_cases(tmp_path / "c")
    with pytest.raises(InputError, match="jobs"):
        solve(made / "cases", tmp_path / "d", jobs=0)


def test_clopper_pearson_by_its_known_values():
    assert Share(0, 150).interval[1] == pytest.approx(1 - 0.025 ** (1 / 150))
    assert Share(10, 10).interval[0] == pytest.approx(0.025**0.1)
    low, high = Share(5, 10).interval
    assert (low, high) == pytest.approx((0.1871, 0.8129), abs=1e-4)


def test_a_challenge_is_not_gone_on_with_under_another_seed(made, tmp_path):
    """Its cases are those of the first seed, so that of the second would be published falsely."""
    published = (made / "cases" / "commitments.json").read_text()
    for seed, fraction in ((5, 0.006), (4, 0.012)):
        with pytest.raises(
            InputError, match=r"challenge\.seed: this challenge was begun with another"
        ):
            make(made / "cases", made / "truth", seed, fraction)
    again = make(made / "cases", made / "truth", 4, 0.006)
    assert (made / "cases" / "commitments.json").read_text() == published
    assert again["root"] == json.loads(published)["root"]
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "case_0001.json").write_text("{}")
    with pytest.raises(InputError, match="holds truths but no challenge"):
        make(tmp_path / "cases", tmp_path / "truth", 4, 0.006)
    (tmp_path / "truth" / "challenge.seed").write_text("{")
    with pytest.raises(InputError, match="not valid JSON"):
        make(tmp_path / "cases", tmp_path / "truth", 4, 0.006)

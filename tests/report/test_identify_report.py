"""What `ffl identify` says with its answer: on stdout, in answer.json and on the page."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from ffl.cli import execute
from ffl.identify import LeastSquaresInverse
from ffl.identify.inverse import pull_of_output_noise
from ffl.recordings import Recording, write_recording
from ffl.report import identify as module


def written(path, n_samples=400, **signals):
    rng = np.random.default_rng(5)
    u = rng.standard_normal(n_samples)
    y = lfilter([0.8, -1.32, 0.4], [1.0, -1.2, 0.35], u) + 0.05 * rng.standard_normal(n_samples)
    write_recording(Recording.from_signals(1e-3, **{"u": u, "y": y, **signals}), path)
    return str(path)


def test_what_speaks_against_a_posterior_is_said_in_all_three_places(tmp_path, capfd):
    data, out = written(tmp_path / "a.csv"), tmp_path / "found"
    command = ["identify", "bayes", "--data", data, "--n-ac", "6", "--n-c", "2", "--out", str(out)]
    assert execute(command) == 0
    answer = json.loads((out / "answer.json").read_text())
    (note,) = answer["notes"]
    assert "9 taps leave" in note
    assert [tap["lag"] for tap in answer["taps"]] == list(range(-6, 3))
    assert answer["noise_ratio"] > 2
    assert answer["effective_sample_size"] > 100
    assert answer["lack_of_fit_p"] < 1e-3
    assert f"note: {note}" in capfd.readouterr().out
    assert note in (out / "report.html").read_text()


def test_a_sound_answer_carries_no_note(tmp_path, capfd):
    data = written(tmp_path / "a.csv", 1500)
    command = ["identify", "bayes", "--data", data, "--n-ac", "30", "--n-c", "19", "--json"]
    assert execute(command) == 0
    assert json.loads(capfd.readouterr().out)["notes"] == []


def test_a_search_that_did_not_end_is_said():
    stopped = SimpleNamespace(evidence_=SimpleNamespace(status="stopped at the evaluation limit"))
    assert "stopped at the evaluation limit" in module._unsettled(stopped)[0]
    stopped.evidence_.status = "converged"
    assert module._unsettled(stopped) == module._unsettled(SimpleNamespace()) == ()


@pytest.mark.usefixtures("undrawn")
def test_a_residual_that_is_not_white_is_said_with_a_linear_model(tmp_path, capfd):
    rng = np.random.default_rng(1)
    u = rng.standard_normal(800)
    y = lfilter([0.0, 0.1, 0.05], [1.0, -1.7, 0.85], u) + 0.01 * rng.standard_normal(800)
    data = written(tmp_path / "a.csv", u=u, y=y, n_samples=800)
    assert execute(["identify", "linear", "--data", data, "--order", "1"]) == 0
    assert "answers to the input" in capfd.readouterr().out


@pytest.mark.parametrize("method", ["least_squares", "kernel", "rational", "bayes"])
def test_a_command_that_is_not_recorded_is_named(method, tmp_path, capfd):
    r = np.random.default_rng(0).standard_normal(400)
    data = written(tmp_path / "nou.csv", u=None, r=r)
    assert execute(["identify", method, "--data", data]) == 2
    error = capfd.readouterr().err
    assert "nou.csv: the command u is not recorded" in error
    assert "mapping" in error


@pytest.mark.parametrize("order", ["0", "-2"])
def test_an_order_below_one_is_bad_input(order, tmp_path, capfd):
    data = written(tmp_path / "a.csv")
    assert execute(["identify", "linear", "--data", data, "--order", order]) == 2
    assert f"order {order} is not 1 or more" in capfd.readouterr().err


@pytest.mark.parametrize("method", ["least_squares", "kernel", "rational"])
@pytest.mark.parametrize(("noise", "said"), [(0.05, True), (1e-5, False)])
def test_noise_of_y_that_outweighs_the_stated_errors_is_said(method, noise, said, tmp_path, capfd):
    rng = np.random.default_rng(5)
    u = rng.standard_normal(3000)
    clean = lfilter(0.2 * np.poly([0.5, -0.3]), np.poly([0.9, 0.7, 0.2]), u)
    y = clean + noise * clean.std() * rng.standard_normal(3000)
    data = written(tmp_path / "a.csv", 3000, u=u, y=y)
    command = ["identify", method, "--data", data, "--n-ac", "20", "--n-c", "20", "--json"]
    assert execute(command) == 0
    notes = json.loads(capfd.readouterr().out)["notes"]
    assert any("y is taken as free of noise" in note for note in notes) == said


def test_the_bias_that_noise_of_y_brings_is_foretold():
    """12 noises of y: the mean error of the taps, in stated standard errors, is what is said of it."""
    u = np.random.default_rng(1).standard_normal(1000)
    clean = lfilter([0.0, 1.0], [1.0, -0.5], u)  # u(t) = y(t+1) - 0.5 y(t)
    off, told = [], []
    for seed in range(12):
        y = clean + 0.2 * np.random.default_rng(seed + 10).standard_normal(1000)
        found = LeastSquaresInverse(2, 2).fit(Recording.from_signals(1e-3, u=u, y=y)).inverse_
        truth = np.array([0.0, 1.0, -0.5, 0.0, 0.0])
        off.append((found.theta - truth) / found.standard_deviation)
        told.append(pull_of_output_noise(found, 1000))
    assert np.mean(told) > 5
    assert np.mean(told) == pytest.approx(np.abs(np.mean(off, axis=0)).max(), rel=0.15)


@pytest.mark.parametrize("method", ["linear", "least_squares", "kernel", "rational", "bayes"])
@pytest.mark.parametrize("still", ["u", "y"])
def test_a_constant_signal_is_refused_by_every_method(method, still, tmp_path, capfd):
    data = written(tmp_path / "still.csv", **{still: np.full(400, 0.5)})
    assert execute(["identify", method, "--data", data]) == 2
    error = capfd.readouterr().err
    assert "still.csv: " in error
    assert "constant" in error


def test_a_free_signal_is_no_basis_to_identify(tmp_path, capfd):
    basis, data = tmp_path / "free.toml", written(tmp_path / "a.csv")
    basis.write_text('basis = [{ kind = "free" }]\nweights = { error = 1.0 }\n')
    command = ["identify", "instrumental", "--data", data, "--model", "emps", "--basis", str(basis)]
    assert execute(command) == 2
    assert "free.toml: basis kind 'free' has no parameters" in capfd.readouterr().err


@pytest.mark.usefixtures("undrawn")
def test_a_recording_too_short_for_any_order_is_bad_input(tmp_path, capfd):
    """Of 28 samples no block can be left out that would still judge; 36 will do."""
    data = written(tmp_path / "a.csv", n_samples=28)
    assert execute(["identify", "linear", "--data", data]) == 2
    said = capfd.readouterr().err
    assert "a.csv: 28 samples are too few" in said
    assert "order 1 needs 36; record longer\n" in said
    data = written(tmp_path / "b.csv", n_samples=60)
    assert execute(["identify", "linear", "--data", data, "--order", "4"]) == 2
    assert "order 4 needs 90; record longer or ask for a lower" in capfd.readouterr().err
    assert execute(["identify", "linear", "--data", data]) == 0


def test_help_says_that_an_instrumental_basis_file_holds_weights(capfd):
    assert execute(["identify", "--help"]) == 0
    said = " ".join(capfd.readouterr().out.replace("│", " ").split())
    assert "TOML with `basis` and `weights`" in said


@pytest.mark.usefixtures("undrawn")
def test_a_load_stands_in_the_answer_with_its_standard_error_or_not_at_all(tmp_path, capfd):
    rng = np.random.default_rng(5)
    u = rng.standard_normal(800)
    clean = lfilter([0.8, -0.4], [1.0, -1.2, 0.35], u + 0.3)
    for offset in (True, False):
        y = clean if offset else lfilter([0.8, -0.4], [1.0, -1.2, 0.35], u)
        data = written(tmp_path / "a.csv", 800, u=u, y=y + 0.05 * rng.standard_normal(800))
        command = ["identify", "linear", "--data", data, "--order", "2", "--json"]
        assert execute([*command, "--out", str(tmp_path / "out")]) == 0
        answer = json.loads(capfd.readouterr().out)
        assert answer["offset_std_error"] > 0
        assert ("constant_load" in answer) == offset
        assert ("constant_load" in (tmp_path / "out" / "plant.toml").read_text()) == offset
        if offset:
            assert answer["constant_load_std_error"] < 0.1 * answer["constant_load"]


@pytest.mark.usefixtures("undrawn")
def test_the_band_of_a_search_says_what_it_leaves_out(tmp_path):
    data, out = written(tmp_path / "a.csv", 800), tmp_path / "found"
    for method in ("rational", "least_squares"):
        command = ["identify", method, "--data", data, "--n-ac", "6", "--n-c", "6"]
        assert execute([*command, "--out", str(out)]) == 0
        said = "the search is not in it" in (out / "report.html").read_text()
        assert said == (method == "rational")

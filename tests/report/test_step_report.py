"""`ffl step`: known parameters come back, also where the recording begins in motion."""

import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffl.bases import make_basis
from ffl.cli import execute
from ffl.errors import InputError
from ffl.learn import Constraints, Weights
from ffl.learn.step import _GoingOn, feedforward_for, learn_from_recording
from ffl.recordings import Recording, read_recording, write_recording
from ffl.systems import Controller, Plant, Zpk, closed_loop, load_plant

ROOT = Path(__file__).resolve().parents[2]
T = 1e-3


def servo(mass, viscous=0.0):
    """EMPS's servo on a carriage, held in continuous time by a zero-order hold with friction."""
    model = load_plant("emps")
    if viscous == 0.0:
        gain = T**2 / (2 * mass)
        return Plant("carriage", Zpk([-1.0], [1.0, 1.0], gain, T), model.controller)
    p = np.exp(-viscous / mass * T)
    # x = 1/(b s (tau s + 1)) under a zero-order hold, tau = mass/viscous.
    tau = mass / viscous
    b1, b0 = T + tau * (p - 1), tau * (1 - p) - T * p
    system = Zpk([-b0 / b1], [1.0, p], b1 / viscous, T)
    return Plant("carriage", system, model.controller)


def motion(n=6000):
    t = np.arange(n) * T
    return 0.1 * (1 - np.cos(2 * np.pi * 0.5 * t)) * (1 - np.exp(-2 * t)) ** 4


def recorded(plant, reference, first=0, feedforward=None, noise=0.0, seed=0, load=None):
    f = np.zeros(len(reference)) if feedforward is None else feedforward
    v = noise * np.random.default_rng(seed).standard_normal(len(reference))
    loop = closed_loop(plant.system, plant.controller).system
    w = 0 * f if load is None else load
    y, u = loop.filter(np.column_stack([reference, f, w, v])).T
    t = np.arange(len(reference)) * T
    whole = Recording(t, reference, f, u, y, load, sample_time=T)
    return whole[first : len(reference)]


BASIS = [{"kind": "derivatives", "orders": ["acceleration", "velocity"]}]


@pytest.mark.parametrize("first", [0, 1700])
def test_mass_and_damping_of_a_simulated_carriage(first):
    recording = recorded(servo(90.0, 300.0), motion(), first, noise=1e-8)
    step = learn_from_recording(
        load_plant("emps"), make_basis(BASIS, T), recording, Weights(1.0, 1e-20)
    )
    mass, viscous = step.theta + step.servo
    assert mass == pytest.approx(90.0, rel=0.025)
    assert viscous == pytest.approx(300.0, rel=0.02)
    assert np.linalg.norm(step.predicted) < 1e-2 * np.linalg.norm(step.error - step.start)
    assert step.report.kkt_residual < 1e-10


def test_the_next_trial_is_better_and_teaches_the_rest():
    plant, reference = servo(90.0, 300.0), motion()
    basis, model = make_basis(BASIS, T), load_plant("emps")
    first = recorded(plant, reference)
    step = learn_from_recording(model, basis, first, Weights(1.0, 1e-20))
    second = recorded(plant, reference, feedforward=step.feedforward)
    assert np.linalg.norm(second.error) < 0.01 * np.linalg.norm(first.error)
    again = learn_from_recording(model, basis, second, Weights(1.0, 1e-20), previous=step.theta)
    assert not any("injection" in note for note in again.notes)
    mass, viscous = again.theta + again.servo
    assert mass == pytest.approx(
        90.15, rel=1e-3
    )  # b T/2 = 0.15 kg: the held force is half a sample late
    assert viscous == pytest.approx(300.0, rel=2e-3)


def test_a_step_that_corrects_more_than_noise_says_that_its_standard_errors_do_not_tell():
    """Model right but for 40 N s/m on 5 kg: the first mass is off by 200 of its standard errors."""
    controller = Controller.of_error(Zpk([np.exp(-16.755 * T)], [np.exp(-301.59 * T)], 6.6e4, T))
    model = Plant("stage", Zpk([-1.0], [1.0, 1.0], T**2 / 10, T), controller)
    machine = replace(model, system=servo(5.0, 40.0).system)
    basis, reference, theta = make_basis(BASIS, T), motion(2000), None
    f, off, notes = np.zeros(2000), [], []
    mass = 5.0 + 40.0 * T / 2  # damping acts half a sample late under the hold
    for number in range(4):
        recording = recorded(machine, reference, feedforward=f, noise=3e-7, seed=number)
        step = learn_from_recording(model, basis, recording, Weights(), previous=theta)
        theta, f = step.theta, step.feedforward
        off.append(abs(theta[0] - mass) / step.std_error[0])
        notes.append(" ".join(step.notes))
    assert off[0] > 100
    assert "standard errors are those of noise alone: this step moved " in notes[0]
    assert off[-1] < 10
    assert theta[0] == pytest.approx(mass, rel=1e-3)
    assert notes[-1] == ""


def test_a_check_is_foretold_from_the_feedforward_that_it_ran_with():
    """Recorded without feedforward, with that of the step before, with another's, and with pulses
    beside: the next one has the basis with the new parameters, once, and the pulses."""
    plant, basis, other = servo(90.0, 300.0), make_basis(BASIS, T), -0.5 * motion()
    previous, theta = np.array([80.0, 200.0]), np.array([92.0, 290.0])
    phi = _GoingOn(basis).regressors(other)
    pulses = 20.0 * (np.arange(len(other)) % 1500 < 200)
    for used in (0.0 * previous, previous, np.array([60.0, 500.0])):
        check = recorded(plant, other, feedforward=phi @ used)
        following = feedforward_for(basis, check, theta, previous)
        np.testing.assert_allclose(following, phi @ theta, atol=1e-6 * np.abs(phi @ theta).max())
    for used in (0.0 * previous, previous):
        check = recorded(plant, other, feedforward=phi @ used + pulses)
        following = feedforward_for(basis, check, theta, previous)
        np.testing.assert_allclose(following, phi @ theta + pulses, rtol=1e-9, atol=1e-9)


def test_of_a_feedforward_of_an_earlier_basis_only_what_the_new_one_cannot_give_stays():
    """It ran with friction and a lag of the acceleration, which the new basis lacks: the force it gave to
    the acceleration must not count twice."""
    plant, basis, other = servo(90.0, 300.0), make_basis(BASIS, T), -0.5 * motion()
    previous, theta = np.array([80.0, 200.0]), np.array([92.0, 290.0])
    phi = _GoingOn(basis).regressors(other)
    for velocity in (0.0, 0.5):
        richer = make_basis([*BASIS, {"kind": "friction", "velocity": velocity}], T)
        f = _GoingOn(richer).regressors(other) @ np.array([90.0, 300.0, 20.0])
        left = f - phi @ np.linalg.lstsq(phi, f, rcond=None)[0]
        following = feedforward_for(basis, recorded(plant, other, feedforward=f), theta, previous)
        np.testing.assert_allclose(following, phi @ theta + left, atol=1e-6 * np.abs(f).max())


@pytest.mark.usefixtures("undrawn")
def test_a_check_whose_feedforward_is_not_of_the_basis_is_noted(files, tmp_path):
    pulses = 20.0 * (np.arange(3000) % 1500 < 200)
    check = recorded(servo(90.0, 300.0), -0.5 * motion(3000), feedforward=pulses)
    write_recording(check, tmp_path / "check.csv")
    assert execute([*files, "--check", "check.csv", "--out", "one"]) == 0
    answer = json.loads((tmp_path / "one" / "answer.json").read_text())
    (said,) = [note for note in answer["notes"] if "not of the basis" in note]
    assert "check.csv: 1 of the norm of its f" in said
    assert said in (tmp_path / "one" / "report.html").read_text()


def test_a_known_injection_is_not_learned():
    reference = motion()
    pulses = 20.0 * (np.arange(len(reference)) % 1500 < 200)
    basis, model = make_basis(BASIS, T), load_plant("emps")
    plain = recorded(servo(95.1), reference)
    pushed = recorded(servo(95.1), reference, feedforward=pulses)
    one = learn_from_recording(model, basis, plain, Weights(1.0, 1e-20))
    other = learn_from_recording(model, basis, pushed, Weights(1.0, 1e-20))
    np.testing.assert_allclose(other.theta, one.theta, rtol=1e-6)
    assert "known injection" in other.notes[0]


def test_a_known_load_is_not_learned():
    reference, basis, model = motion(), make_basis(BASIS, T), load_plant("emps")
    load = 30.0 * np.sin(2 * np.pi * 0.7 * np.arange(len(reference)) * T)
    plain = recorded(servo(95.1), reference)
    one = learn_from_recording(model, basis, plain, Weights(1.0, 1e-20))
    loaded = recorded(servo(95.1), reference, load=load)
    other = learn_from_recording(model, basis, loaded, Weights(1.0, 1e-20))
    np.testing.assert_allclose(other.theta, one.theta, rtol=1e-6)
    broken = replace(loaded, d=np.where(np.arange(len(load)) == 7, np.nan, load))
    with pytest.raises(InputError, match="column d, row 8 is not a number"):
        learn_from_recording(model, basis, broken, Weights(1.0, 1e-20))


def test_the_feedforward_of_a_cut_out_motion_has_no_spike():
    """A reference that is held at its end asks for its velocity to vanish within one sample."""
    recording = recorded(servo(90.0, 300.0), motion(), first=2500)[: 6000 - 2500 - 400]
    assert abs(recording.r[-1] - recording.r[-2]) > 1e-5
    step = learn_from_recording(
        load_plant("emps"), make_basis(BASIS, T), recording, Weights(1.0, 1e-20)
    )
    inner = np.abs(step.feedforward[5:-5]).max()
    assert np.abs(step.feedforward).max() < 1.05 * inner


def test_standard_errors_cover_the_truth():
    """White sensor noise: the spread of theta over noises is what the standard error says."""
    basis, model, reference = make_basis(BASIS, T), load_plant("emps"), motion(3000)
    thetas, said = [], []
    for seed in range(40):
        recording = recorded(servo(95.1), reference, noise=1e-4, seed=seed)
        step = learn_from_recording(model, basis, recording, Weights(1.0, 1e-20))
        thetas.append(step.theta)
        said.append(step.std_error)
    ratio = np.mean(said, axis=0) / np.std(thetas, axis=0)
    assert np.all((ratio > 0.7) & (ratio < 2.2))


def test_a_one_degree_servo_does_nothing_of_its_own():
    controller = Controller.of_error(Zpk([0.98], [0.75], 5e5, T))
    plant = Plant("stage", Zpk([-1.0], [1.0, 1.0], 5e-8, T), controller)
    step = learn_from_recording(
        plant, make_basis(BASIS, T), recorded(plant, motion()), Weights(1.0, 1e-20)
    )
    assert np.all(step.servo == 0)
    assert step.theta[0] == pytest.approx(10.0, rel=1e-3)


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_recording(recorded(servo(90.0, 300.0), motion(3000)), tmp_path / "trial.csv")
    (tmp_path / "basis.toml").write_text(
        'basis = [{ kind = "derivatives", orders = ["acceleration", "velocity"] }]\n'
        "weights = { error = 1.0, feedforward = 1e-20 }\n[documented]\nacceleration = 90.0\n"
    )
    return ["step", "--model", "emps", "--basis", "basis.toml", "--trial", "trial.csv"]


def test_step_writes_the_next_feedforward_and_its_state(files, tmp_path, capfd):
    assert execute([*files, "--out", "one", "--json"]) == 0
    answer = json.loads(capfd.readouterr().out)
    assert abs(answer["documented"]["acceleration"]["relative"]) < 0.025
    names = {path.name for path in (tmp_path / "one").iterdir()}
    assert names == {"feedforward.csv", "state.json", "answer.json", "report.html"}
    table = np.loadtxt(tmp_path / "one" / "feedforward.csv", delimiter=",", skiprows=1)
    state = json.loads((tmp_path / "one" / "state.json").read_text())
    assert state["trial"] == 1
    basis = make_basis(BASIS, T)
    f = basis.regressors(table[:, 1]) @ np.array(state["theta"])
    np.testing.assert_allclose(table[:-1, 2], f[:-1], rtol=1e-9, atol=1e-7)
    # The next trial ran with that feedforward; the step after it starts from the state.
    write_recording(
        recorded(servo(90.0, 300.0), table[:, 1], feedforward=table[:, 2]), tmp_path / "trial.csv"
    )
    assert execute([*files, "--state", "one/state.json", "--out", "two", "--json"]) == 0
    following = json.loads(capfd.readouterr().out)
    assert following["trial"] == 2
    assert following["error_norm"] < 0.1 * answer["error_norm"]


def test_a_model_without_effects_foretells_without_them(files, tmp_path):
    assert execute([*files, "--check", "trial.csv", "--out", "one"]) == 0
    page = (tmp_path / "one" / "report.html").read_text()
    assert "Foretold by the model" in page
    assert "with its effects" not in page


def test_with_effects_the_headline_is_what_they_leave(files, tmp_path):
    """Friction that the basis lacks: the linear part, which the step learns with, does not foretell it."""
    text = (ROOT / "plants" / "emps.toml").read_text()
    friction = '[[effects]]\nname = "coulomb_friction"\nparameters = { level = 20.0 }\n'
    (tmp_path / "rubs.toml").write_text(f"{text}\n{friction}")
    assert execute([*files, "--model", "rubs.toml", "--out", "one"]) == 0
    answer = json.loads((tmp_path / "one" / "answer.json").read_text())
    after = answer["foretold"][0]["after"]
    assert after > 2 * answer["predicted_error_norm"] / np.sqrt(3000)
    facts = (tmp_path / "one" / "report.html").read_text().split('class="facts"')[1][:800]
    assert f"{after:.3g}</span>" in facts
    assert "next error foretold with effects, RMS [m]" in facts
    assert "predicted next error" not in facts


@pytest.mark.usefixtures("undrawn")
def test_what_is_documented_as_zero_has_no_relative_error(files, tmp_path, capfd):
    path = tmp_path / "basis.toml"
    path.write_text(path.read_text() + "velocity = 0.0\n")
    assert execute([*files, "--out", "one", "--json"]) == 0
    told = json.loads(capfd.readouterr().out)["documented"]["velocity"]
    assert told["documented"] == 0.0
    assert told["learned"] == pytest.approx(300.0, rel=0.02)
    assert "relative" not in told
    assert execute([*files, "--out", "two"]) == 0
    assert re.search(r"velocity: documented 0, learned 2\d\d\S* \(-\)", capfd.readouterr().out)


@pytest.mark.parametrize(
    ("file", "old", "new", "says"),
    [
        ("basis.toml", "acceleration =", "mass =", "documented.mass: not a parameter"),
        ("basis.toml", "weights", "wieghts", "unknown key 'wieghts'"),
        ("basis.toml", "error = 1.0", "error = 0.0", "weights.error = 0 must be positive"),
        (
            "basis.toml",
            "error = 1.0",
            "error = [1.0, 2.0]",
            "basis.toml: weights.error has 2 values",
        ),
        ("basis.toml", 'kind = "derivatives"', 'kind = "derivates"', "did you mean 'derivatives'"),
        ("trial.csv", "0.001,", "nan,", "column t"),
        ("trial.csv", "t,r,", "t,x,", "reference r is missing"),
    ],
)
def test_mistakes_write_nothing(file, old, new, says, files, tmp_path, capfd):
    path = tmp_path / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    assert execute([*files, "--out", "one"]) == 2
    captured = capfd.readouterr()
    assert len(captured.err.splitlines()) == 1
    assert says in captured.err
    assert not (tmp_path / "one").exists()


@pytest.mark.parametrize(
    ("state", "says"),
    [
        ("{}", "not a state that 'ffl step' wrote (there is no 'schema'); give its state.json"),
        ("not json", "not a state"),
        ('{"schema": 1, "names": ["mass"], "theta": [1.0], "trial": 1}', "not those of the basis"),
        (
            '{"schema": 1, "names": ["acceleration", "velocity"], "theta": [1.0], "trial": 1}',
            "give 2 finite numbers",
        ),
    ],
)
def test_a_wrong_state_is_refused(state, says, files, tmp_path, capfd):
    (tmp_path / "state.json").write_text(state)
    assert execute([*files, "--state", "state.json", "--out", "one"]) == 2
    assert says in capfd.readouterr().err
    assert not (tmp_path / "one").exists()


OBF = 'basis = [{ kind = "obf", poles = [0.3], outside = [1.2] }]\nweights = { error = 1.0 }\n'
FRICTION = 'basis = [{ kind = "friction", velocity = 0.01 }]\nweights = { error = 1.0 }\n'


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("first", "then", "says"),
    [
        (OBF, OBF.replace("0.3", "0.95"), "basis[0].poles[0] is not that of the basis file"),
        (OBF, OBF.replace("0.3", "0.3, 0.4"), "are not those of the basis"),
        (FRICTION, FRICTION.replace("0.01", "0.02"), "basis[0].velocity is not that of the basis"),
        (FRICTION, FRICTION.replace(", velocity = 0.01", ""), "basis[0].velocity is not that"),
    ],
)
def test_a_state_of_other_basis_numbers_is_refused(first, then, says, files, tmp_path, capfd):
    (tmp_path / "basis.toml").write_text(first)
    assert execute([*files, "--out", "one"]) == 0
    state = ["--state", "one/state.json"]
    said_otherwise = first.replace("1.2]", "1.20], repeat = 1").replace(
        'n"', 'n", asymmetric = false'
    )
    assert said_otherwise != first
    (tmp_path / "basis.toml").write_text(said_otherwise)
    assert execute([*files, *state, "--out", "same"]) == 0
    (tmp_path / "basis.toml").write_text(then)
    capfd.readouterr()
    assert execute([*files, *state, "--out", "two"]) == 2
    said = capfd.readouterr().err
    assert len(said.splitlines()) == 1
    assert says in said
    assert "give the state of the same basis" in said
    assert not (tmp_path / "two").exists()


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("sample_time", 0.002, "sample_time is 0.002 s there and 0.001 s in model 'emps'"),
        ("model", "other", "learned with model 'other', and this is model 'emps'"),
    ],
)
def test_a_state_of_another_model_is_refused(key, value, says, files, tmp_path, capfd):
    assert execute([*files, "--out", "one"]) == 0
    path = tmp_path / "one" / "state.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {key: value}))
    capfd.readouterr()
    assert execute([*files, "--state", str(path), "--out", "two"]) == 2
    said = capfd.readouterr().err
    assert len(said.splitlines()) == 1
    assert says in said
    assert "or leave --state out to learn from zero" in said
    assert not (tmp_path / "two").exists()


def test_mistakes_of_model_and_state_name_their_file(files, tmp_path, capfd):
    assert execute([*files, "--state", str(tmp_path), "--out", "one"]) == 2
    assert "is a folder; give the state.json in it" in capfd.readouterr().err
    text = (ROOT / "plants" / "emps.toml").read_text()
    (tmp_path / "m.toml").write_text(re.sub(r"(?m)^gain = .*", "gain = 1.0", text))
    assert execute(["m.toml" if a == "emps" else a for a in files] + ["--out", "one"]) == 2
    assert "m.toml: emps: the closed loop is unstable" in capfd.readouterr().err
    assert not (tmp_path / "one").exists()


def test_a_bound_on_a_command_that_is_not_known_is_refused():
    """A u that is not a number would lie within every bound."""
    recording = recorded(servo(90.0), motion(3000))
    unknown = replace(recording, u=np.full(3000, np.nan), missing=frozenset({"u"}))
    with pytest.raises(InputError, match=r"recording: constraints.command .* record u"):
        learn_from_recording(
            load_plant("emps"), make_basis(BASIS, T), unknown, Weights(), Constraints(command=1e-3)
        )


def test_an_open_loop_machine_is_learned_too_and_no_closed_one_is_taken_for_it():
    """Without a controller the plant integrates, and its command is the feedforward, recorded or not."""
    mass = 4.5
    model = Plant("free mass", Zpk([-1.0], [1.0, 1.0], T**2 / (2 * mass), T), None)
    basis, reference = make_basis(BASIS, T), motion(3000)
    previous = np.array([5.0, 0.0])
    recording = recorded(
        model, reference, noise=1e-7, feedforward=_GoingOn(basis).regressors(reference) @ previous
    )
    recording = replace(recording, u=np.full(3000, np.nan), missing=frozenset({"u"}))
    step = learn_from_recording(model, basis, recording, Weights(), previous=previous)
    assert step.theta[0] == pytest.approx(mass, rel=1e-3)
    assert np.all(np.isfinite(step.std_error))
    limit = 0.9 * np.abs(step.feedforward).max()
    bounds = Constraints(command=limit)
    bounded = learn_from_recording(model, basis, recording, Weights(), bounds, previous)
    assert np.abs(bounded.feedforward).max() == pytest.approx(limit, rel=1e-6)
    with pytest.raises(InputError, match="a controller was at work"):
        learn_from_recording(model, basis, recorded(servo(90.0), reference), Weights())


def test_another_sample_time_is_refused():
    recording = recorded(servo(95.1), motion(200))
    slower = Recording(
        recording.t * 2, recording.r, recording.f, recording.u, recording.y, sample_time=2 * T
    )
    with pytest.raises(InputError, match="resample one of them"):
        learn_from_recording(load_plant("emps"), make_basis(BASIS, T), slower, Weights())


def emps(name):
    folder = Path(os.environ.get("FFL_DATA") or ROOT.parent / "shared" / "data")
    path = folder / "emps" / name
    if not path.is_file():
        pytest.skip(f"{name} is missing in {folder}; get it from nonlinearbenchmark.org (EMPS)")
    return path


@pytest.mark.parametrize(
    ("file", "map", "bound"),
    [("DATA_EMPS.mat", "emps", 0.03), ("DATA_EMPS_PULSES.mat", "emps", 0.1)],
)
def test_emps_teaches_its_mass_and_friction(file, map, bound):
    """Documented: 95.1 kg, 203.5 N s/m, 20.4 N; one step on the real recording."""
    recording = read_recording(emps(file), map)
    basis = make_basis([*BASIS, {"kind": "friction"}], T)
    step = learn_from_recording(load_plant("emps"), basis, recording, Weights(1.0, 1e-20))
    np.testing.assert_allclose(step.theta + step.servo, [95.1, 203.5, 20.4], rtol=bound)


def test_a_trial_in_another_unit_is_refused(tmp_path, capfd):
    trial = recorded(servo(90.0), motion())
    wrong = Recording(trial.t, trial.r, trial.f, trial.u, 1e3 * trial.y, sample_time=T)
    write_recording(wrong, tmp_path / "trial.csv")
    (tmp_path / "basis.toml").write_text(
        'basis = [{ kind = "derivatives", orders = ["acceleration"] }]\n'
        "weights = { error = 1.0, feedforward = 1e-20 }\n"
    )
    code = execute(
        ["step", "--model", "emps", "--basis", str(tmp_path / "basis.toml"), "--trial",
         str(tmp_path / "trial.csv"), "--out", str(tmp_path / "out")]
    )  # fmt: skip
    assert code == 2
    assert "the unit of y" in capfd.readouterr().err
    assert not (tmp_path / "out").exists()

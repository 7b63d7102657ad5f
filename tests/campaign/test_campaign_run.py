import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest

from ffl.campaign import load_campaign, run_campaign
from ffl.campaign.signals import last_trial, read_dataset
from ffl.errors import InputError
from ffl.learn import learn


def stable(folder):
    """Everything in a run's folder that must not depend on how it came to be: no wall times."""
    results = json.loads((folder / "results.json").read_text())
    for run in results["runs"]:
        for update in run["update"]:
            del update["seconds"]
    signals = {}
    for path in sorted(folder.glob("*.h5")):
        with h5py.File(path) as file:
            for name in ("reference", "time", "f", "u", "y", "e", "theta", "cost", "error_norm"):
                signals[path.stem, name] = file[name][()].tobytes()
            for name in file.get("second", {}):
                signals[path.stem, "second", name] = file["second"][name][()].tobytes()
    return results, signals


@pytest.fixture
def undisturbed(finished, write_campaign, tmp_path):
    shutil.copytree(finished, tmp_path / "whole")
    return load_campaign(write_campaign()), stable(tmp_path / "whole")


def test_results_follow_the_contract(write_campaign, tmp_path):
    campaign = load_campaign(write_campaign())
    outcome = run_campaign(campaign, tmp_path / "out")
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert results == outcome.results
    assert (results["schema"], results["campaign"], results["seed"]) == (1, "small", 3)
    for run, parameters in zip(results["runs"], (2, 5, 500), strict=True):
        assert run["parameters"] == parameters
        assert run["status"] == "done"
        for name in ("error_norm", "feedforward_norm", "cost"):
            assert len(run[name]) == 3
        assert len(run["update"]) == 2
        assert run["update"][0]["status"] == "optimal"
        assert run["update"][0]["kkt_residual"] < 1e-8
        assert run["error_norm"][-1] < 0.2 * run["error_norm"][0]
    second = results["runs"][0]["second_reference"]
    assert second["error_norm"] < 0.3 * second["error_norm_feedback_only"]
    assert "second_reference" not in results["runs"][2]  # a free signal carries nothing over


def test_trials_are_those_of_the_loop(undisturbed, tmp_path):
    campaign, _ = undisturbed
    run = campaign.run("fir")
    trials = list(learn(campaign.task(run), 3, campaign.seed_of(run)))
    path = tmp_path / "whole" / "fir.h5"
    for trial in trials:
        np.testing.assert_array_equal(read_dataset(path, "e", trial.number), trial.error)
        np.testing.assert_array_equal(read_dataset(path, "f", trial.number), trial.feedforward)
        np.testing.assert_array_equal(read_dataset(path, "theta", trial.number), trial.theta)
        np.testing.assert_array_equal(read_dataset(path, "u", trial.number), trial.recording.u)
    norms = np.linalg.norm(campaign.reference - read_dataset(path, "y"), axis=1)
    np.testing.assert_allclose(norms, read_dataset(path, "error_norm"), rtol=1e-14)
    stored = last_trial(path, campaign.sample_time)
    assert stored.number == 3
    assert stored.update.kkt_residual == trials[-1].update.kkt_residual
    assert stored.update.status == "optimal"


def test_signals_are_plain_datasets(undisturbed, tmp_path):
    with h5py.File(tmp_path / "whole" / "fir.h5") as file:
        shapes = {name: file[name].shape for name in ("time", "reference", "f", "u", "y", "e")}
        assert shapes == {"time": (500,), "reference": (500,)} | dict.fromkeys("fuye", (3, 500))
        assert file["theta"].shape == (3, 5)
        assert file["e"].attrs["unit"] == "m"
        assert file["u"].attrs["unit"] == "N"
        for name in file:
            if isinstance(file[name], h5py.Dataset):
                assert file[name].dtype.kind in "fS", name


def test_run_names_seed_the_noise_not_their_order(write_campaign, tmp_path):
    campaign = load_campaign(write_campaign())
    one, other = campaign.seed_of(campaign.runs[0]), campaign.seed_of(campaign.runs[1])
    assert one.spawn_key != other.spawn_key
    alone = load_campaign(write_campaign(('name = "derivatives"', 'name = "else"')))
    assert alone.seed_of(alone.runs[1]).spawn_key == other.spawn_key


def test_workers_change_nothing(undisturbed, tmp_path):
    campaign, expected = undisturbed
    run_campaign(campaign, tmp_path / "two", jobs=2)
    assert stable(tmp_path / "two") == expected


def test_resume_accepts_empty_partial_and_finished(undisturbed, write_campaign, tmp_path):
    campaign, expected = undisturbed
    (tmp_path / "empty").mkdir()
    run_campaign(campaign, tmp_path / "empty", resume=True)
    assert stable(tmp_path / "empty") == expected
    before = (tmp_path / "whole" / "fir.h5").stat().st_mtime_ns
    run_campaign(campaign, tmp_path / "whole", resume=True)
    assert stable(tmp_path / "whole") == expected
    assert (tmp_path / "whole" / "fir.h5").stat().st_mtime_ns == before


def test_learning_goes_on_where_more_trials_are_wanted(undisturbed, write_campaign, tmp_path):
    """As if they had been wanted from the beginning, the second reference run anew; never fewer."""
    more = load_campaign(write_campaign(("trials = 3", "trials = 5")))
    run_campaign(more, tmp_path / "at once")
    run_campaign(more, tmp_path / "whole", resume=True)
    assert stable(tmp_path / "whole") == stable(tmp_path / "at once")
    assert "trials = 5" in (tmp_path / "whole" / "campaign.toml").read_text()
    fewer, _ = undisturbed
    with pytest.raises(InputError, match=r"was 'trials = 5', is 'trials = 3'"):
        run_campaign(fewer, tmp_path / "whole", resume=True)


class Interrupted(Exception):
    pass


@pytest.mark.parametrize("stop", [1, 2, 4])
def test_resume_after_an_exception_equals_the_undisturbed_run(undisturbed, tmp_path, stop):
    campaign, expected = undisturbed
    seen = []

    def progress(run, trial, norm):
        seen.append(run)
        if len(seen) == stop:
            raise Interrupted

    with pytest.raises(Interrupted):
        run_campaign(campaign, tmp_path / "broken", progress=progress)
    partial = json.loads((tmp_path / "broken" / "results.json").read_text())
    assert sum(len(run["error_norm"]) for run in partial["runs"]) == stop
    assert {run["status"] for run in partial["runs"]} != {"done"}
    run_campaign(campaign, tmp_path / "broken", resume=True)
    assert stable(tmp_path / "broken") == expected


def start(campaign, folder, *options):
    command = [sys.executable, "-m", "ffl.cli", "run", str(campaign), "--out", str(folder)]
    return subprocess.Popen([*command, *options], stdout=subprocess.DEVNULL)


def wait_for(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return False


def trials_in(path):
    try:
        with h5py.File(path, "r", locking=False) as file:
            return len(file["error_norm"])
    except (OSError, KeyError):
        return 0


def children(pid):
    path = f"/proc/{pid}/task/{pid}/children"
    try:
        with open(path) as file:
            return [int(child) for child in file.read().split()]
    except FileNotFoundError:
        return []


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


@pytest.mark.parametrize("jobs", [1, 2])
def test_resume_after_sigkill_equals_the_undisturbed_run(write_campaign, tmp_path, jobs):
    file = write_campaign(trials=40, duration=1.0)
    process = start(file, tmp_path / "killed", "--jobs", str(jobs))
    first = tmp_path / "killed" / "derivatives.h5"
    assert wait_for(lambda: trials_in(first) >= 3)
    workers = [pid for pid in children(process.pid) if jobs > 1]
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    done = [trials_in(tmp_path / "killed" / f"{name}.h5") for name in ("derivatives", "free")]
    assert done[0] >= 3
    assert min(done) < 40, "the kill came too late to prove anything"
    if jobs > 1 and os.path.isdir("/proc/self"):
        assert len(workers) >= 2
        assert wait_for(lambda: not any(alive(pid) for pid in workers), 10.0)
    campaign = load_campaign(file)
    run_campaign(campaign, tmp_path / "killed", resume=True)
    run_campaign(campaign, tmp_path / "whole")
    assert stable(tmp_path / "killed") == stable(tmp_path / "whole")


@pytest.mark.parametrize("jobs", [1, 2])
def test_interrupt_leaves_what_is_complete(write_campaign, tmp_path, jobs):
    file = write_campaign(trials=500, duration=2.0)
    command = [sys.executable, "-m", "ffl.cli", "run", str(file), "--out", str(tmp_path / "out")]
    process = subprocess.Popen(
        [*command, "--jobs", str(jobs)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # Whoever runs the tests in the background has SIGINT ignored; a terminal does not.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert wait_for(lambda: trials_in(tmp_path / "out" / "derivatives.h5") >= 2)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the workers too
    with process.stderr:
        said = process.stderr.read()
    assert process.wait(30) == 130
    assert (
        said == "ffl: interrupted: what was complete stays on disk, and nothing is half-written\n"
    )
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    norms = {run["name"]: run["error_norm"] for run in results["runs"]}
    assert len(norms["derivatives"]) == trials_in(tmp_path / "out" / "derivatives.h5")


def test_a_folder_is_not_overwritten(undisturbed, write_campaign, tmp_path):
    campaign, _ = undisturbed
    with pytest.raises(InputError, match="not empty; add --resume"):
        run_campaign(campaign, tmp_path / "whole")
    changed = load_campaign(write_campaign(("seed = 3", "seed = 4")))
    with pytest.raises(InputError, match=r"has changed since .*was 'seed = 3', is 'seed = 4'"):
        run_campaign(changed, tmp_path / "whole", resume=True)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="holds no run of this campaign"):
        run_campaign(campaign, tmp_path / "other", resume=True)
    assert [p.name for p in (tmp_path / "other").iterdir()] == ["thesis.tex"]
    with pytest.raises(InputError, match="is a file; give a folder"):
        run_campaign(campaign, tmp_path / "other" / "thesis.tex")


def test_two_writers_are_refused(undisturbed, tmp_path):
    from ffl.campaign.store import Store

    campaign, _ = undisturbed
    store = Store.open(tmp_path / "whole", campaign.resolved, True)
    try:
        with pytest.raises(InputError, match="another ffl run writes here"):
            run_campaign(campaign, tmp_path / "whole", resume=True)
    finally:
        store.close()


def test_the_resolved_campaign_reruns_to_the_bit(write_campaign, tmp_path):
    (tmp_path / "path.csv").write_text(
        "t,r\n"
        + "".join(f"{k * 1e-3!r},{0.01 * math.sin(min(k / 100, 2)) ** 4!r}\n" for k in range(400))
    )
    file = write_campaign()
    text = file.read_text()
    head, tail = text.split("[reference]")
    tail = tail[tail.index("[second_reference]") :]
    file.write_text(f'{head}[reference]\nkind = "file"\nfile = "path.csv"\n{tail}')
    run_campaign(load_campaign(file), tmp_path / "first")
    again = load_campaign(tmp_path / "first" / "campaign.toml")
    run_campaign(again, tmp_path / "second")
    assert stable(tmp_path / "second") == stable(tmp_path / "first")


def test_a_machine_that_diverges_stops_its_run_only(write_campaign, tmp_path):
    file = write_campaign(duration=4.0)
    plant = tmp_path / "machine.toml"  # the loop has a gain margin of 9.4: a 20th of the mass
    change = '[[effects]]\nname = "mass_change"\nparameters = { change = -0.95 }\n'
    plant.write_text(plant.read_text() + "[physics]\nmass = 10.0\nmotor_constant = 1.0\n" + change)
    outcome = run_campaign(load_campaign(file), tmp_path / "out")
    assert {name for name, _ in outcome.stopped} == {"derivatives", "fir", "free"}
    assert all(run["status"] == "diverged" for run in outcome.results["runs"])
    text = (tmp_path / "out" / "results.json").read_text()
    assert "NaN" not in text
    assert "Infinity" not in text

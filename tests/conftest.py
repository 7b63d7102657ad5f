"""A small stage and a campaign on it, written to a folder of the test; modules that take long go first."""

import os
import textwrap
from collections import Counter
from functools import partial

import pytest

# One thread in linear algebra, as the command line has it: two processes on two cores are the better use
# of them. Before numpy is imported; a user's own setting stands.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

PLANT = """
name = "stage"
sample_time = 0.001
[units]
input = "N"
output = "m"
[plant]
form = "zpk"
zeros = [-1.0]
poles = [1.0, 1.0]
gain = {gain}
[controller]
form = "zpk"
zeros = [0.98]
poles = [0.75]
gain = 5.0e5
[machine]
sensor_noise = 1.0e-7
force_noise = 0.01
encoder_resolution = 1.0e-7
"""

CAMPAIGN = """
name = "small"
seed = 3
trials = {trials}
model = "model.toml"
machine = "machine.toml"
[reference]
kind = "moves"
moves = [{{ start = 0.05, distance = 0.05, velocity = 0.4, acceleration = 5.0, jerk = 300.0 }}]
duration = {duration}
[second_reference]
kind = "moves"
moves = [{{ start = 0.05, distance = -0.03, velocity = 0.2, acceleration = 4.0, jerk = 300.0 }}]
duration = 0.5
[[runs]]
name = "derivatives"
basis = [{{ kind = "derivatives", orders = ["velocity", "acceleration"] }}]
weights = {{ error = 1.0, feedforward = 1e-14 }}
[[runs]]
name = "fir"
basis = [{{ kind = "fir", preview = 2, lag = 2 }}]
weights = {{ error = 1.0, feedforward = 1e-14 }}
[[runs]]
name = "free"
basis = [{{ kind = "free" }}]
weights = {{ error = 1.0, feedforward = 1e-12 }}
"""


def write_in(folder, *replace, trials=3, duration=0.5, name="small.toml"):
    """Writes model, machine and campaign; `replace` edits the campaign's text."""
    (folder / "model.toml").write_text(PLANT.format(gain=5.0e-8))
    (folder / "machine.toml").write_text(PLANT.format(gain=4.8e-8))
    text = CAMPAIGN.format(trials=trials, duration=duration)
    for old, new in replace:
        assert old in text
        text = text.replace(old, textwrap.dedent(new))
    path = folder / name
    path.write_text(text)
    return path


@pytest.fixture
def write_campaign(tmp_path):
    return partial(write_in, tmp_path)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of the small campaign, run once: for reading, or for `shutil.copytree`."""
    from ffl.campaign import load_campaign, run_campaign

    folder = tmp_path_factory.mktemp("finished")
    run_campaign(load_campaign(write_in(folder)), folder / "done")
    return folder / "done"


@pytest.fixture(scope="module", autouse=True)
def undivided(request):
    """Among processes that have every core, threads that share out a diagnosis take turns, and cost a tenth
    more of the processor; what they answer is the same. They are at work where they are tested, and in the
    diagnoses of `test_diagnosis.py`."""
    shares = request.path.name in ("test_parallel.py", "test_diagnosis.py")
    if shares or "PYTEST_XDIST_WORKER" not in os.environ:
        yield
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ffl.diagnose.contest.parallel.SHARED", False)
        yield


@pytest.fixture
def undrawn(monkeypatch):
    """Pages are written whole but for the pictures, which take seconds: for tests that read none."""
    monkeypatch.setattr("ffl.report.page.image_source", lambda figure: "data:,")


def pytest_addoption(parser):
    parser.addoption(
        "--whole",
        action="store_true",
        help="reproductions of minutes from beginning to end as well",
    )


def pytest_collection_modifyitems(config, items):
    """What takes minutes only when it is asked for; modules in the order of the seconds that their `slow`
    tests state: processes that share out modules wait for one another at the end, where a long one should
    not begin."""
    if not config.getoption("whole"):
        left_out = [item for item in items if item.get_closest_marker("whole")]
        items[:] = [item for item in items if item not in left_out]
        config.hook.pytest_deselected(items=left_out)
    stated = {
        (item.path, item.originalname): mark.args[0]
        for item in items
        for mark in item.iter_markers("slow")
    }
    seconds = Counter()
    for (path, _), some in stated.items():
        seconds[path] += some
    items.sort(key=lambda item: -seconds[item.path])

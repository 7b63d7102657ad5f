import json
import shutil

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ffl.campaign import load_campaign, run_campaign
from ffl.report.finished import cumulative_power, motion_interval, pre_actuation, read_folders
from ffl.report.learning import run_with_report, write_report
from ffl.report.learning_figures import parameters
from ffl.report.learning_page import wrong_way
from ffl.report.page import subplots
from ffl.report.weight_words import equal_error_weights, in_words
from ffl.systems import Zpk, zero_order_hold


@given(st.integers(2, 200), st.integers(0, 2**32 - 1))
def test_cumulative_power_ends_at_the_energy(n, seed):
    signal = np.random.default_rng(seed).standard_normal(n)
    frequencies, power = cumulative_power(signal, 0.01)
    assert len(frequencies) == len(power) == n // 2 + 1
    assert np.all(np.diff(power) >= 0)
    assert power[-1] == pytest.approx(np.sum(signal**2))


def test_a_sine_steps_at_its_frequency():
    t = np.arange(1000) * 1e-3
    f, power = cumulative_power(np.sin(2 * np.pi * 50 * t), 1e-3)
    assert power[f < 49.5][-1] < 1e-20
    assert power[f >= 50][0] == pytest.approx(500.0)


def test_motion_and_pre_actuation():
    reference = np.r_[np.zeros(100), np.linspace(0, 1, 50), np.ones(100)]
    start, end = motion_interval(reference, 0.1)
    assert (start, end) == pytest.approx((10.0, 14.9))
    feedforward = np.zeros(250)
    feedforward[60:120] = 1.0
    feedforward[40] = 1e-4
    assert pre_actuation(feedforward, 100) == 40
    assert pre_actuation(feedforward, 50) == 0
    assert pre_actuation(np.zeros(250), 100) == 0
    assert pre_actuation(feedforward + 5.0, 100) == 40  # a load that is held at rest is none
    assert pre_actuation(np.full(250, 5.0), 100) == 0
    assert motion_interval(np.zeros(5), 0.1) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("system", "samples"),
    [
        (Zpk([], [0.4], 0.6, 1e-3), 0),  # its impulse response ends at exactly zero
        (zero_order_hold([], [-5 + 35j, -5 - 35j], 1.0, 1e-3), 0),  # swings to the other side
        (Zpk([1.5], [0.4, 0.5], -1.0, 1e-3, 4), 1),  # -1, 0.6, 0.74, ...: H(1) > 0
        (Zpk([1.5, 1.2], [0.4, 0.5, 0.6], 1.0, 1e-3), 0),
        (Zpk([], [0.4], 0.6, 1e-3, 400), 0),  # nothing within the picture
    ],
)
def test_only_a_zero_beyond_one_sends_the_output_the_wrong_way(system, samples):
    assert wrong_way(system, system.impulse_response(200)) == samples


@pytest.fixture(scope="module")
def reported(finished):
    """The folder of the small campaign with its report."""
    run_with_report(load_campaign(finished / "campaign.toml"), finished, resume=True, quiet=True)
    return finished


def test_the_report_holds_every_figure(reported):
    text = (reported / "report.html").read_text()
    for title in (
        "Error norm of every trial",
        "Reference",
        "Error and feedforward of the last trial",
        "Plant P against the inverse of the learned feedforward",
        "Impulse response of the model",
        "Normalised cumulative power spectrum of the last error",
        "Parameters of every trial",
    ):
        assert f"<b>{title}" in text
    assert text.count("<figure>") == 7
    assert "A reference that was never learned" in text
    for run in read_folders([reported]):
        assert f"<td>{run.label}</td>" in text
        assert f"{run.error_norm[-1]:.4g}" in text


def test_what_is_not_drawn_is_named_and_a_large_ratio_is_no_percentage(reported):
    text = (reported / "report.html").read_text()
    assert "Not drawn: free (no filter of the reference" in text
    errors = {run.label: run.error_norm[-1] for run in read_folders([reported])}
    ratio = max(errors.values()) / min(errors.values())
    assert ratio > 2
    assert f"<td>{ratio:.3g} times as large</td>" in text


@pytest.mark.usefixtures("undrawn")
def test_the_legend_of_many_runs_stays_within_the_figure(write_campaign, tmp_path, monkeypatch):
    """Eight runs with the longest names that one row of four may have."""
    from ffl.report import learning_page

    seen = []
    plain = learning_page.Page.figure

    def figure(self, drawn, title, caption):
        if title == "Error and feedforward of the last trial":
            drawn.canvas.draw()
            seen.append((drawn.legends[0].get_window_extent(), drawn.bbox))
        return plain(self, drawn, title, caption)

    monkeypatch.setattr(learning_page.Page, "figure", figure)
    run = (
        '[[runs]]\nname = "derivatives_{0}"\nweights = {{ error = 1.0, feedforward = 1e-14 }}\n'
        'basis = [{{ kind = "derivatives", orders = ["velocity"] }}]\n'
    )
    path = write_campaign(trials=2)
    head = path.read_text()
    path.write_text(head[: head.index("[[runs]]")] + "".join(run.format(k) for k in range(8)))
    run_with_report(load_campaign(path), tmp_path / "out", quiet=True)
    ((legend, whole),) = seen
    assert legend.x0 >= whole.x0
    assert legend.x1 <= whole.x1


@pytest.mark.usefixtures("undrawn")
def test_folders_are_compared(finished, write_campaign, tmp_path):
    shutil.copytree(finished, tmp_path / "one")
    other = write_campaign(
        ("distance = 0.05", "distance = 0.02"), ('name = "fir"', 'name = "taps"')
    )
    run_campaign(load_campaign(other), tmp_path / "two")
    write_report([tmp_path / "one", tmp_path / "two"], tmp_path / "both.html")
    text = (tmp_path / "both.html").read_text()
    assert "<td>one/fir</td>" in text
    assert "<td>two/taps</td>" in text
    assert text.count("<b>Reference.") == 2  # the references differ, so each is shown
    assert text.count("<b>Impulse response") == 1  # the models do not


def test_the_response_is_that_of_the_learned_filter(finished):
    fir = next(run for run in read_folders([finished]) if run.label == "fir")
    taps = dict(zip(range(-2, 3), fir.theta[-1], strict=True))
    z = np.exp(2j * np.pi * 30.0 * 1e-3)
    expected = sum(value * z**-k for k, value in taps.items())
    assert fir.response(np.array([30.0]))[0] == pytest.approx(expected)


def test_weights_are_told_in_words():
    assert in_words("W_e", 50.0) == "W_e = 50"
    assert in_words("W_e", np.array([0.1, 50.0, 0.5])) == "W_e per sample, 0.1 to 50"
    assert in_words("W_e", np.full(3, 2.0)) == "W_e = 2"
    assert in_words("W_e", Zpk([0.5], [0.9, 0.2], 2.0, 1e-3)) == "W_e a filter (1 zero, 2 poles)"


@pytest.mark.usefixtures("undrawn")
def test_only_runs_of_equal_error_weights_share_a_panel(write_campaign, tmp_path):
    """Two filters and three vectors of which two are equal, one of them but for one sample."""
    vectors = [[1.0] * 250 + [9.0] * 250, [9.0] * 250 + [1.0] * 250, [1.0] * 250 + [9.0] * 250]
    filters = [f'{{ form = "zpk", poles = [{pole}], gain = 0.1 }}' for pole in (0.9, 0.8, 0.9)]
    weights = [*map(str, vectors), *filters, str([1.0] * 500), "1.0"]
    runs = [
        f'[[runs]]\nname = "run{k}"\nbasis = [{{ kind = "derivatives", orders = ["velocity"] }}]\n'
        f"weights = {{ error = {weight} }}\n"
        for k, weight in enumerate(weights)
    ]
    path = write_campaign(trials=2)
    head = path.read_text()
    path.write_text(head[: head.index("[[runs]]")] + "".join(runs))
    run_campaign(load_campaign(path), tmp_path / "out")
    groups = equal_error_weights(read_folders([tmp_path / "out"]))
    assert groups == [
        ("W_e per sample, 1 to 9 (run0)", [0, 2]),
        ("W_e per sample, 1 to 9 (run1)", [1]),
        ("W_e a filter (0 zeros, 1 pole) (run3)", [3, 5]),
        ("W_e a filter (0 zeros, 1 pole) (run4)", [4]),
        ("W_e = 1", [6, 7]),
    ]
    write_report([tmp_path / "out"], tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert "ndarray" not in text
    assert "Zpk" not in text


@pytest.mark.usefixtures("undrawn")
def test_directions_left_out_stand_in_results_and_report(write_campaign, tmp_path):
    """Nine taps of a smooth reference have fewer directions that it shows above 1e-10."""
    path = write_campaign(("preview = 2, lag = 2", "preview = 4, lag = 4"))
    run_with_report(load_campaign(path), tmp_path / "out", quiet=True)
    runs = {run.label: run for run in read_folders([tmp_path / "out"])}
    updates = runs["fir"].entry["update"]
    ranks = {update["rank"] for update in updates}
    assert max(ranks) < 9
    largest = max(update["left_out"] for update in updates)
    assert largest > 0
    text = (tmp_path / "out" / "report.html").read_text()
    assert f" of 9 ({largest:.2%})</td>" in text
    assert "<td>2 of 2</td>" in text
    assert {update["left_out"] for update in runs["derivatives"].entry["update"]} == {0.0}


@pytest.mark.usefixtures("undrawn")
def test_a_run_of_an_earlier_version_is_read_and_gone_on_with(write_campaign, tmp_path):
    """Its file has no `left_out`: nothing is said of it."""
    out = tmp_path / "out"
    run_campaign(load_campaign(write_campaign(trials=2)), out)
    before = json.loads((out / "results.json").read_text())
    for name in ("derivatives", "fir", "free"):
        with h5py.File(out / f"{name}.h5", "a") as file:
            del file["left_out"]
    text = (out / "campaign.toml").read_text().replace("trials = 2", "trials = 3")
    (out / "campaign.toml").write_text(text)
    run_campaign(load_campaign(out / "campaign.toml"), out, resume=True)
    after = json.loads((out / "results.json").read_text())
    for old, new in zip(before["runs"], after["runs"], strict=True):
        assert new["error_norm"][:2] == old["error_norm"]
        assert len(new["error_norm"]) == 3
        assert not any("left_out" in update for update in new["update"])
    write_report([out], tmp_path / "page.html")


@pytest.mark.parametrize(("most", "scale"), [(1.2, "linear"), (30.0, "symlog")])
def test_parameters_have_ticks_that_are_read(most, scale):
    """Of a logarithmic axis that ends before its first power the ends were the ticks, 1.11272 x 10^0."""
    _, ax = subplots()
    parameters(ax, np.array([[0.0, 0.0], [most, -1.1], [1.0, -1.0]]), "run")
    assert ax.get_yscale() == scale
    low, high = ax.get_ylim()
    shown = [t for t in ax.get_yticks() if low <= t <= high]
    assert len(shown) > 2
    assert all(float(f"{t:.2g}") == pytest.approx(t, abs=1e-12) for t in shown)

"""The pictures show what was counted."""

import numpy as np
from matplotlib.figure import Figure

from ffl.challenge import tally
from ffl.report.challenge import append_section, calibration, confusion


def test_confusion_writes_every_count_once():
    counts = np.array([[3, 0, 1], [0, 2, 0]])
    ax = confusion(Figure().add_subplot(), ["a_b", "c"], ["a_b", "c", "unnamed"], counts)
    assert sorted(t.get_text() for t in ax.texts) == ["1", "2", "3"]
    assert [t.get_text() for t in ax.get_yticklabels()] == ["a b", "c"]
    assert ax.get_ylabel() == "true"
    np.testing.assert_allclose(ax.images[0].get_array(), [[0.75, 0, 0.25], [0, 1, 0]])


def test_calibration_draws_the_bins():
    ax = calibration(Figure().add_subplot(), [(0.5, 0.7, 0.6, 4, 0.5), (0.95, 1, 0.99, 9, 1.0)])
    np.testing.assert_allclose(ax.lines[1].get_xydata(), [[0.6, 0.5], [0.99, 1.0]])
    assert [t.get_text() for t in ax.texts] == [" 4", " 9"]


def test_the_log_keeps_earlier_runs(tmp_path):
    result = tally([], "abc", 7, 0.1)
    log = tmp_path / "challenge.md"
    for day in ("Monday", "Tuesday"):
        append_section(result, log, {"date": day})
    text = log.read_text()
    assert text.count("## Blind run, seed 7") == 2
    assert text.index("Monday") < text.index("Tuesday")
    assert text.startswith("# Blind challenge")

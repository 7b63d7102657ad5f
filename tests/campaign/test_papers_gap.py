"""The printer paper's own gap: friction alone turns the promise, an encoder does not."""

import numpy as np
import pytest

from ffl.campaign.papers_gap import KINDS, TOGETHER, PapersGap, _machine
from ffl.report.papers_gap import page, table, write


def reduction(case):
    _, _, size, (fir, obf, strong, repeated) = _machine(case, 0, 1)
    assert len(size) == len(TOGETHER[case])
    return 1 - obf / fir, 1 - repeated / strong


@pytest.mark.slow(5)
def test_friction_alone_takes_the_promise_away():
    promised, measured = reduction("nothing"), reduction("friction")
    assert promised[0] > 0.9
    assert 0.2 < measured[0] < 0.6
    assert 0.0 < measured[1] < promised[1]
    assert reduction("encoder")[0] > 0.9


def test_sizes_lie_in_their_ranges_and_do_not_depend_on_the_company():
    rng = np.random.default_rng(0)
    for kind in KINDS.values():
        drawn = [kind.draw(rng) for _ in range(200)]
        assert kind.low <= min(drawn) < max(drawn) <= kind.high


def test_the_report_states_every_case(tmp_path):
    rng = np.random.default_rng(0)
    norms = {case: np.exp(rng.standard_normal((5, 4))) for case in TOGETHER}
    sizes = {case: rng.uniform(0.01, 0.02, (5, len(k))) for case, k in TOGETHER.items()}
    gap = PapersGap((), norms, sizes)
    rows = table(gap)
    assert [row[0].replace(", ", "_") for row in rows] == list(TOGETHER)
    write(gap, tmp_path, "# before", "after")
    text = (tmp_path / "papers_gap.md").read_text()
    assert all(row[2] in text for row in rows)
    assert (tmp_path / "papers_gap.png").stat().st_size > 10000
    assert "Case by case" in page(gap).html()

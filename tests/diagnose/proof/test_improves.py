"""What was named explains nothing where held-out runs are no nearer for it."""

from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose.proof.prove import Proof, _interval, nrmse
from ffl.diagnose.proof.rules import Said, _no_worse, idle
from ffl.diagnose.recorded.where import Place


@pytest.mark.parametrize(
    ("y", "u", "improves"),
    [
        ((0.2, 0.1), (None, None), True),
        ((0.2, 0.2), (None, None), False),
        ((0.002, 0.0024), (0.3, 0.1), True),  # feedback hides it in y
        ((0.002, 0.0024), (0.021, 0.023), False),
    ],
)
def test_what_is_nearer_in_y_or_in_u_is_nearer(y, u, improves):
    proof = Proof(("held.csv",), *y, 0.001, *u, None, (0.0, 0.0), ())
    assert proof.improves is improves


@pytest.mark.parametrize(
    ("after", "high", "u", "none"),
    [
        pytest.param(0.19, 0.01, (0.6, 0.59), True, id="five times the noise, and no surer"),
        pytest.param(0.19, 0.01, (None, None), True, id="no command to go by"),
        pytest.param(0.19, -0.001, (0.6, 0.59), False, id="surely a little nearer"),
        pytest.param(0.19, 0.01, (0.6, 0.3), False, id="feedback hides it in y"),
        pytest.param(0.09, 0.01, (0.6, 0.59), False, id="within what noise may leave"),
    ],
)
def test_names_that_bring_held_out_runs_no_nearer_are_no_share_of_it(after, high, u, none):
    proof = Proof(("held.csv",), 0.2, after, 0.04, *u, None, (-0.01, high), ())
    assert idle(proof) is none


@pytest.mark.parametrize(
    ("after", "loud", "verdict"),
    [
        pytest.param(
            0.0022, 1.1, "explained", id="as noise as loud as stated parts two of its runs"
        ),
        pytest.param(0.0022, 2.0, "inconclusive", id="by louder noise than stated"),
        pytest.param(0.0022, 0.0, "inconclusive", id="no noise is stated"),
        pytest.param(0.0027, 1.1, "inconclusive", id="further than noise parts them"),
    ],
)
def test_names_hold_whose_free_runs_part_as_noise_has_them(after, loud, verdict):
    proof = Proof(("held.csv",), 0.00167, after, 0.0021, 0.14, 0.17, 0.156, (0.0, 0.001), ())
    model = SimpleNamespace(effects=[SimpleNamespace(name="saturation")], proven=frozenset())
    ended = SimpleNamespace(
        standing=SimpleNamespace(model=model, predicted=False),
        contest=SimpleNamespace(led=False, winner=None),
        plant=SimpleNamespace(machine=SimpleNamespace(states_noise=loud > 0.0)),
        proof=proof, loud=loud, trusted=True,
    )  # fmt: skip
    said = _no_worse(ended, Said("explained", Place("", "", ()), notes=("there is a limit",)))
    assert said.verdict == verdict
    assert bool(said.notes) is (verdict == "explained")  # nothing is said of names that are not


def test_the_interval_of_the_change_is_about_the_change():
    """A long recording that is nearer and a short one that is farther: each counts by its samples."""
    rng, errors, paths = np.random.default_rng(0), [], []
    for n, before, after in ((60_000, 0.1, 0.05), (2_000, 0.05, 0.3)):
        paths.append(np.sin(0.01 * np.arange(n)))
        errors.append((before * rng.standard_normal(n), after * rng.standard_normal(n)))
    samples = sum(map(len, paths))
    scale = np.sqrt(sum(np.sum((y - y.mean()) ** 2) for y in paths) / samples)
    left = [
        nrmse(paths, [y - pair[k] for y, pair in zip(paths, errors, strict=True)]) for k in (0, 1)
    ]
    low, high = _interval(errors, scale, np.random.default_rng(1))
    assert low < left[1] - left[0] < high < 0.0

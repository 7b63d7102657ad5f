"""Who earns a place, by what the recordings that judge show and would have to show."""

from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose import judging, unnamed
from ffl.diagnose.judging import Judged, earns
from ffl.diagnose.model import Model
from ffl.systems.plant import EffectSpec

SAMPLES, FITTED, PROMISED = 4000, 1478.0, 77.0


class Standing(Judged):
    """A hypothesis beside a play, without the fit behind it."""

    freedom = 1
    independent = float(SAMPLES)
    model = Model(None, effects=(EffectSpec("backlash", {"gap": 1e-4}),))  # type: ignore[arg-type]

    @property
    def score(self) -> float:
        return self.fitted + self.held_out


def _judged(white: np.ndarray, fitted: float) -> Standing:
    found = SimpleNamespace(white=np.zeros(1000))
    held = -0.5 * SAMPLES * float(np.log(np.mean(white**2)))
    return Standing(found, None, fitted, held, white)  # type: ignore[arg-type]


@pytest.mark.parametrize(("shown", "earned"), [(0.0, False), (0.05, False), (0.15, True)])
def test_what_would_show_where_it_is_judged_must_show_there(monkeypatch, shown, earned):
    """A further effect changes what is left there by 77 nats: a tenth of them at least it must gain."""
    monkeypatch.setattr(judging, "credible", lambda judged: True)
    rng = np.random.default_rng(0)
    before = rng.standard_normal(SAMPLES)
    size = np.linalg.norm(before)
    other = rng.standard_normal(SAMPLES)
    other -= (other @ before) / size**2 * before
    cosine = (
        np.sqrt(0.5 * PROMISED) / size
    )  # mirrored: 0.5 |difference|^2 = PROMISED, of equal length
    mirror = cosine * before / size + np.sqrt(1 - cosine**2) * other / np.linalg.norm(other)
    after = (before - 2.0 * (before @ mirror) * mirror) * np.exp(-shown * PROMISED / SAMPLES)
    assert earns(_judged(after, FITTED), _judged(before, 0.0), 0.0) is earned


@pytest.mark.parametrize(
    ("maps", "names", "astray"),
    [(500.0, 500.0, True), (500.0, 120.0, False), (120.0, 500.0, False)],
)
def test_maps_along_the_measured_motion_are_asked_where_nothing_runs_there(
    monkeypatch, maps, names, astray
):
    monkeypatch.setattr(unnamed, "_cost", lambda *_: names)
    alone = SimpleNamespace(white=np.zeros(100), cost=maps)
    assert unnamed._astray(None, None, alone) is astray

"""Who earns a place, by what the recordings that judge show and would have to show."""

from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose import judging, unnamed
from ffl.diagnose.judging import Judged, earns, effective
from ffl.diagnose.model import Model
from ffl.systems.plant import EffectSpec

SAMPLES, FITTED, PROMISED = 4000, 1478.0, 77.0


class Standing(Judged):
    """A verdict without the fit behind it."""

    freedom = 1
    model = Model(None)  # type: ignore[arg-type]

    @property
    def score(self) -> float:
        return self.fitted + self.held_out


class Further(Standing):
    """The same beside a play."""

    independent = float(SAMPLES)
    model = Model(None, effects=(EffectSpec("backlash", {"gap": 1e-4}),))  # type: ignore[arg-type]


def _judged(white: np.ndarray, fitted: float, kind: type[Standing] = Standing) -> Standing:
    found = SimpleNamespace(white=np.zeros(1000))
    held = -0.5 * effective(white) * float(np.log(np.mean(white**2)))
    return kind(found, None, fitted, held, white)  # type: ignore[arg-type]


def test_held_out_gains_count_in_equally_many_samples():
    """A slow residual of four times the size is not hardly worse than a white one."""
    rng = np.random.default_rng(0)
    white = rng.standard_normal(600)
    slow = 4.0 * np.sin(np.linspace(0.0, 6.0, 600))
    base, rival = (_judged(w, fitted) for w, fitted in ((slow, 0.0), (white, 50.0)))
    assert earns(rival, base, 25.0)
    assert not earns(base, rival, 0.0)


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
    assert earns(_judged(after, FITTED, Further), _judged(before, 0.0, Further), 0.0) is earned


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

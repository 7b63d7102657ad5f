"""Who is let into a round: by place, by sum of squares, by likelihood."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from ffl.diagnose.hypothesis.places import Place, distinct_forces, points_of
from ffl.diagnose.screen import glimpse
from ffl.diagnose.screen.candidate import Candidate
from ffl.diagnose.screen.shortlist import shortlist
from ffl.systems.plant import EffectSpec

MOTOR, SENSOR, LOAD = (Place("force", side, 1.0) for side in ("motor", "sensor", "load"))


def candidate(name, gain, place):
    return Candidate(EffectSpec(name, {}, place.options), gain, 1, place, None)


def test_a_force_is_also_tried_where_others_act_already():
    seen = [
        candidate("flexible_mode", 200.0, MOTOR),
        candidate("backlash", 190.0, Place("force", "coupling")),
        candidate("coulomb_friction", 100.0, SENSOR),
        candidate("coulomb_friction", 60.0, MOTOR),
        candidate("coulomb_friction", 55.0, LOAD),
    ]
    there = shortlist(seen, points={MOTOR})
    assert [c.place for c in there if c.spec.name == "coulomb_friction"] == [SENSOR, MOTOR]
    assert [c.place for c in shortlist(seen) if c.spec.name == "coulomb_friction"] == [SENSOR]


def test_points_are_those_of_forces():
    effects = (
        EffectSpec("cogging", {}, {"side": "motor", "mass_ratio": 1.0}),
        EffectSpec("saturation", {"limit": 1.0}),
        EffectSpec("constant_load", {"force": 1.0}),
    )
    assert points_of(SimpleNamespace(effects=effects)) == {MOTOR, Place("force")}


def test_who_takes_off_little_of_a_large_sum_has_a_say_by_likelihood(monkeypatch):
    """cogging makes the sum of squares; a dead zone is as likely, a load is not."""
    squares = {"cogging": 400.0, "dead_zone": 950.0, "constant_load": 940.0}
    likely = {"nothing": 0.0, "cogging": 130.0, "dead_zone": 120.0, "constant_load": 4.0}

    def begun(scene, start, **_):
        return SimpleNamespace(model=start, cost=squares[start.names[-1]])

    def start(scene, c):
        return SimpleNamespace(names=(c.spec.name,), effects=(c.spec,))

    monkeypatch.setattr(glimpse, "with_best_start", start)
    monkeypatch.setattr(glimpse, "with_clocks", lambda scene, model, first: scene)
    monkeypatch.setattr(glimpse, "fit", begun)
    monkeypatch.setattr(glimpse, "raw_residuals", lambda scene, model: model.names[-1])
    scene = SimpleNamespace(
        residuals=lambda model: "nothing",
        whiten=lambda left: np.full(10, 10.0),
        in_own_noise=likely.__getitem__,
    )
    like = SimpleNamespace(shared=lambda model: None)
    entrants = [Candidate(EffectSpec(name, {}), 1.0, 1, Place("force"), like) for name in squares]
    chosen = glimpse.promising(scene, SimpleNamespace(model=None), entrants)
    assert [f.model.names[-1] for f in chosen] == ["cogging", "dead_zone"]


def test_a_force_that_feels_no_motion_is_tried_once_where_it_drives_the_same():
    point = {
        ("motor", None): [0.0, 1.0],
        ("motor", 1.0): [0.0, 1.0],
        ("load", 1.0): [1.0, 0.0],
    }
    mechanics = SimpleNamespace(
        point=lambda side, ratio: SimpleNamespace(force=np.array(point[side, ratio]))
    )
    model = SimpleNamespace(simulator=SimpleNamespace(mechanics=mechanics))
    anywhere = Place("force", "motor")
    assert distinct_forces(model, [MOTOR, LOAD, anywhere]) == [anywhere, LOAD]

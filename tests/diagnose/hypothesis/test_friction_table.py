"""The form of a friction table: what is there is found, what is not there is left out."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.settle import one_for_two
from ffl.diagnose.ground import Comparison, ground_of
from ffl.diagnose.hypothesis import friction_table
from ffl.diagnose.hypothesis.amounts import effect_values
from ffl.diagnose.hypothesis.fit import surprise
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.effects import EFFECTS
from ffl.recordings import read_recording
from ffl.systems import load_plant
from ffl.systems.plant import EffectSpec

FOLDER = Path(os.environ.get("FFL_DATA", Path("..") / "shared" / "data")) / "emps"
UM = 1e6


def _file(name):  # type: ignore[no-untyped-def]
    if not (FOLDER / name).exists():
        pytest.skip(f"{FOLDER / name} is missing; get it from nonlinearbenchmark.org, set FFL_DATA")
    return FOLDER / name


def test_numbers_of_the_contact_are_free_only_where_they_are_stated():
    table = {"grid": [0.0, 1.0], "positive": [1.0, 1.0], "negative": [1.0, 1.0]}
    effect = EFFECTS["position_dependent_friction"]
    found = effect.from_coefficients(np.ones(4), {"knots": 2.0, "low": 0.0, "high": 1.0})
    assert found == {"table": table, "level": 1.0}


def test_a_wall_at_the_end_of_the_travel_must_be_worth_it(stage):  # type: ignore[no-untyped-def]
    """A knot that hardly a sample sees: 200,000 times the friction elsewhere stood for a stop."""
    model = Model(Base.of(stage, 0.05))

    def paid(end):  # type: ignore[no-untyped-def]
        table = {"grid": [0.0, 1.0, 2.0], "positive": [3.0, 4.0, end], "negative": [2.0, 3.0, 3.0]}
        return surprise(
            model.with_effect(EffectSpec("position_dependent_friction", {"table": table}))
        )

    assert paid(6.0) < 0.5
    assert paid(6e5) > paid(6.0) + 25.0


@pytest.fixture(scope="module")
def emps():  # type: ignore[no-untyped-def]
    """The plant, the recording that is fitted, the one that judges."""
    plant = load_plant("emps")
    names = ("DATA_EMPS.mat", "DATA_EMPS_PULSES.mat")
    runs = [read_recording(_file(name), "emps", sample_time=plant.sample_time) for name in names]
    return plant, *runs


@pytest.mark.slow(15)
def test_of_emps_the_table_takes_the_place_of_what_came_before_it(emps):  # type: ignore[no-untyped-def]
    """The documented numbers, 20.39 N, 203.5 N s/m, 95.11 kg, from the mass and the servo law alone;
    the documented friction leaves 1.96 um of servo error in the second file. The search is met where
    it asks for one effect in the place of two; `--whole`: from its beginning."""
    plant, fitted, judging = emps
    ground = ground_of(Comparison(plant, [fitted], [judging]), [], lambda line: None)
    contact = EffectSpec("presliding_friction", {"level": 20.0, "stiffness": 2e6})
    ripple = EffectSpec("encoder_ripple", {"amplitude": 3e-6, "period": 0.08, "phase": 0.0})
    two = judge(ground.scene, ground.held, ground.told.with_effect(contact).with_effect(ripple), 8)
    one = one_for_two(ground.scene, ground.held, two, lambda line: None)
    assert one.model.names == ("position_dependent_friction",)
    assert one.fitted > two.fitted + 500.0
    assert one.held_out > two.held_out + 500.0
    level = one.model.effects[0].parameters["level"]
    damper = effect_values(one.model, "damping")["coefficient"]
    told_right(level, damper, one.model.corrections["mass"])
    (trial,) = ground.held.like(one.scene).trials
    servo_right((trial.y - one.model.simulate(trial).y)[20:])


@pytest.mark.whole
@pytest.mark.slow(300)
def test_emps_friction_concealed(emps):  # type: ignore[no-untyped-def]
    plant, fitted, judging = emps
    found = diagnose(plant, [fitted], [judging])
    effects = {f.name: f.parameters for f in found.findings}
    level = effects["position_dependent_friction"]["level"].value
    damper = effects["viscous_friction"]["coefficient"].value
    masses = [c.relative for c in found.corrections if c.name == "mass"]
    told_right(level, damper, max(masses, key=abs, default=0.0))
    overlay = found.proof.overlays[0]
    servo_right((overlay.y - overlay.y_after)[20:])


def told_right(level, damper, mass):  # type: ignore[no-untyped-def]
    assert level == pytest.approx(20.4, rel=0.05)
    assert damper == pytest.approx(203.5, rel=0.1)
    assert abs(mass) < 0.02


def servo_right(error):  # type: ignore[no-untyped-def]
    assert UM * np.sqrt(np.mean(error**2)) < 1.4


@pytest.mark.parametrize(("finer", "kept"), [(100.0, ["cogging", "drift"]), (250.0, ["drift"])])
def test_what_goes_by_position_is_no_patch_of_a_coarse_table(monkeypatch, stage, finer, kept):
    flat = {"grid": [0.0, 0.05], "positive": [1.0, 1.0], "negative": [1.0, 1.0]}
    model = Model(Base.of(stage, 0.05)).with_effect(
        EffectSpec(friction_table.NAME, {"table": flat})
    )

    def reached(model, fitted, freedom):  # type: ignore[no-untyped-def]
        return SimpleNamespace(model=model, fitted=fitted, freedom=freedom, fit=None)

    monkeypatch.setattr(friction_table, "judge", lambda _q, _h, m, *_: reached(m, finer, 6))
    rivals = [
        reached(model.with_effect(EffectSpec(name, {})), 200.0, 7) for name in ("cogging", "drift")
    ]
    base, said = reached(model, 0.0, 4), []
    found = friction_table.no_patch(None, None, base, rivals, said.append)
    assert [r.model.names[-1] for r in found] == kept
    assert len(said) == (len(kept) < 2)
    bare = reached(Model(Base.of(stage, 0.05)), 0.0, 0)
    assert friction_table.no_patch(None, None, bare, rivals, said.append) == rivals


def test_twice_the_knots_of_a_smooth_table_lie_on_its_curve(stage):  # type: ignore[no-untyped-def]
    grid = np.linspace(0.0, 0.05, 5)
    table = {"grid": grid.tolist(), "positive": (1.0 + np.sin(60.0 * grid)).tolist()}
    table["negative"] = [2.0] * 5
    model = Model(Base.of(stage, 0.05)).with_effect(
        EffectSpec(friction_table.NAME, {"table": table})
    )
    for begun, most in ((model, 0.2), (friction_table._smooth(model), 0.02)):
        found = friction_table._finer(begun)
        assert found is not None
        assert found.effects[0].options == begun.effects[0].options
        finer = found.effects[0].parameters["table"]
        assert len(finer["grid"]) == 9
        left = np.abs(np.array(finer["positive"]) - 1.0 - np.sin(60.0 * np.array(finer["grid"])))
        assert left.max() < most

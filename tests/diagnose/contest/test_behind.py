"""Dry friction behind a spring that the model lacks."""

from dataclasses import replace

import pytest

from ffl.diagnose.contest.behind import behind_its_mode
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.screen.screen import Screen
from ffl.effects import EFFECTS
from ffl.systems.plant import EffectSpec

MODE = EffectSpec("flexible_mode", {"frequency": 31.0, "damping": 0.03, "mass_fraction": 0.6})
BEHIND = EffectSpec("coulomb_friction", {"level": 2.0}, {"side": "load"})
YIELDS = {"level": 2.0, "stiffness": 7e4, "micro_damping": 30.0}


@pytest.fixture(scope="module")
def conveyor(stage, record, scenes):  # type: ignore[no-untyped-def]
    return scenes(record(replace(stage, effects=(MODE, BEHIND))))


@pytest.mark.parametrize(
    "standing",
    [
        pytest.param([EffectSpec("presliding_friction", YIELDS)], id="friction that yields"),
        pytest.param(
            [replace(MODE, parameters={**MODE.parameters, "frequency": 28.0})], id="a mode"
        ),
    ],
)
def test_it_is_found_where_its_halves_stand(conveyor, standing):  # type: ignore[no-untyped-def]
    scene, held, model = conveyor
    for spec in standing:
        model = model.with_effect(spec)
    said: list[str] = []
    found = behind_its_mode(scene, held, judge(scene, held, model), said.append)
    assert found is not None
    assert found.model.names == ("flexible_mode", "coulomb_friction")
    mode, friction = found.model.effects
    assert mode.parameters["frequency"] == pytest.approx(31.0, rel=5e-3)
    assert mode.parameters["mass_fraction"] == pytest.approx(0.6, rel=5e-3)
    assert friction.parameters["level"] == pytest.approx(2.0, rel=5e-3)
    assert friction.options["side"] == "load"
    assert "at the load" in said[0]


def test_nothing_is_looked_for_where_noise_is_all_that_is_left(stage, record, scenes):  # type: ignore[no-untyped-def]
    plain = EffectSpec("coulomb_friction", {"level": 2.0})
    scene, held, model = scenes(record(replace(stage, effects=(plain,))))
    current = judge(scene, held, model.with_effect(plain))
    assert behind_its_mode(scene, held, current, pytest.fail) is None


def test_what_rubs_is_screened_at_a_load_that_hangs_there(conveyor):  # type: ignore[no-untyped-def]
    scene, held, model = conveyor
    friction = EFFECTS["coulomb_friction"]
    alone = judge(scene, held, model, 1)
    hung = judge(scene, held, model.with_effect(MODE), 1)
    assert Place("force", "load") not in Screen(scene, alone.fit).places(friction)
    assert Place("force", "load") in Screen(scene, hung.fit).places(friction)

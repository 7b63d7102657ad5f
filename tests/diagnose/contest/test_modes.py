"""A flexible mode that settled in another valley of its cost is begun elsewhere."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.modes import mode_elsewhere
from ffl.systems.plant import EffectSpec

TRUE = {"frequency": 110.0, "damping": 0.02, "mass_fraction": 0.2}
MODE = EffectSpec("flexible_mode", TRUE)
SLOW = replace(MODE, parameters={"frequency": 9.0, "damping": 0.3, "mass_fraction": 0.02})
FRICTION = EffectSpec("coulomb_friction", {"level": 2.0})


def quiet(line):
    pass


@pytest.fixture(scope="module")
def shaken(stage, record, scenes):
    return scenes(record(replace(stage, effects=(MODE,)), 0))


def test_a_mode_in_another_valley_comes_to_what_the_true_one_explains(shaken):
    scene, held, model = shaken
    standing = judge(scene, held, replace(model, effects=(SLOW,)), 6)
    assert abs(standing.model.effects[0].parameters["frequency"] / 110.0 - 1.0) > 0.3
    said = []
    found = mode_elsewhere(scene, held, standing, said.append)
    # Moves tell little but the spring, (2 pi f)^2 times the hung mass: as likely as what is true.
    true = judge(scene, held, replace(model, effects=(MODE,)), 6)
    assert found.score > standing.score + 100.0
    assert found.score > true.score - 3.0
    assert any("begun elsewhere" in line for line in said)


def test_one_that_foretells_to_noise_stays(shaken):
    scene, held, model = shaken
    standing = judge(scene, held, replace(model, effects=(MODE,)), 6)
    assert mode_elsewhere(scene, held, standing, quiet) is None


def test_nothing_is_begun_without_a_mode_or_without_judges(shaken):
    scene, held, model = shaken
    astray = judge(scene, held, replace(model, effects=(FRICTION,)), 1)
    assert mode_elsewhere(scene, held, astray, quiet) is None
    standing = judge(scene, None, replace(model, effects=(SLOW,)), 1)
    assert mode_elsewhere(scene, None, standing, quiet) is None

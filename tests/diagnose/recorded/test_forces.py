"""The picture of the force that the linear model lacks, by the effects that are forces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.recorded.where import forces
from ffl.systems import EffectSpec

DRY = EffectSpec("coulomb_friction", {"level": 2.0})
LIMIT = EffectSpec("saturation", {"limit": 1.0})


@pytest.mark.parametrize("effects", [(DRY, LIMIT), (LIMIT, DRY)])
def test_what_a_limit_cuts_off_is_no_law_of_friction(stage, record, scenes, effects):
    """Whichever of them was found first."""
    scene, _, model = scenes(record(replace(stage, effects=effects)))
    drawn = forces(scene, replace(model, effects=effects))
    assert np.abs(drawn.fitted).max() == pytest.approx(2.0, rel=1e-6)
    assert forces(scene, replace(model, effects=(LIMIT,))) is None


def test_forces_behind_an_amplifier_are_drawn_where_an_observer_leads(stage, record, scenes):
    """There the machine is run behind its amplifier, whose effects are not among those of the run."""
    lost, effects = EffectSpec("dead_zone", {"half_width": 0.2}), (DRY,)
    scene, _, model = scenes(record(replace(stage, effects=(lost, *effects))))
    led = replace(model, base=replace(model.base, observed=True), effects=(*effects, lost))
    drawn = forces(scene, led)
    assert np.abs(drawn.fitted).max() == pytest.approx(2.0, rel=1e-6)

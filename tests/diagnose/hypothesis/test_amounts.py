"""One number said twice: by the linear model's own, and by an effect of its kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.hypothesis.amounts import as_effect, netted
from ffl.systems.plant import EffectSpec


def test_a_change_of_a_corrected_mass_is_of_that(stage, record, scenes):  # type: ignore[no-untyped-def]
    """(A loudspeaker with 0.77 times the mass, and 1.299 times that, was 0.05 % of a mass as an effect.)"""
    scene, _, model = scenes(record(stage))
    own, change = -0.2305, 0.299
    both = replace(model, corrections={"mass": own, "damping": 0.1})
    both = both.with_effect(EffectSpec("mass_change", {"change": change}))
    whole = (1.0 + own) * (1.0 + change) - 1.0
    one = netted(scene, both, "mass")
    assert one is not None
    assert not one.effects
    assert one.corrections["mass"] == pytest.approx(whole, rel=1e-12)
    other = as_effect(both, "mass")
    assert other is not None
    assert "mass" not in other.corrections
    assert other.effects[0].parameters["change"] == pytest.approx(whole, rel=1e-12)
    runs = [replace(m, held=frozenset()).simulate(scene.trials[0]).y for m in (both, one, other)]
    assert np.abs(runs[1] - runs[0]).max() < 1e-6 * np.ptp(runs[0])
    assert np.abs(runs[2] - runs[0]).max() < 1e-6 * np.ptp(runs[0])


def test_a_change_of_mass_beyond_the_line_stays(stage, record, scenes):  # type: ignore[no-untyped-def]
    """Added up they would be within it: -19 % and +20 %, which is 2.8 % less."""
    scene, _, model = scenes(record(stage))
    both = replace(model, corrections={"mass": -0.19})
    assert (
        netted(scene, both.with_effect(EffectSpec("mass_change", {"change": 0.2})), "mass") is None
    )

"""A spring tightened against a stop is told from others by its step, friction beside it or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.machines import SimulatedMachine
from ffl.systems.plant import EffectSpec

PRELOAD = EffectSpec("preloaded_spring", {"preload": 3.0, "centre": 0.012, "width": 0.0004})
SPRING = EffectSpec("linear_stiffness", {"stiffness": 60.0, "centre": 0.012})
FRICTION = EffectSpec("coulomb_friction", {"level": 1.0})


@pytest.mark.parametrize("hidden", [(PRELOAD,), (SPRING,), (PRELOAD, FRICTION)])
def test_a_preload_is_named_where_there_is_one(stage, references, hidden):  # type: ignore[no-untyped-def]
    machine = SimulatedMachine(replace(stage, effects=hidden))
    rng = np.random.default_rng(6)
    fit, held = (machine.run(r, np.zeros_like(r), rng) for r in references)
    answer = diagnose(stage, [fit], [held]).answer()
    assert answer["verdict"] == "explained"
    found = {e["name"]: e["parameters"] for e in answer["effects"]}
    assert set(found) == {spec.name for spec in hidden}
    for spec in hidden:
        for name, true in spec.parameters.items():
            within = 4.0 * found[spec.name][name]["std_error"] + 0.02 * true
            assert abs(found[spec.name][name]["value"] - true) < within

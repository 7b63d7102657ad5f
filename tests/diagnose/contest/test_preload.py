"""A spring tightened against a stop is told from others by its step, friction beside it or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.effects import EFFECTS
from ffl.effects.motion import Extent
from ffl.machines import SimulatedMachine
from ffl.systems.plant import EffectSpec

PRELOAD = EffectSpec("preloaded_spring", {"preload": 3.0, "centre": 0.012, "width": 0.0004})
SPRING = EffectSpec("linear_stiffness", {"stiffness": 60.0, "centre": 0.012})
FRICTION = EffectSpec("coulomb_friction", {"level": 1.0})


@pytest.mark.slow(50)
@pytest.mark.parametrize("hidden", [(PRELOAD,), (SPRING,), (PRELOAD, FRICTION)])
def test_a_preload_is_named_where_there_is_one(stage, references, hidden):  # type: ignore[no-untyped-def]
    machine = SimulatedMachine(replace(stage, effects=hidden))
    rng = np.random.default_rng(6)
    fit, held = (machine.run(r, np.zeros_like(r), rng) for r in (r[:1700] for r in references))
    answer = diagnose(stage, [fit], [held]).answer()
    assert answer["verdict"] == "explained"
    found = {e["name"]: e["parameters"] for e in answer["effects"]}
    assert set(found) == {spec.name for spec in hidden}
    for spec in hidden:
        for name, true in spec.parameters.items():
            within = 4.0 * found[spec.name][name]["std_error"] + 0.02 * true
            assert abs(found[spec.name][name]["value"] - true) < within


@pytest.mark.parametrize(("highest", "told"), [(0.17, True), (0.15, False)])
def test_a_spring_of_which_one_end_alone_was_passed_is_none(highest, told):
    """From 0.117 m on a stop pushes, as a spring about 0.1316 m does whose other side a load undoes; its
    other end, at 0.1462 m, was hardly passed where the travel ends at 0.15 m."""
    values = {"preload": 1.294, "centre": 0.1316, "width": 0.0146}
    spring = EffectSpec("preloaded_spring", values)
    reach = Extent(8.0, 0.2, lowest=-0.05, highest=highest)
    assert EFFECTS[spring.name].credible(spring, reach) is told

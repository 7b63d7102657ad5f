"""An arm that its weight pulls down is told from a spring where it turns far enough for them to differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.machines import SimulatedMachine
from ffl.systems.plant import EffectSpec


@pytest.mark.parametrize(("reach", "unit"), [(1.2, "rad"), (0.1, "rad"), (1.2, "m")])
def test_gravity_is_named_where_an_angle_goes_far(stage, references, reach, unit):  # type: ignore[no-untyped-def]
    plant = replace(stage, output_unit=unit)
    pull = EffectSpec("gravity_torque", {"amplitude": 4.0, "centre": 0.2})
    machine = SimulatedMachine(replace(plant, effects=(pull,)))
    rng = np.random.default_rng(4)
    fit, held = (
        machine.run(r, np.zeros_like(r), rng)
        for r in (np.asarray(r) * reach / np.max(np.abs(r)) for r in references)
    )
    answer = diagnose(plant, [fit], [held]).answer()
    names = {effect["name"] for effect in answer["effects"]}
    if reach > 1.0 and unit == "rad":
        assert answer["verdict"] == "explained"
        assert names == {"gravity_torque"}
        found = answer["effects"][0]["parameters"]
        for name, true in (("amplitude", 4.0), ("centre", 0.2)):
            assert abs(found[name]["value"] - true) < 4.0 * found[name]["std_error"] + 1e-3 * true
    else:
        assert "gravity_torque" not in names
        assert answer["verdict"] in ("explained", "partly_explained", "unnamed")

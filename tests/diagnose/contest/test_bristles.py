"""A Bouc-Wen loop with both shapes at 1 is LuGre's bristle, and is told by the plainer name."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffl.diagnose.contest.bristles import as_bristle
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import prepare
from ffl.systems.plant import EffectSpec

LEVEL, WAY = 3.0, 1e-3  # N, m
BRISTLE = EffectSpec(
    "presliding_friction",
    {"level": LEVEL, "stiffness": LEVEL / WAY, "micro_damping": 0.0},
    {"kind": "lugre"},
)


def loop(exponent, beta):  # type: ignore[no-untyped-def]
    values = {"force": LEVEL, "displacement": WAY, "exponent": exponent, "beta": beta}
    return EffectSpec("hysteresis", values)


@pytest.mark.parametrize(
    ("machine", "said"),
    [
        (BRISTLE, "presliding_friction"),
        (loop(2.0, 0.5), "hysteresis"),
        (loop(1.0, 0.7), "hysteresis"),
    ],
)
def test_a_loop_is_a_bristle_only_where_both_shapes_are_one(stage, record, machine, said):  # type: ignore[no-untyped-def]
    recordings = record(replace(stage, effects=(machine,)))
    base = Base.of(stage, 0.1)
    trials = tuple(prepare(base.simulator, r, 1e-7) for r in recordings)
    scene = Scene(stage.loop, trials, Noise(1e-7, 2e-3))
    begun = loop(1.0, 1.0) if machine is BRISTLE else machine
    judged = judge(scene, None, Model(base).with_effect(begun), rounds=6)
    outcome = Outcome(judged, [], None, {"hysteresis": [("hysteresis", judged)]})
    found, after = as_bristle(replace(scene, trials=trials[:1]), judged, outcome)
    assert found.model.names == (said,)
    if said == "presliding_friction":
        numbers = found.model.effects[0].parameters
        assert numbers["level"] == pytest.approx(LEVEL, rel=0.01)
        assert numbers["stiffness"] == pytest.approx(LEVEL / WAY, rel=0.03)
        assert [name for name, _ in after.contenders[said]] == [said]
    else:
        assert found is judged

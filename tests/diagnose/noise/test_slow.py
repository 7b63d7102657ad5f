"""Slow noise under an observer is no physics, and what is there is more than slow noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.noise.slow import slowly
from ffl.machines import Simulator
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec, Imperfections

STEP = 0.001


def shaken(stage, references, effects, seed):  # type: ignore[no-untyped-def]
    """Recordings of u and y alone, under force noise of 0.3 N that lasts half a second."""
    rng = np.random.default_rng(seed)
    simulator = Simulator(stage)
    out = []
    for k, r in enumerate(references):
        n, stay = len(r), np.exp(-STEP / 0.5)
        slow = np.zeros(n)
        drive = np.sqrt(1 - stay**2) * rng.standard_normal(n)
        for i in range(1, n):
            slow[i] = stay * slow[i - 1] + drive[i]
        force = 0.3 / 12.0 * slow + 0.002 * rng.standard_normal(n)
        seen = 1e-7 * rng.standard_normal(n)
        run = simulator.run(effects, r, force=force, noise=seen)
        out.append(Recording.from_signals(STEP, u=run.u, y=run.y, source=f"slow_{k}.csv"))
    return out


@pytest.mark.slow(20)
@pytest.mark.parametrize("seed", [1, 2])
def test_slow_noise_of_an_unknown_loop_is_no_physics(stage, references, seed):  # type: ignore[no-untyped-def]
    fit, judge = shaken(stage, references, (), seed)
    blind = replace(stage, controller=None, machine=Imperfections())
    answer = diagnose(blind, [fit], [judge]).answer()
    assert answer["verdict"] == "nothing_missing"


@pytest.mark.usefixtures("no_play_sought")
def test_friction_beside_slow_noise_is_named(stage, references):  # type: ignore[no-untyped-def]
    dry = EffectSpec("coulomb_friction", {"level": 3.0})
    fit, judge = shaken(stage, references, (dry,), 1)
    blind = replace(stage, controller=None, machine=Imperfections())
    answer = diagnose(blind, [fit], [judge]).answer()
    (found,) = answer["effects"]  # in 3 s slow noise is as good as a load
    assert found["name"] in ("coulomb_friction", "asymmetric_friction")
    levels = [number["value"] for number in found["parameters"].values()]
    assert np.mean(levels) == pytest.approx(3.0, abs=0.3)


@pytest.mark.parametrize(
    ("names", "others", "slow"),
    [
        (("linear_stiffness",), (), True),
        (("hysteresis", "drift"), ("drift",), True),
        (("constant_load", "coulomb_friction"), ("constant_load",), False),
        (("constant_load", "coulomb_friction"), ("coulomb_friction",), True),
        (("input_delay",), (), False),
        (("drift",), ("drift",), False),
    ],
)
def test_only_what_goes_by_place_or_time_may_be_slow_noise(names, others, slow):  # type: ignore[no-untyped-def]
    assert slowly(names, others) is slow

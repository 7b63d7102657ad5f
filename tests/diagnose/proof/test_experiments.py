"""References that a machine can be given: within what it has been seen to do, from rest to rest."""

from __future__ import annotations

import numpy as np
import pytest

from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.proof.experiments import Limits, closed_loop_designs, limits
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import Simulator
from ffl.recordings import Recording
from ffl.systems import Controller, Plant, Zpk

FAST = Limits(-0.1, 0.1, 1.0, 20.0, (-10.0, 10.0), 4.0)
SLOW = Limits(0.0, 1.0, 0.1, 0.05, (-10.0, 10.0), 20.0)  # a stroke takes as long as a design may
CRAWLS = Limits(0.0, 1.0, 0.004, 0.002, (-1.0, 1.0), 6.0)
STEP = 1e-3


@pytest.mark.parametrize("lim", [FAST, SLOW, CRAWLS])
def test_designs_are_within_what_was_seen_and_end_where_they_began(lim):
    texts = []
    for design in closed_loop_designs(lim, STEP):
        r = design.reference
        texts.append(design.text)
        assert r[0] == pytest.approx(0.0, abs=1e-12)
        assert r[-1] == pytest.approx(0.0, abs=1e-9)
        assert np.abs(r).max() <= 0.5 * lim.stroke
        assert np.abs(np.diff(r)).max() <= 1.001 * lim.speed * STEP
        assert np.abs(np.diff(r, 2)).max() <= 1.001 * lim.acceleration * STEP**2
        assert len(r) * STEP < 2.2 * max(10.0, lim.duration)
    whole = "an amplitude ladder: the same move at a quarter, half and full stroke"
    assert (whole in texts) == (lim is FAST)  # else it says on how much of the stroke


def test_a_ladder_on_a_part_of_the_stroke_has_all_its_rungs():
    ladder = next(d for d in closed_loop_designs(SLOW, STEP) if "ladder" in d.text)
    share = float(ladder.text.split(" on ")[1].split(" %")[0]) / 100.0
    half = 0.48 * SLOW.stroke * share
    heights = {
        round(float(h), 9) for h in ladder.reference[np.diff(ladder.reference, append=0.0) == 0.0]
    }
    for rung in (0.25, 0.5, 1.0):
        assert {round(s * rung * half, 9) for s in (1, -1)} <= heights


def test_a_speed_has_its_own_derivatives_for_limits():
    """What limits a reference of speeds is how fast they change."""
    integrator = Zpk([0.98], [1.0], 0.5, STEP)
    fan = Plant(
        "fan",
        Zpk([], [1.0 - STEP], 100.0 * STEP, STEP),
        Controller.of_error(integrator),
        "V",
        "rad/s",
    )
    t = np.arange(8000) * STEP
    r = 100.0 * np.clip((t - 0.5) / 0.25, 0.0, 1.0) - 200.0 * np.clip((t - 2.0) / 0.5, 0.0, 1.0)
    run = Simulator(fan).run((), r)
    recording = Recording.from_signals(STEP, y=run.y, u=run.u, r=r)
    base = Base.of(fan, float(np.ptp(run.y)), 8.0)
    lim = limits(Model(base), [prepare(base.simulator, recording, 1e-3)])
    rates = np.abs(np.gradient(run.y, STEP))
    assert lim.speed == pytest.approx(float(np.quantile(rates, 0.999)), rel=1e-6)
    assert lim.stroke == pytest.approx(float(np.ptp(run.y)))

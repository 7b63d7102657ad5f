"""A limit that falls with speed is not a fixed one: it is unnamed, and told by its law."""

from __future__ import annotations

import re

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.recordings import Recording

PIECES = 20  # of a sample


def limited(plant, reference, law, seed):  # type: ignore[no-untyped-def]
    """A recording of a mass whose force is cut off at what `law` (A) leaves at its speed."""
    lead = plant.controller.output
    zero, pole, gain = lead.zeros[0].real, lead.poles[0].real, lead.gain
    rng, noise, step = np.random.default_rng(seed), plant.machine, plant.sample_time
    strength = plant.physics.motor_constant / plant.physics.mass
    x = v = sent = before = 0.0
    u, y = np.empty(len(reference)), np.empty(len(reference))
    for k, wanted in enumerate(reference):
        y[k] = x + noise.sensor_noise * rng.standard_normal()
        error = wanted - y[k]
        sent = u[k] = pole * sent + gain * (error - zero * before)
        before = error
        shaken = noise.force_noise * rng.standard_normal()
        for _ in range(PIECES):
            most = law(abs(v))
            a = strength * (min(max(sent, -most), most) + shaken)
            x += (v + 0.5 * a * step / PIECES) * step / PIECES
            v += a * step / PIECES
    t, none = step * np.arange(len(u)), np.zeros(len(u))
    return Recording(
        t, np.asarray(reference), none, u, y, sample_time=step, source=f"run_{seed}.csv"
    )


@pytest.fixture(scope="module")
def answered(stage, references):  # type: ignore[no-untyped-def]
    def of(law):  # type: ignore[no-untyped-def]
        runs = [limited(stage, r, law, k) for k, r in enumerate(references)]
        return diagnose(stage, runs[:1], runs[1:], rng=np.random.default_rng(1)).answer()

    return of


@pytest.mark.slow(30)
@pytest.mark.usefixtures("no_play_sought")
def test_a_limit_that_falls_with_speed_is_unnamed_and_told_by_its_law(answered) -> None:  # type: ignore[no-untyped-def]
    answer = answered(lambda speed: 1.9 - 1.4 * speed)
    assert answer["verdict"] == "unnamed"
    assert not answer["effects"]
    place = answer["location"]
    assert place["component"] == "actuator"
    assert set(place["depends_on"]) == {"command", "velocity"}
    limit, fall = map(float, re.findall(r"(\d+\.?\d*) (?:A|\|v)", place["formula"])[:2])
    assert limit == pytest.approx(1.9, rel=0.01)
    assert fall == pytest.approx(1.4, rel=0.05)
    assert answer["validation"]["nrmse_with_map"] < 0.05 * answer["validation"]["nrmse_before"]


def test_a_fixed_limit_keeps_its_name(answered) -> None:  # type: ignore[no-untyped-def]
    answer = answered(lambda speed: 1.6)
    assert answer["verdict"] == "explained"
    assert [effect["name"] for effect in answer["effects"]] == ["saturation"]
    limit = answer["effects"][0]["parameters"]["limit"]
    assert limit["value"] == pytest.approx(1.6, rel=0.01)

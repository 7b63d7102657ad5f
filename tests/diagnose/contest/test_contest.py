"""Names against maps: what recordings that hardly tell the two apart leave to the fitted ones, periods
that nothing shows to repeat, and bursts that a map leaves."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.maps import choosing, unnamed
from ffl.diagnose.maps.depends import needed_variables
from ffl.diagnose.maps.outcome import Contest
from ffl.diagnose.maps.unnamed import _after, _drawn, compare
from ffl.diagnose.proof.verdict import _nameless
from ffl.diagnose.recorded.events import Events
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec

BEND = 0.1  # 1/m
CUT = {"amplitude_2": 0.5, "phase_2": 0.1, "amplitude_3": 0.3, "phase_3": 0.2}


def bent(plant, reference, seed, bend=BEND):  # type: ignore[no-untyped-def]
    """The stage seen by a sensor whose scale is bent: y = x + c x^2, by repetition."""
    rng = np.random.default_rng(seed)
    n, simulator, noise = len(reference), Simulator(plant), plant.machine
    shaken = noise.force_noise * rng.standard_normal(n)
    seen, shown = noise.sensor_noise * rng.standard_normal(n), np.zeros(n)
    for _ in range(12):
        run = simulator.run((), reference, force=shaken, noise=seen + shown)
        shown = bend * run.x**2
    return Recording(
        run.t, np.asarray(reference), np.zeros(n), run.u, run.y, sample_time=plant.sample_time,
        source=f"run_{seed}.csv",
    )  # fmt: skip


def test_where_held_out_recordings_tell_nothing_the_fitted_ones_decide(stage, references, scenes):  # type: ignore[no-untyped-def]
    scene, held, model = scenes(
        [bent(stage, references[0], 1), bent(stage, 0.02 * references[1], 2)]
    )
    gain = EffectSpec(
        "position_dependent_gain",
        {"centre": 0.02, "linear_coefficient": 0.1, "quadratic_coefficient": 0.1},
    )
    named = fit(scene, model.with_effect(gain), rounds=20)
    found = compare(scene, held, model, named, np.random.default_rng(0))
    assert found.verdict == "unnamed"
    assert found.variables == ("position",)
    assert found.alone.port == "output"


def test_a_number_held_on_the_line_is_free_beside_a_map(stage, references, scenes, monkeypatch):  # type: ignore[no-untyped-def]
    """Where friction passed for damping, that was held for nobody to be named by it: beside it a map of
    that friction did not hold on the recordings that judge."""
    scene, held, model = scenes([bent(stage, references[0], 1), bent(stage, references[1], 2)])
    on_line = replace(model, corrections={"damping": 0.4}, held=frozenset({"damping"}))
    begun = []
    real = unnamed.free_form
    monkeypatch.setattr(
        unnamed, "free_form", lambda *a, **k: begun.append(real(*a, **k)) or begun[-1]
    )
    found = compare(scene, held, model, fit(scene, on_line, rounds=2), np.random.default_rng(0))
    assert found.verdict == "unnamed"
    first = begun[0][0].free.model
    assert not first.held
    assert abs(first.corrections["damping"]) < 0.1


@pytest.mark.parametrize(
    ("period", "harmonics", "drawn"), [(0.03, CUT, True), (0.03, {}, False), (0.01, CUT, False)]
)
def test_a_period_not_held_twice_draws_any_map(stage, scenes, references, period, harmonics, drawn):  # type: ignore[no-untyped-def]
    _, _, model = scenes([bent(stage, references[0], 1)])
    model = replace(model, base=replace(model.base, travel=0.05))
    values = {"amplitude": 1.0, "period": period, "phase": 0.0, **harmonics}
    assert _drawn(model.with_effect(EffectSpec("cogging", values))) is drawn


def test_bursts_that_a_map_leaves_are_said_beside_it():
    term = SimpleNamespace(variables=("command",), driver="")
    part = SimpleNamespace(term=term, place=Place("command"))
    alone = SimpleNamespace(parts=[part], variables=("command",), ranking=(), alike=())
    loud, calm = Events(16.0, 1e4, ((0.9, 1.2),)), Events(1.4, 5e2, ())
    quiet = Contest("unnamed", alone, None, 188.0, 138.0, calm, ("command",))
    assert _nameless(quiet).where == "beside the command: large or small commands"
    stop = SimpleNamespace(term=SimpleNamespace(variables=("position",)), place=Place("force"))
    either = SimpleNamespace(**{**vars(alone), "alike": (stop,)})
    said = _nameless(replace(quiet, alone=either)).where
    assert said.endswith("large or small commands, or as well a force: places along the stroke")
    both = replace(quiet, events=loud, variables=("command", "time"))
    said = _nameless(both)
    assert said.depends_on == ("command", "time")
    assert said.where.startswith("beside the command: large or small commands; and bursts")


def test_what_maps_leave_must_come_in_bursts_plain_to_see(stage, references, scenes):  # type: ignore[no-untyped-def]
    scene, _, model = scenes([bent(stage, references[0], 1, bend=0.0)])
    left = scene.residuals(model)[0]

    def after(size):  # type: ignore[no-untyped-def]
        knock = np.zeros(len(left))
        for at in (400, 1300, 2200):
            knock[at : at + 40] = size
        residual = left + stage.loop.process_sensitivity.filter(knock)
        free = SimpleNamespace(output=lambda t: t.y - residual, substeps=1)
        return _after(SimpleNamespace(scene=scene, free=free))

    assert not after(0.0).found
    assert after(1.0).found


def test_a_plainer_map_that_leaves_more_on_the_recordings_that_judge_is_not_as_good(monkeypatch):  # type: ignore[no-untyped-def]
    """A limit that falls with speed for one that does not: 1.48 and 1.73 fitted, 1.66 and 2.75 held out."""
    monkeypatch.setattr(choosing, "score_of", lambda f, current: f.score)

    def left(score, fitted, held):  # type: ignore[no-untyped-def]
        return SimpleNamespace(score=score, cost=fitted, held_cost=held)

    best, plainer, far = left(1000.0, 1.48, 1.66), left(990.0, 1.73, 2.75), left(985.0, 2.1, 1.7)
    assert choosing.no_worse([best, plainer, far], None) == [best]
    as_good, poor = left(980.0, 1.7, 1.9), left(900.0, 1.4, 1.6)
    assert choosing.no_worse([poor, best, as_good], None) == [best, as_good]
    # One leaves least where it was fitted, the other where others judge: the better score stays.
    assert choosing.no_worse([best, left(995.0, 1.0, 9.0)], None) == [best]
    assert choosing.no_worse([left(995.0, 9.0, 1.0), best], None) == [best]


def test_heat_is_of_the_command_however_its_blocks_are_moved_about():
    part = SimpleNamespace(term=SimpleNamespace(along="heat"))
    assert needed_variables(None, None, np.zeros(1), part, np.random.default_rng(0)) == {}

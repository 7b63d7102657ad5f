"""Effects that have no name: maps, their formula, bursts, and the experiment that is advised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.challenge.make import null_case
from ffl.diagnose import diagnose
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.hypothesis.triangle import triangle
from ffl.diagnose.maps.form import held_gain
from ffl.diagnose.maps.freeform import free_form
from ffl.diagnose.maps.freemodel import FreeModel, evidence
from ffl.diagnose.maps.gains import left_alone
from ffl.diagnose.maps.grids import ranges_of
from ffl.diagnose.maps.picture import _asked
from ffl.diagnose.maps.terms import TERMS
from ffl.diagnose.maps.unnamed import _beside_numbers
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.proof.advise import separate
from ffl.diagnose.recorded.events import events
from ffl.diagnose.recorded.states import linear_share, states
from ffl.diagnose.recorded.trials import prepare
from ffl.effects import Motion
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording, read_recording
from ffl.report.diagnosis import write
from ffl.systems import load_plant
from ffl.systems.plant import EffectSpec

BEGINS, STIFFNESS = 0.03, 400.0


def recorded(plant, reference, force, rng, name):  # type: ignore[no-untyped-def]
    """The stage with a force (N) that is a function of its motion, found by repetition."""
    simulator = Simulator(plant)
    noise = plant.machine
    shaken = noise.force_noise * rng.standard_normal(len(reference))
    seen = noise.sensor_noise * rng.standard_normal(len(reference))
    added = np.zeros(len(reference))
    for _ in range(12):
        run = simulator.run(
            plant.effects, reference, force=shaken, noise=seen,
            applied=(added / plant.physics.motor_constant, ("sensor", None)),
        )  # fmt: skip
        added = force(run.x, run.v)
    zero = np.zeros(len(reference))
    return Recording(
        run.t, np.asarray(reference), zero, run.u, run.y, sample_time=plant.sample_time, source=name
    )


def buffer(x, v):  # type: ignore[no-untyped-def]
    return -STIFFNESS * np.maximum(0.0, x - BEGINS)


@pytest.fixture(scope="module")
def stopped(stage, references, play_left_alone):  # type: ignore[no-untyped-def]
    """Three moves each."""
    rng = np.random.default_rng(3)
    fitted, judging = (
        recorded(stage, r[:2000], buffer, rng, f"run_{k}.csv")
        for k, r in enumerate(references[::-1])
    )
    with play_left_alone():
        return diagnose(stage, [fitted], [judging])


@pytest.mark.slow(40)
def test_a_rubber_stop_is_unnamed_with_its_variable_and_formula(stopped):  # type: ignore[no-untyped-def]
    answer = stopped.answer()
    assert answer["verdict"] == "unnamed"
    assert answer["effects"] == []
    place = answer["location"]
    assert place["depends_on"] == ["position"]
    assert place["port"] == "a force"
    said = place["formula"]
    assert said.startswith("force = -")
    assert "max(0, position - 0.03" in said
    stiffness = float(said.split("-")[1].split()[0])
    assert stiffness == pytest.approx(STIFFNESS, rel=0.03)
    proof = answer["validation"]
    assert proof["nrmse_with_map"] < 1.3 * proof["noise_floor"] < 0.1 * proof["nrmse_before"]


def test_dots_beside_a_map_are_what_the_data_carry(stopped):  # type: ignore[no-untyped-def]
    """Not the map again: of what y does not show none is asked for, whatever the map says."""
    winner = stopped.nameless.winner
    (part,) = winner.free.parts
    n = len(winner.scene.trials[0])
    t = np.arange(n) * winner.scene.trials[0].sample_time
    nothing = np.zeros(n)
    shown = 0.5 * np.sin(2 * np.pi * t) ** 2
    asked = _asked(winner.scene, winner.free, part, nothing, shown)
    assert np.std(asked - shown) < 0.1 * np.std(shown)
    level = _asked(winner.scene, winner.free, part, nothing, np.full(n, 0.5))
    assert np.median(level) == pytest.approx(0.5, rel=0.1)
    hidden = 1e-3 * np.sin(2 * np.pi * 200.0 * t)
    asked = _asked(winner.scene, winner.free, part, nothing, hidden)
    assert np.std(asked) < 0.1 * np.std(hidden)


def test_the_experiment_stays_within_what_was_seen_and_is_a_file(stopped, stage, tmp_path):  # type: ignore[no-untyped-def]
    e = stopped.experiment
    assert e is not None
    assert e.separation > 5.0
    assert "experiment.csv" in stopped.advice[0]
    low = min(o.y.min() for o in stopped.proof.overlays)
    assert e.r.min() > low - 0.005
    assert e.r.max() < 0.11
    write(stopped, tmp_path)
    table = np.loadtxt(tmp_path / "experiment.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, 1], e.r, rtol=1e-10, atol=1e-15)
    assert (tmp_path / "experiment.csv").read_text().startswith("t,r,f\n")
    assert "What has no name" in (tmp_path / "report.html").read_text()
    rows = np.column_stack([table, np.zeros(len(table)), np.cumsum(table[:, 1])])
    np.savetxt(tmp_path / "back.csv", rows, delimiter=",", header="t,r,f,u,y", comments="")
    assert len(read_recording(tmp_path / "back.csv")) == len(e.t)


@pytest.mark.parametrize(
    ("number", "seed"),
    [
        pytest.param(2, 2053, id="a map beside corrections that held-out data refute"),
        pytest.param(96, 2053, id="scatter that lost commands would explain a little"),
        pytest.param(325, 2089, id="a damper elsewhere for which a mode was named"),
    ],
)
def test_noise_alone_is_not_called_physics(number, seed, tmp_path):  # type: ignore[no-untyped-def]
    null_case(number, seed).save(tmp_path)
    plant = load_plant(tmp_path / "plant.toml")
    fitted, judging = (
        [read_recording(f, sample_time=plant.sample_time) for f in sorted(tmp_path.glob(name))]
        for name in ("fit_*.csv", "validate_*.csv")
    )
    found = diagnose(plant, fitted, judging, rng=np.random.default_rng(number)).answer()
    assert found["verdict"] == "nothing_missing"


@pytest.fixture
def motion():  # type: ignore[no-untyped-def]
    t = np.arange(2000) * 1e-3
    x = 0.1 * np.sin(2 * np.pi * t) + 0.02 * np.sin(14.0 * t)
    v, a = np.gradient(x, 1e-3), np.gradient(np.gradient(x, 1e-3), 1e-3)
    return Motion(t, x, 2.0 * np.cos(5.0 * t), x, v, a, 1e-3)


@pytest.mark.parametrize("term", TERMS, ids=lambda t: t.name)
def test_a_map_is_its_columns_times_its_coefficients(term, motion):  # type: ignore[no-untyped-def]
    ranges = ranges_of([motion])
    columns = term.columns(motion, ranges)
    c = np.random.default_rng(0).standard_normal(columns.shape[1])
    signal = term.signal(motion, ranges, c)
    tolerance = 0.05 if term.name == "inertia by position" else 1e-9  # slope at the knots
    np.testing.assert_allclose(signal, columns @ c, atol=tolerance * np.abs(columns @ c).max())


@pytest.mark.parametrize("term", TERMS, ids=lambda t: t.name)
def test_priors_are_proper(term, motion):  # type: ignore[no-untyped-def]
    ranges = ranges_of([motion])
    for length in term.lengths:
        kernel = term.kernel(ranges, length)
        assert kernel.shape[0] == term.columns(motion, ranges).shape[1]
        assert np.linalg.eigvalsh(kernel).min() > -1e-8 * np.trace(kernel)


def test_evidence_is_there_for_a_map_and_not_for_noise(motion):  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(1)
    ranges, term = ranges_of([motion]), TERMS[0]
    table = term.columns(motion, ranges)
    noise = rng.standard_normal(len(table))
    assert evidence(term, ranges, table, noise).gain < 3.0
    assert evidence(term, ranges, table, noise + 0.5 * np.cos(40 * motion.x)).gain > 50.0


def test_triangle_by_blocks_is_that_of_the_whole():  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(2)
    table, target = rng.standard_normal((5000, 7)), rng.standard_normal(5000)
    r, q = triangle(table, target)
    np.testing.assert_allclose(r.T @ r, table.T @ table, rtol=1e-9)
    np.testing.assert_allclose(r.T @ q, table.T @ target, rtol=1e-8, atol=1e-8)


def test_held_out_gain_has_the_sign_of_what_was_gained():  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(3)
    white = rng.standard_normal(4000)
    everything = np.ones(4000, bool)
    worse = white + 2.0 * np.sin(np.arange(4000) / 30)
    assert held_gain(worse, white, everything) > 100.0
    assert held_gain(white, worse, everything) < -100.0
    assert held_gain(white, worse, ~everything) == 0.0


# --- on the stage ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scene(stage, references):  # type: ignore[no-untyped-def]
    base = Base.of(stage)
    rng = np.random.default_rng(4)
    nothing = lambda x, v: 0.0 * x  # noqa: E731
    run = recorded(stage, references[0], nothing, rng, "quiet.csv")
    return Scene(stage.loop, (prepare(base.simulator, run, 1e-7),), Noise(1e-7, 2e-3)), Model(base)


def test_a_model_without_maps_is_the_model(scene):  # type: ignore[no-untyped-def]
    ground, model = scene
    found = FreeModel(model).simulate(ground.trials[0])
    np.testing.assert_array_equal(found[0].y, model.simulate(ground.trials[0]).y)


def test_knocks_are_events_and_noise_is_not(scene, stage):  # type: ignore[no-untyped-def]
    ground, model = scene
    quiet = ground.residuals(model)
    assert not events(ground, quiet).found
    knock = np.zeros(len(quiet[0]))
    for at in (400, 1300, 2200):
        knock[at : at + 40] = 0.3
    trace = stage.loop.process_sensitivity.filter(knock)
    seen = events(ground, [quiet[0] + trace])
    assert seen.found
    assert all(any(a - 0.1 < at < b + 0.1 for a, b in seen.stretches) for at in (0.4, 1.3, 2.2))


def test_a_recording_noisier_than_the_others_is_no_event(scene):  # type: ignore[no-untyped-def]
    ground, model = scene
    (quiet,) = ground.residuals(model)
    three = replace(ground, trials=ground.trials * 3)
    assert not events(three, [quiet, 3.0 * quiet, 2.0 * quiet]).found


def test_noise_that_grows_and_a_beginning_are_no_events(scene):  # type: ignore[no-untyped-def]
    ground, model = scene
    (quiet,) = ground.residuals(model)
    grown = quiet * np.exp(np.linspace(0.0, 1.8, len(quiet)))
    assert not events(ground, [grown]).found
    begun = quiet.copy()
    begun[:40] += 20.0 * np.std(quiet) * np.exp(-np.arange(40) / 10.0)
    assert not events(ground, [begun]).found
    later = quiet.copy()
    for at in (400, 1300, 2200):
        later[at : at + 40] += 20.0 * np.std(quiet) * np.exp(-np.arange(40) / 10.0)
    assert events(ground, [later]).found


def test_a_residual_that_follows_the_reference_is_linear(scene):  # type: ignore[no-untyped-def]
    ground, _model = scene
    reference = ground.trials[0].reference
    share = linear_share(ground, [0.3 * np.roll(reference, 4)])
    assert share is not None
    assert share > 0.9
    noise = np.random.default_rng(5).standard_normal(len(reference))
    assert linear_share(ground, [noise]) < 0.3


def test_states_say_when_it_is_loud(scene):  # type: ignore[no-untyped-def]
    ground, model = scene
    motion = model.simulate(ground.trials[0]).motion()
    loud = np.where(np.abs(motion.v) > 0.6 * np.abs(motion.v).max(), 10.0, 1.0)
    assert states(loud, [motion])[0].name == "fast motion"


def test_rivals_are_told_apart_by_what_they_would_do(scene):  # type: ignore[no-untyped-def]
    ground, model = scene
    friction = model.with_effect(EffectSpec("coulomb_friction", {"level": 8.0}))
    viscous = model.with_effect(EffectSpec("viscous_friction", {"coefficient": 20.0}))
    e = separate(ground, friction, fit(ground, viscous, rounds=0), ("coulomb", "viscous"))
    assert e is not None
    assert e.separation > 50.0
    assert e.separation == max(value for _, value in e.tried)
    again = separate(ground, friction, fit(ground, friction, rounds=0), ("one", "the same"))
    assert again.separation < 1e-6
    assert again.idle


def test_an_experiment_in_which_a_rival_runs_away_is_not_proposed(scene):  # type: ignore[no-untyped-def]
    ground, model = scene
    viscous = fit(ground, model.with_effect(EffectSpec("viscous_friction", {"coefficient": 20.0})))
    falls = model.with_effect(EffectSpec("linear_stiffness", {"stiffness": -3e4, "centre": 0.0}))
    assert separate(ground, falls, viscous, ("falls", "viscous")) is None


@pytest.mark.parametrize(
    ("names", "count"),
    [
        ({"hardening_spring": {"cubic_coefficient": 1e4}, "mass_change": {"change": 0.05}}, 1),
        ({"linear_stiffness": {"stiffness": 40.0}, "quadratic_drag": {"coefficient": 3.0}}, 2),
    ],
)
def test_more_mass_is_no_second_name_for_one_map(stage, names, count):  # type: ignore[no-untyped-def]
    """The model beside a map has its mass free as well (20261228/0038: unnamed by a spring)."""
    effects = tuple(EffectSpec(name, values) for name, values in names.items())
    assert _beside_numbers(Model(Base.of(stage), effects=effects)) == count


@pytest.mark.parametrize("level", [0.0, 8.0])
def test_maps_found_beside_a_name_do_as_much_alone_where_the_name_is_none(
    stage, references, scenes, level
):  # type: ignore[no-untyped-def]
    """A rubber stop beside a friction that is stated, and is there or is not."""
    friction = EffectSpec("coulomb_friction", {"level": level})
    machine = replace(stage, effects=(friction,) if level else ())
    runs = [
        recorded(machine, r, buffer, np.random.default_rng(k), f"run_{k}")
        for k, r in enumerate(references)
    ]
    scene, held, nominal = scenes(runs)
    named = nominal.with_effect(EffectSpec("coulomb_friction", {"level": 8.0}))
    beside = free_form(scene, held, named)[-1]
    assert [part.term.variables for part in beside.parts] == [("position",)]
    alone = left_alone(beside, nominal)
    assert alone is not None
    assert alone.free.model.names == ()
    assert [part.term for part in alone.parts] == [part.term for part in beside.parts]
    if level:
        assert alone.cost > 3.0 * beside.cost
    else:
        assert alone.cost < 1.02 * beside.cost

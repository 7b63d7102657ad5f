"""A play of the measuring head that a loop cycles across: told by prediction, with who else is missing."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate
import scipy.signal
import scipy.stats

from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise, partly_coloured
from ffl.diagnose.predict.clipped import _behind_play, _side, _turned
from ffl.diagnose.predict.company import forces_along
from ffl.diagnose.predict.joining import Company, exchanged, in_step, joined, proven
from ffl.diagnose.predict.loose_head import (
    able,
    brought,
    claimed,
    regapped,
    rescanned,
    spared,
    start,
    whitened,
    with_loose_head,
)
from ffl.diagnose.predict.moving import bracketed, vague
from ffl.diagnose.predict.rattling import hopeless
from ffl.diagnose.predict.slipping import Slip
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.systems import EffectSpec

GAP = 4e-4
PLAY = EffectSpec("backlash", {"gap": GAP}, {"kind": "play"})
LATE = EffectSpec("input_delay", {"delay": 2.5e-3})
SPRING = EffectSpec("hardening_spring", {"cubic_coefficient": 2e4, "centre": 0.0})
HUM = EffectSpec("periodic_disturbance", {"amplitude": 1.0, "frequency": 7.3, "phase": 0.4})
NOISE = Noise(1e-6, 2e-3)


@pytest.fixture(scope="module")
def seen(stage, references):  # type: ignore[no-untyped-def]
    """(fitted scene, held-out scene, model without effects) of a machine with these effects."""
    known = replace(stage, machine=replace(stage.machine, sensor_noise=NOISE.sensor))

    def of(*effects, seed=0, samples=3000):  # type: ignore[no-untyped-def]
        rng = np.random.default_rng(seed)
        machine = SimulatedMachine(replace(known, effects=effects))
        runs = [machine.run(r, 0 * r, rng) for r in (r[:samples] for r in references)]
        base = Base.of(known, max(float(np.ptp(r.y)) for r in runs))
        trials = [prepare(base.simulator, r, NOISE.sensor) for r in runs]
        return *(Scene(known.loop, (t,), NOISE) for t in trials), Model(base)

    return of


@pytest.mark.parametrize(("low", "high"), [(-np.inf, -1.0), (-1.0, 0.5), (1.0, 3.0), (2.0, np.inf)])
def test_moments_of_a_side(low, high):
    d = scipy.stats.truncnorm(low, high)
    share, mean, square = _side(low, high)
    assert share == pytest.approx(scipy.stats.norm.cdf(high) - scipy.stats.norm.cdf(low), rel=1e-9)
    assert (mean, square) == (pytest.approx(d.mean(), rel=1e-7), pytest.approx(d.var(), rel=1e-6))


@pytest.mark.parametrize("y", [-0.6, 0.0, 0.3, 1.2])
def test_density_behind_a_play_has_a_peak_for_each_side(y):
    centre, doubt, own, half = 0.7, 0.4, 0.3, 0.5  # of the stretch and of what moves the head
    x, p = np.array([0.2, centre]), np.diag([own**2, doubt**2])
    room = np.zeros(2), np.zeros((3, 2)), np.zeros((3, 2))
    _, _, log = _behind_play(x, p, *room, np.array([1.0, -1.0]), 1, (-half, half), y, 0.01)
    stretch = scipy.stats.norm(centre, doubt)

    def density(z):
        held = np.clip(z, -half, half)
        return stretch.pdf(z) * scipy.stats.norm.pdf(y, 0.2 - held, np.sqrt(own**2 + 0.01))

    wanted = scipy.integrate.quad(density, centre - 8 * doubt, centre + 8 * doubt, limit=200)[0]
    # What lies within the play is truncated, and taken for Gaussian: in its tail that shows.
    assert log == pytest.approx(np.log(wanted), abs=0.06 if y < 1.0 else 0.5)
    assert abs(x[1]) <= half
    assert np.all(np.linalg.eigvalsh(p) >= -1e-12)


def test_free_runs_part_where_prediction_does_not(seen):
    scene, _, model = seen(PLAY)
    right = model.with_effect(PLAY)
    free = scene.whiten(scene.residuals(right))
    foretold = Slip(right, NOISE).predict(scene.trials)[0]
    assert np.mean(foretold**2) < 1.5
    assert np.mean(free**2) > 8.0 * np.mean(foretold**2)


@pytest.mark.parametrize("spec", [SPRING, HUM])
def test_forces_along_the_motion_are_taken_where_the_machine_is(seen, spec):
    """Foretold with the force as with none, where there is none of either."""
    scene, _, model = seen(PLAY, spec)
    both = Slip(replace(model, effects=(spec, PLAY)), NOISE)
    alone = Slip(model.with_effect(PLAY), NOISE)
    assert both.scaled(scene.trials)[1] < 1.2
    assert both.scaled(scene.trials)[0] > alone.scaled(scene.trials)[0] + 1000.0
    at, aside = (forces_along(scene.trials[0], [spec], d)[0] for d in (0.0, 1e-3))
    assert np.array_equal(at, aside) == (spec is HUM)


@pytest.mark.slow(20)
def test_a_play_is_named_with_who_is_missing_beside_it(seen):
    scene, held, model = seen(LATE, PLAY, samples=1800)
    standing = judge(scene, held, model, 4)
    lines: list[str] = []
    before = Outcome(standing, [], held, {})
    outcome = with_loose_head(scene, held, before, model, NOISE, lines.append)
    found = outcome.standing
    assert found.predicted
    assert [line.split(" of ")[0] for line in lines[1:]] == [
        "  a gap",
        "  a gap",
    ]  # it takes minutes
    assert set(found.model.names) >= {"backlash"}
    assert set(found.model.names) <= {"backlash", "input_delay", "actuator_lag"}
    values = {name: value for e in found.model.effects for name, value in e.parameters.items()}
    assert values["gap"] == pytest.approx(GAP, rel=0.03)
    assert values.get("delay", values.get("time_constant")) == pytest.approx(2.5e-3, rel=0.2)
    beside = next(name for name in found.model.names if name != "backlash")
    assert {"input_delay", "actuator_lag"} <= {name for name, _ in outcome.contenders[beside]}


@pytest.mark.parametrize(
    "effects", [(), (EffectSpec("coulomb_friction", {"level": 2.0}),), (SPRING,)]
)
def test_nothing_is_named_where_no_play_foretells_more(seen, effects):
    scene, held, model = seen(*effects)
    before = Outcome(judge(scene, held, model, 4), [], held, {})
    assert with_loose_head(scene, held, before, model, NOISE) is before


def test_clocks_are_moved_to_where_a_hum_is_in_step(seen):
    scene, _, model = seen(PLAY, HUM)
    right = Slip(replace(model, effects=(HUM, PLAY)), NOISE)
    late = tuple(replace(t, start_time=t.start_time + 0.05) for t in scene.trials)
    again = in_step(right, late, 0)
    turn = (again[0].start_time - scene.trials[0].start_time) * 7.3
    assert turn - round(turn) == pytest.approx(0.0, abs=0.02)
    assert in_step(Slip(model.with_effect(PLAY), NOISE), late, 0) == late
    assert in_step(right, late, 1) == late


@pytest.mark.parametrize("gone", [(), (HUM,)], ids=["", "beside one who has left since"])
def test_who_foretells_better_in_anothers_place_takes_it(seen, gone):
    scene, _, model = seen(LATE, PLAY)
    lag = EffectSpec("actuator_lag", {"time_constant": 2.5e-3})
    begun = Slip(replace(model, effects=(lag, PLAY)), NOISE)
    rival = replace(begun, model=replace(model, effects=(*gone, LATE, PLAY)))
    company = Company(begun, scene.trials, {"actuator_lag": rival})
    after = exchanged(company, regapped)
    assert after.found.model.names == ("input_delay", "backlash")
    assert set(after.rivals) == {"input_delay"}
    assert after.rivals["input_delay"].model.names == ("actuator_lag", "backlash")
    assert joined(replace(after, rivals={}), scene, able, regapped).found.model.names == (
        "input_delay",
        "backlash",
    )


def test_no_gap_is_begun_with_where_none_is(seen):
    scene, _, model = seen()
    assert start(scene, model, model) is None


def test_who_is_not_missed_goes(seen):
    scene, _, model = seen(LATE, PLAY)
    idle = EffectSpec("constant_load", {"force": 1e-3})
    begun = Slip(replace(model, effects=(LATE, idle, PLAY)), NOISE)
    after = proven(Company(begun, scene.trials), regapped)
    assert after.found.model.names == ("input_delay", "backlash")


def test_rivals_tried_beside_one_who_left_are_none(seen):
    """Of two that joined the first stays and the second makes room: who was tried in the first's place
    was so beside the second, and is no rival in the company there is now."""
    scene, _, model = seen(LATE, HUM, PLAY)
    lag = EffectSpec("actuator_lag", {"time_constant": 2.5e-3})
    load = EffectSpec("constant_load", {"force": 0.1})

    def slip(*effects):
        return Slip(replace(model, effects=effects), NOISE)

    rivals = {"periodic_disturbance": slip(load, lag, PLAY), "actuator_lag": slip(HUM, LATE, PLAY)}
    company = Company(slip(HUM, lag, PLAY), scene.trials, rivals)
    after = exchanged(company, lambda found, trials: found)
    assert after.found.model.names == ("periodic_disturbance", "input_delay", "backlash")
    assert set(after.rivals) == {"input_delay"}
    assert after.rivals["input_delay"].model.names[1] == "actuator_lag"


def test_a_play_is_spared_where_what_was_named_foretells_better_and_no_play_beside_it(seen):  # type: ignore[no-untyped-def]
    scene, _, told = seen(SPRING)
    alone = Slip(replace(told, effects=(replace(PLAY, parameters={"gap": 1e-4}),)), NOISE)
    named = replace(told, effects=(SPRING,))
    assert spared(alone, scene, named)
    assert not spared(alone, scene, told)  # nothing was named
    scene, _, told = seen(SPRING, PLAY)
    assert not spared(
        Slip(replace(told, effects=(PLAY,)), NOISE), scene, replace(told, effects=(SPRING,))
    )


def test_a_play_far_behind_is_not_gone_on_with(seen):  # type: ignore[no-untyped-def]
    """One that is there may be behind by a quarter of what its gap brings, others by no more than 1,000."""
    tiny = replace(PLAY, parameters={"gap": 1e-9})
    for there, begun, less, says in [(SPRING, tiny, 900.0, False), (SPRING, tiny, 1100.0, True),
                                     (PLAY, PLAY, 1100.0, False)]:  # fmt: skip
        scene, held, told = seen(there)
        play = Slip(told.with_effect(begun), NOISE)
        standing = judge(scene, held, told)
        standing = replace(standing, fitted=play.scaled(scene.trials)[0] + less)
        there = brought(play, scene)
        assert hopeless(play, scene, standing, lambda there=there: there) is says


@pytest.mark.parametrize(("error", "says"), [(0.4, False), (0.6, True), (1.5, True)])
def test_a_play_no_wider_than_its_error_is_no_play(seen, error, says):
    """An encoder that loses counts is foretold by a play of 35 +- 65 um."""
    model = seen()[2].with_effect(PLAY)
    spread = np.zeros(len(model.theta))
    at = [c.name for c in model.coordinates].index("gap")
    spread[at] = error * (1.0 if model.coordinates[at].log else GAP)
    assert vague(model, spread, np.diag(spread**2)) is says


@pytest.mark.parametrize(("together", "says"), [(0.95, False), (0.5, True)])
def test_how_the_masses_are_shared_is_no_doubt_of_a_play(seen, together, says):
    """A gap that goes with the share is told as well as it is where the share is known."""
    options = {"kind": "coupling", "mass_ratio": 0.7, "damping": 0.04}
    model = seen()[2].with_effect(replace(PLAY, options=options))
    (share,) = [k for k, c in enumerate(model.coordinates) if c.name == "mass_ratio"]
    at = [c.name for c in model.coordinates].index("gap")
    spread = np.full(len(model.theta), 0.1)
    spread[at] = 0.6 * GAP
    covariance = np.diag(spread**2)
    covariance[at, share] = covariance[share, at] = together * spread[at] * spread[share]
    assert vague(model, spread, covariance) is says


def test_a_play_is_looked_for_beside_what_was_named_of_the_drive(seen):  # type: ignore[no-untyped-def]
    """Beside a dead zone that no filter has all gaps of the grid are one as good as the other."""
    zone = EffectSpec("dead_zone", {"half_width": 0.06})
    scene, _, told = seen(zone, PLAY)
    found = start(scene, told, told.with_effect(zone))
    assert found is not None
    assert found.model.names == ("dead_zone", "backlash")
    assert found.model.effects[1].parameters["gap"] == pytest.approx(GAP, rel=0.1)


def test_a_play_is_looked_for_beside_what_balances_the_forces(seen):  # type: ignore[no-untyped-def]
    """A load holds the head to one side of its play: without it no gap foretells anything."""
    scene, _, told = seen(EffectSpec("constant_load", {"force": 12.0}), PLAY)
    found = start(scene, told, told)
    assert found is not None
    assert found.model.names == ("constant_load", "backlash")
    assert found.model.effects[0].parameters["force"] == pytest.approx(12.0, rel=0.05)
    assert found.model.effects[1].parameters["gap"] == pytest.approx(GAP, rel=0.1)


def test_a_gap_is_told_where_half_of_it_and_more_are_far_behind(seen):  # type: ignore[no-untyped-def]
    scene, _, told = seen(PLAY)
    found = Slip(told.with_effect(PLAY), NOISE)
    assert bracketed(found, scene.trials, 300.0)
    tiny = Slip(told.with_effect(replace(PLAY, parameters={"gap": 1e-9})), NOISE)
    assert not bracketed(tiny, scene.trials, 300.0)


def test_a_gain_by_position_beside_a_play_is_told_from_where_no_mass_is_missing(seen):  # type: ignore[no-untyped-def]
    values = {"linear_coefficient": 3.0, "quadratic_coefficient": 0.0, "centre": 0.02}
    name = "position_dependent_gain"
    scene, _, told = seen(EffectSpec(name, values), PLAY)
    there = 1.0 + 3.0 * 0.01  # the gain 10 mm away, where it is taken for 1
    moved = {"linear_coefficient": 3.0 / there, "quadratic_coefficient": 0.0, "centre": 0.03}
    model = replace(told, effects=(EffectSpec(name, moved), PLAY))
    model = replace(model, corrections={"mass": 1.0 / there - 1.0})
    found = claimed(Slip(model, NOISE), scene)
    assert found.model.names == (name, "backlash")
    assert abs(found.model.corrections["mass"]) < 0.01
    assert found.model.effects[0].parameters["centre"] == pytest.approx(0.02, abs=0.005)


def test_a_play_is_held_to_the_peak_of_a_motion_that_turns_between_samples(stage):  # type: ignore[no-untyped-def]
    """Shaken at 40 Hz a stage has gone further than where either sample sees it."""
    known = replace(stage, machine=replace(stage.machine, sensor_noise=NOISE.sensor))
    time = known.sample_time * np.arange(1500)
    shaken = 4e-3 * np.sin(2 * np.pi * 40.0 * time) * np.minimum(time / 0.1, 1.0)
    rng = np.random.default_rng(5)
    run = SimulatedMachine(replace(known, effects=(PLAY,))).run(shaken, 0 * shaken, rng)
    base = Base.of(known, float(np.ptp(run.y)))
    trial = prepare(base.simulator, run, NOISE.sensor)
    found = Slip(Model(base).with_effect(PLAY), NOISE)
    white, _ = found.predict([trial])
    assert np.mean(white**2) < 1.2  # 3.5 where it is held to the samples
    assert found.scaled([trial])[0] == pytest.approx(
        rescanned(found, [trial]).scaled([trial])[0], abs=5.0
    )


@pytest.mark.parametrize(("before", "after"), [(3.0, -1.0), (-0.5, 2.0), (1.0, 0.5), (4.0, -9.0)])
def test_walls_of_a_play_after_a_step(before, after):
    """Along a parabola, ending on the wall's side where it was pushed: the stretch of a dense path."""
    share = np.linspace(0.0, 1.0, 20001)
    path = before * share + 0.5 * (after - before) * share**2
    stretch = np.sign(before)
    for step in np.diff(path):
        stretch = min(max(stretch + step, -1.0), 1.0)
    low, high = _turned(1.0, before, after)
    assert np.clip(np.sign(before) + path[-1], low, high) == pytest.approx(stretch, abs=1e-3)


@pytest.mark.parametrize("slow", [False, True])
def test_noise_is_as_slow_as_it_foretells_better(stage, references, slow):  # type: ignore[no-untyped-def]
    rng, size = np.random.default_rng(3), 0.02
    prior = Noise(NOISE.sensor, size)
    known = replace(stage, machine=replace(stage.machine, sensor_noise=NOISE.sensor))
    shakes, more = size * rng.standard_normal((2, len(references[0])))
    if slow:
        pole = np.exp(-2 * np.pi * 30.0 * stage.sample_time)
        more = scipy.signal.lfilter([np.sqrt(1 - pole**2)], [1.0, -pole], more)
        shakes = (shakes + more) / np.sqrt(2.0)
    machine = SimulatedMachine(replace(known, effects=(PLAY,)))
    run = replace(machine.run(references[0], None, rng, load=shakes), d=None)
    base = Base.of(known, float(np.ptp(run.y)))
    scene = Scene(known.loop, (prepare(base.simulator, run, NOISE.sensor),), partly_coloured(prior))
    begun = Slip(Model(base).with_effect(PLAY), scene.noise)
    found, heard = whitened(begun, scene, prior, scene.trials)
    assert heard.noise == found.noise == (scene.noise if slow else prior)
    assert found.worth(scene.trials) >= begun.worth(scene.trials)


@pytest.mark.parametrize(("places", "stay"), [(3, False), (9, True)])
def test_a_long_table_keeps_its_shape_while_a_play_is_looked_for(seen, places, stay):  # type: ignore[no-untyped-def]
    scene, _, model = seen(PLAY, samples=900)
    grid = np.linspace(-0.06, 0.06, places).tolist()
    flat = {"grid": grid, "positive": [1.0] * places, "negative": [1.0] * places}
    rough = EffectSpec("position_dependent_friction", {"level": 0.2, "table": flat})
    begun = Slip(replace(model, effects=(rough, PLAY)), NOISE)
    found = regapped(begun, scene.trials)
    assert found.worth(scene.trials) > begun.worth(scene.trials)
    assert (found.model.effects[0].parameters["table"] == flat) is stay

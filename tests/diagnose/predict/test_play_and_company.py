"""A play between two masses beside dry friction, a damper on one side or a gain by position."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_rattling import NOISE, STEP, path, plant, rigid, scene_of  # noqa: F401

from ffl.diagnose.contest.dry import DRY
from ffl.diagnose.noise.noise import partly_coloured
from ffl.diagnose.predict import joining
from ffl.diagnose.predict.balance import humming, rubbing
from ffl.diagnose.predict.dry_forms import _alike, formed
from ffl.diagnose.predict.foretold import refitted
from ffl.diagnose.predict.joining import Company, proven
from ffl.diagnose.predict.moving import doubted
from ffl.diagnose.predict.play import LOOSENESS, Hypothesis, able, settled
from ffl.diagnose.predict.rattling import accompanied, barer, dampers
from ffl.diagnose.predict.starting import started
from ffl.diagnose.predict.switching import _clipped, _passing
from ffl.machines import SimulatedMachine
from ffl.systems import Controller, EffectSpec, Physics, Plant, Zpk

GAP, RATIO = 5e-4, 0.7
PLAY = EffectSpec(
    "backlash", {"gap": GAP}, {"kind": "coupling", "mass_ratio": RATIO, "damping": 0.04}
)
LEVELS = {"level_positive": 12.0, "level_negative": 7.0}
RUBS = EffectSpec("asymmetric_friction", LEVELS, {"side": "load", "mass_ratio": RATIO})


def recorded(plant, *specs, seed=0):  # noqa: F811
    machine = SimulatedMachine(replace(plant, effects=specs))
    rng = np.random.default_rng(seed)
    paths = (p[:2000] for p in (path(1, -1, 1, -1), path(1, 1, -1, -1)))
    return [machine.run(r, 0 * r, rng) for r in paths]


@pytest.mark.parametrize("middle", [0.0, 0.7, -2.5])
@pytest.mark.parametrize("spread", [0.05, 1.0, 20.0])
def test_the_mean_of_a_clipped_gaussian_is_that_of_many_draws(middle, spread):
    drawn = middle + spread * np.random.default_rng(1).standard_normal(400_000)
    clipped = np.clip(drawn, -1.0, 2.0)
    mean, inside, rest = _clipped(middle, spread, -1.0, 2.0)
    assert mean == pytest.approx(clipped.mean(), abs=0.01)
    assert inside == pytest.approx(np.mean(clipped == drawn), abs=0.005)
    assert rest <= 0.25 * 3.0**2 + 1e-12  # no force in between says more than both ends


@pytest.mark.parametrize("depth", [-1.4, 0.0, 0.3, 5.0])
@pytest.mark.parametrize(("spread", "way"), [(0.5, 0.02), (0.5, 1.0), (0.05, -2.0), (1e-6, 2.0)])
def test_a_contact_on_the_way_is_averaged_over_it(depth, spread, way):
    """Gaussian at every moment, its mean going evenly: against draws of both."""
    rng = np.random.default_rng(2)
    seen = rng.uniform(-0.5, 0.5, 400_000) * way + spread * rng.standard_normal(400_000)
    share, more, wide, steep = _passing(depth, spread, way)
    deep = np.maximum(depth + seen, 0.0)
    assert share == pytest.approx(np.mean(depth + seen > 0.0), abs=0.004)
    assert share * depth + more == pytest.approx(deep.mean(), abs=0.005)
    assert 0.0 <= wide <= np.var(deep) + 1e-3
    step = 0.05 * max(spread, abs(way))
    ends = [_passing(depth + s * step, spread, way)[0] for s in (1.0, -1.0)]
    assert steep == pytest.approx((ends[0] - ends[1]) / (2.0 * step), rel=0.05, abs=0.03)


def test_friction_on_the_load_is_foretold_with_the_play(plant):  # noqa: F811
    scene, model = scene_of(plant, recorded(plant, PLAY, RUBS))
    both = Hypothesis(replace(model, effects=(RUBS, PLAY)), NOISE)
    alone = Hypothesis(replace(model, effects=(PLAY,)), NOISE)
    white, _ = both.predict(scene.trials)
    assert np.mean(white**2) < 2.0
    assert both.scaled(scene.trials)[0] > alone.scaled(scene.trials)[0] + 2000.0


@pytest.mark.parametrize("levels", [LEVELS, {"level_positive": 0.0, "level_negative": 0.0}])
def test_levels_are_read_from_the_balance_of_forces(plant, levels):  # noqa: F811
    effects = (PLAY, replace(RUBS, parameters=levels)) if levels is LEVELS else (PLAY,)
    scene, model = scene_of(plant, recorded(plant, *effects))
    found = {spec.name: spec.parameters for spec in rubbing(scene.trials, model)}
    if levels is LEVELS:
        for name, level in levels.items():
            assert found["asymmetric_friction"][name] == pytest.approx(level, rel=0.4)
    else:
        assert max(found.get("asymmetric_friction", {"none": 0.0}).values()) < 1.0


@pytest.mark.parametrize("amplitude", [6.0, 0.0])
def test_a_disturbance_is_read_from_the_balance_of_forces(plant, amplitude):  # noqa: F811
    """In the phase of the first recording, and with clocks that are not known on clocks in step with it."""
    hum = EffectSpec(
        "periodic_disturbance", {"amplitude": amplitude, "frequency": 3.3, "phase": 0.4}
    )
    scene, model = scene_of(plant, recorded(plant, PLAY, RUBS, hum))
    late = [replace(t, start_time=t.start_time + 0.05 * k) for k, t in enumerate(scene.trials)]
    scene = replace(scene, trials=tuple(late), free_clocks=True)
    on, sines = humming(scene, model)
    if not amplitude:
        assert not sines
        assert on is scene
        return
    (sine,) = sines
    assert sine.parameters["frequency"] == pytest.approx(3.3, rel=0.02)
    assert sine.parameters["amplitude"] == pytest.approx(6.0, rel=0.4)
    assert sine.parameters["phase"] == pytest.approx(0.4, abs=0.6)
    assert on.trials[1].start_time == pytest.approx(on.trials[0].start_time, abs=0.03)


def test_a_recording_at_standstill_says_nothing_of_a_disturbance(plant):  # noqa: F811
    hum = EffectSpec("periodic_disturbance", {"amplitude": 6.0, "frequency": 3.3, "phase": 0.4})
    runs = recorded(plant, PLAY, RUBS, hum)
    still = replace(runs[0], r=0 * runs[0].r, y=0 * runs[0].y, u=0 * runs[0].u)
    scene, model = scene_of(plant, [still, runs[1]])
    assert len(humming(scene, model)[1]) == 1
    scene, model = scene_of(plant, [still, still])
    assert not humming(scene, model)[1]


def test_a_damper_is_read_from_the_balance_of_forces(plant):  # noqa: F811
    damper = EffectSpec(
        "viscous_friction", {"coefficient": 80.0}, {"side": "motor", "mass_ratio": RATIO}
    )
    scene, model = scene_of(plant, recorded(plant, PLAY, damper))
    found = {spec.name: spec.parameters for spec in rubbing(scene.trials, model)}
    assert found["viscous_friction"]["coefficient"] == pytest.approx(80.0, rel=0.3)


def test_a_damper_is_read_beside_a_force_that_is_known(plant):  # noqa: F811
    """A slow sine of time takes most of what a damper would, until it is told."""
    pull = EffectSpec("drift", {"amplitude": 25.0, "time_constant": 0.8})
    damper = EffectSpec("viscous_friction", {"coefficient": 30.0})
    scene, model = scene_of(plant, recorded(plant, pull, damper, PLAY))

    def read(*beside):  # type: ignore[no-untyped-def]
        found = {s.name: s.parameters for s in rubbing(scene.trials, model, beside)}
        return found["viscous_friction"]["coefficient"]

    assert read(pull) == pytest.approx(30.0, rel=0.1)
    assert abs(read() - 30.0) > 2.0 * abs(read(pull) - 30.0)


def test_recordings_begin_when_others_did(plant):  # noqa: F811
    scene, _ = scene_of(plant, recorded(plant))
    later = [replace(trial.head(50), start_time=3.0 + k) for k, trial in enumerate(scene.trials)]
    moved = joining.clocked(scene, later)
    assert [trial.start_time for trial in moved.trials] == [3.0 + k for k in range(len(later))]
    assert all(a.y is b.y for a, b in zip(moved.trials, scene.trials, strict=True))


def test_play_and_friction_are_found_together_and_the_friction_keeps_its_form(plant):  # noqa: F811
    scene, model = scene_of(plant, recorded(plant, PLAY, RUBS)[:1])
    scene = replace(scene, noise=partly_coloured(NOISE))
    begun, levels = started(scene, model, (), (), LOOSENESS, 2)
    assert begun is not None
    company = accompanied(settled(begun, scene, levels), scene)
    assert company.found.model.names == ("asymmetric_friction", "backlash")
    dry, play = company.found.model.effects
    assert dry.options["side"] == "load"
    assert play.parameters["gap"] == pytest.approx(GAP, rel=0.1)
    for name, level in LEVELS.items():
        assert dry.parameters[name] == pytest.approx(level, rel=0.1)
    assert set(company.rivals) <= DRY


def test_a_play_by_itself_gets_no_company(plant):  # noqa: F811
    scene, model = scene_of(plant, recorded(plant, PLAY))
    scene = replace(scene, noise=partly_coloured(NOISE))
    begun, levels = started(scene, model, (), (), LOOSENESS, 2)
    assert begun is not None
    assert accompanied(settled(begun, scene, levels), scene).found.model.names == ("backlash",)


@pytest.mark.slow(10)
def test_a_gain_by_position_joins_a_play(plant):  # noqa: F811
    gain = EffectSpec(
        "position_dependent_gain",
        {"linear_coefficient": 3.0, "quadratic_coefficient": 0.0, "centre": 0.02},
    )
    assert able(gain)
    scene, model = scene_of(plant, recorded(plant, PLAY, gain)[:1])
    scene = replace(scene, noise=partly_coloured(NOISE))
    begun, levels = started(scene, model, (), (), LOOSENESS, 2)
    assert begun is not None
    found = accompanied(settled(begun, scene, levels), scene).found
    assert found.model.names == ("position_dependent_gain", "backlash")


def test_a_ripple_of_the_encoder_joins_a_play(plant):  # noqa: F811
    """Without it the gap is far from what it is."""
    ripple = EffectSpec("encoder_ripple", {"amplitude": 3e-5, "period": 0.011, "phase": 2.0})
    scene, model = scene_of(plant, recorded(plant, PLAY, ripple))
    scene = replace(scene, noise=partly_coloured(NOISE))
    begun, levels = started(scene, model, (), (), LOOSENESS, 2)
    assert begun is not None
    alone = settled(begun, scene, levels)
    found = accompanied(alone, scene).found
    assert found.model.names == ("encoder_ripple", "backlash")
    assert found.worth(scene.trials) > alone.worth(scene.trials) + 1000.0
    assert found.model.effects[0].parameters["amplitude"] == pytest.approx(3e-5, rel=0.1)
    play = found.model.effects[1]
    seen = play.parameters["gap"] / (1.0 + float(play.options["mass_ratio"]))
    assert seen == pytest.approx(GAP / (1.0 + RATIO), rel=0.02)


def test_a_damper_is_tried_on_either_side_of_a_play():
    """Where y is the motor's: to first order it is the whole machine's own damping."""
    a = np.exp(-2 * np.pi * 8.0 * STEP)
    w = np.exp((-0.02 + 1j) * 2 * np.pi * 50.0 * STEP)
    v = np.exp((-0.02 + 1j) * 2 * np.pi * 35.0 * STEP)
    system = Zpk(np.array([v, v.conj(), -0.99]), np.array([1.0, 0.9995, w, w.conj()]), 1e-7, STEP)
    lead = Controller.of_error(Zpk(np.array([a]), np.array([0.7]), 500.0, STEP))
    motor = Plant("stage", system, lead, "A", "m", "for tests", Physics(5.0, 1.0))
    scene, model = scene_of(motor, recorded(motor))
    play = replace(PLAY, options={"kind": "coupling"})
    found = Hypothesis(replace(model, effects=(play,)), NOISE)
    tried = dampers(found, scene)
    assert {c.spec.options["side"] for c in tried} == {"motor", "load"}
    sizes = [s.parameters["coefficient"] for s in (tried[0].spec, *tried[0].valleys)]
    assert len(sizes) == 4
    assert sizes == sorted(sizes)
    damped = EffectSpec("viscous_friction", {"coefficient": 1.0}, {"side": "motor"})
    there = replace(found, model=replace(found.model, effects=(damped, play)))
    assert dampers(there, scene) == []


def test_a_contact_that_yields_stands_beside_the_play_of_a_load(rigid):  # noqa: F811
    load = {"kind": "load", "load_fraction": 0.45, "frequency": 150.0, "damping": 0.2}
    play = EffectSpec("backlash", {"gap": GAP}, {**load, "measured": "motor"})
    values = {"level": 8.0, "stiffness": 3e4, "micro_damping": 3.0}
    yields = EffectSpec("presliding_friction", values, {"kind": "maxwell_slip"})
    scene, model = scene_of(rigid, recorded(rigid, play, yields))
    scene = replace(scene, noise=partly_coloured(NOISE))
    dry = EffectSpec("coulomb_friction", {"level": 8.0})
    begun = Hypothesis(replace(model, effects=(dry, play)), scene.noise)
    found = formed(
        Company(refitted(begun, scene.trials), tuple(scene.trials)),
        lambda point, trials: refitted(point, trials),
    )
    assert found.found.model.names == ("presliding_friction", "backlash")
    assert "coulomb_friction" in {
        name for rival in found.rivals.values() for name in rival.model.names
    }
    told = found.found.model.effects[0].parameters
    assert told["level"] == pytest.approx(8.0, rel=0.03)
    assert told["stiffness"] == pytest.approx(3e4, rel=0.1)
    assert found.found.model.effects[-1].parameters["gap"] == pytest.approx(GAP, rel=0.1)
    fit = found.found.fit(scene.trials)
    sure = doubted(fit, found.found, scene.trials, 25.0)
    names = [c.name for c in found.found.model.coordinates]
    assert sure.spread[names.index("gap")] < 0.1 * GAP
    assert np.isinf(sure.spread[names.index("micro_damping")])  # which no sample sees


def test_a_force_along_the_motion_pushes_where_it_acts(plant):  # noqa: F811
    cogging = {"amplitude": 6.0, "period": 0.02, "phase": 0.3}
    on_load = EffectSpec("cogging", cogging, {"side": "load", "mass_ratio": RATIO})
    on_motor = replace(on_load, options={"side": "motor", "mass_ratio": RATIO})
    scene, model = scene_of(plant, recorded(plant, PLAY, on_load))
    worth = [
        Hypothesis(replace(model, effects=(*beside, PLAY)), NOISE).scaled(scene.trials)[0]
        for beside in ((on_load,), (on_motor,), ())
    ]
    assert worth[0] > max(worth[1:]) + 200.0


@dataclass(frozen=True)
class Seen:
    """What foretells recordings by so much."""

    model: Any
    worth: Any


def told(names, own, other):  # type: ignore[no-untyped-def]
    effects = tuple(EffectSpec(name, {}) for name in names)
    model = SimpleNamespace(names=names, effects=effects, coordinates=())
    model.without = lambda k: told(names[:k] + names[k + 1 :], 0.0, 0.0).model
    worth = {"fitted": own, "judging": other}
    return Seen(model, lambda trials: worth[trials[0]])


@pytest.mark.parametrize(
    ("fitted", "judging", "stays"),
    [(300.0, None, True), (116.0, 136.0, True), (116.0, 20.0, False), (40.0, 500.0, False),
     (116.0, None, False), (300.0, -100.0, False), (400.0, -100.0, True)],
)  # fmt: skip
def test_a_little_is_enough_where_recordings_that_judge_say_the_same(fitted, judging, stays):
    """Roughness has no reason to bring both; and what those lose, who joins must bring as well."""
    bare, both = (
        told(("backlash",), 0.0, 0.0),
        told(("encoder_ripple", "backlash"), fitted, judging or 0.0),
    )
    company = Company(both, ("fitted",), judging=("judging",) if judging else ())
    found = proven(company, lambda point, trials: bare if len(point.model.names) < 2 else point)
    assert (found.found.model.names == both.model.names) is stays


@pytest.mark.parametrize(("behind", "joins"), [(0.0, True), (2000.0, False)])
def test_who_a_wrong_mass_hides_joins_beside_none(monkeypatch, behind, joins):
    """By first-order gain: a refit from there is rough. None where that start is far behind."""
    massive, bare = told(("backlash",), 100.0, 0.0), told(("backlash",), 50.0 - behind, 0.0)
    zone = told(("dead_zone", "backlash"), 40.0 - behind, 0.0)
    sine = told(("periodic_disturbance", "backlash"), 60.0 - behind, 0.0)
    there = told(("dead_zone", "backlash"), 900.0, 0.0)

    def ranked(company, *_):  # type: ignore[no-untyped-def]
        ways = [joining._Way(sine, ("fitted",), 20.0), joining._Way(zone, ("fitted",), 248.0)]
        return ways if company.found is bare else []

    monkeypatch.setattr(joining, "_ranked", ranked)
    company = joining.joined(
        Company(massive, ("fitted",)),
        None,
        able,
        lambda point, trials: there if point is zone else point,
        barer=lambda found: bare,
    )
    assert company.found is (there if joins else massive)
    assert company.rivals == ({"dead_zone": sine} if joins else {})


def test_a_barer_start_has_neither_mass_nor_friction(plant):  # noqa: F811
    _, model = scene_of(plant, recorded(plant))
    heavy = replace(model, effects=(RUBS, PLAY), corrections={**model.corrections, "mass": 0.08})
    bare = barer(Hypothesis(heavy, NOISE))
    assert bare.model.names == ("backlash",)
    assert bare.model.corrections["mass"] == 0.0
    assert barer(bare) is None


def test_settling_is_no_worse_than_what_it_began_with(plant):  # noqa: F811
    scene, model = scene_of(plant, recorded(plant, PLAY, RUBS))
    under = replace(NOISE, force=30.0 * NOISE.force)  # friction that is not in the model
    begun = refitted(Hypothesis(replace(model, effects=(PLAY,)), under), scene.trials)
    found = settled(begun, replace(scene, noise=replace(NOISE, force=1e-3 * NOISE.force)), (1.0,))
    assert found.worth(scene.trials) >= begun.worth(scene.trials)


def test_levels_of_either_direction_are_alike_within_their_errors(plant):  # noqa: F811
    scene, model = scene_of(plant, recorded(plant, PLAY, RUBS))
    found = Hypothesis(replace(model, effects=(RUBS, PLAY)), NOISE)
    assert not _alike(RUBS, found, scene.trials)
    plain = replace(RUBS, parameters={"level_positive": 9.0, "level_negative": 9.0})
    same = replace(found, model=replace(model, effects=(plain, PLAY)))
    assert _alike(plain, same, scene.trials)

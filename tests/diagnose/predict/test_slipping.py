"""A filter that sticks and slips: its moments, its likelihood, and the friction that it tells in noise."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.integrate
import scipy.stats

from ffl.challenge import write
from ffl.challenge.draw import draw_noise, draw_setup, measure
from ffl.challenge.make import NullCase
from ffl.challenge.stage import Part, assemble
from ffl.challenge.stage import run as run_stage
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.predict import dry_in_noise
from ffl.diagnose.predict.clipped import _beyond
from ffl.diagnose.predict.dry_in_noise import with_dry_friction
from ffl.diagnose.predict.foretold import of_others, refitted
from ffl.diagnose.predict.slipping import FORMS, Slip, ease, finer, levels
from ffl.diagnose.recorded.trials import prepare
from ffl.recordings import read_recording
from ffl.systems import EffectSpec, load_plant
from ffl.systems.plant import Imperfections

LOUD = 0.5  # N, white
SKEWED = EffectSpec("asymmetric_friction", {"level_positive": 1.2, "level_negative": 2.4})
TABLE = {"grid": [-0.1, 0.1], "positive": [1.0, 2.0], "negative": [2.0, 3.0]}


@pytest.fixture(scope="module")
def shaken(stage):  # type: ignore[no-untyped-def]
    return replace(stage, machine=Imperfections(1e-7, 1e-7, LOUD, None))


@pytest.fixture(scope="module")
def seen(shaken, record):  # type: ignore[no-untyped-def]
    """(fitted scene, held-out scene, model) of a machine with these effects."""

    def of(*effects, seed=0, samples=3000):  # type: ignore[no-untyped-def]
        runs = [r[:samples] for r in record(replace(shaken, effects=effects), seed)]
        base = Base.of(shaken, max(float(np.ptp(r.y)) for r in runs))
        trials = [prepare(base.simulator, r, 1e-7) for r in runs]
        noise = Noise(1e-7, LOUD)
        return *(Scene(shaken.loop, (t,), noise) for t in trials), Model(base)

    return of


@pytest.mark.parametrize("depth", [-9.0, -1.0, 0.0, 0.3, 9.0])
def test_moments_of_what_lies_beyond(depth):
    spread = 0.7
    d = scipy.stats.norm(depth, spread)
    share, mean, square = _beyond(depth, spread)
    wanted = [
        scipy.integrate.quad(lambda v, k=k: v**k * d.pdf(v), 0.0, max(depth, 0.0) + 12.0)[0]
        for k in range(3)
    ]
    np.testing.assert_allclose([share, mean, square], wanted, atol=1e-7)


def test_without_friction_it_is_the_likelihood_of_whitening(seen):
    scene, _, model = seen()
    white = scene.whiten(scene.residuals(model))
    filtered = Slip(model, scene.noise).scaled(scene.trials)[0]
    # The two begin otherwise: the one knows the first state, the other doubts it.
    assert filtered == pytest.approx(scene.likeliest(white), abs=0.01 * len(white))
    none = EffectSpec("coulomb_friction", {"level": 1e-9})
    assert Slip(model.with_effect(none), scene.noise).scaled(scene.trials)[0] == pytest.approx(
        filtered, abs=1e-2
    )


def test_friction_is_told_in_noise_that_smooths_it(seen):
    scene, held, model = seen(SKEWED)
    begun = EffectSpec("asymmetric_friction", {"level_positive": 0.3, "level_negative": 0.3})
    found = refitted(Slip(model.with_effect(begun), scene.noise), scene.trials)
    none = refitted(Slip(model, scene.noise), scene.trials)
    for ground in (scene, held):
        assert found.scaled(ground.trials)[0] > none.scaled(ground.trials)[0] + 15.0
    fit = found.fit(scene.trials)
    for name, spread in zip(("level_positive", "level_negative"), fit.spread[-2:], strict=True):
        off = found.model.effects[0].parameters[name] - SKEWED.parameters[name]
        assert abs(off) < 3.0 * spread
        assert abs(off) < 0.4 * SKEWED.parameters[name]


def test_what_is_fixed_stays_and_costs_no_prediction(seen, monkeypatch):
    scene, _, model = seen(SKEWED)
    begun = EffectSpec("coulomb_friction", {"level": 0.2})
    told = Slip(replace(model, corrections={"mass": 0.01}).with_effect(begun), scene.noise)
    others = of_others(told.model)
    assert [told.model.coordinates[k].kind for k in others] == ["correction"] * len(others)
    whole, some = (told.columns(scene.trials, None, fixed) for fixed in ((), others))
    assert not some[:, others].any()
    np.testing.assert_array_equal(some[:, -1], whole[:, -1])
    found = refitted(told, scene.trials, others)
    np.testing.assert_allclose(found.theta[others], told.theta[others], atol=1e-15)
    assert found.worth(scene.trials) > told.worth(scene.trials)


@pytest.mark.parametrize("effects", [(SKEWED,), ()])
def test_friction_takes_its_place_where_it_foretells_and_nowhere_else(seen, effects):
    scene, held, model = seen(*effects)
    standing = judge(scene, held, model, 4)
    before = Outcome(standing, [], held, {})
    after = with_dry_friction(scene, held, before, model, scene.noise)
    if not effects:
        assert after is before
        return
    assert after.standing.model.names == ("asymmetric_friction",)
    assert after.standing.predicted
    rivals = {name for name, _ in after.contenders["asymmetric_friction"]}
    assert rivals == {*FORMS, "nothing"}


def test_friction_that_needs_more_than_the_stated_noise_is_believed_where_that_tells_it_too(
    seen, monkeypatch
):
    """Of the noises that which suits it best may be louder than the plant file has it."""
    scene, held, model = seen(SKEWED, samples=2150)
    bare = judge(scene, held, model)
    before = Outcome(bare, [], held, {})
    real, tried = dry_in_noise.louder, []

    def louder(noise, stated):  # type: ignore[no-untyped-def]
        tried.append(real(noise, stated))
        return 2.0 if len(tried) == 1 else tried[-1]

    monkeypatch.setattr(dry_in_noise, "louder", louder)
    found = with_dry_friction(scene, held, before, model, scene.noise).standing
    assert len(tried) == 2
    assert found.model.names == ("asymmetric_friction",)
    monkeypatch.setattr(dry_in_noise, "louder", lambda *_: 2.0)
    assert with_dry_friction(scene, held, before, model, scene.noise) is before


def test_company_that_the_filter_does_not_know_stays(seen):
    scene, held, model = seen(SKEWED)
    play = EffectSpec("backlash", {"gap": 1e-5})
    for effects in ((play,), (SKEWED, play), (EffectSpec("constant_load", {"force": 0.1}),)):
        standing = judge(scene, held, replace(model, effects=effects), 1)
        outcome = Outcome(standing, [], held, {})
        assert with_dry_friction(scene, held, outcome, model, scene.noise) is outcome


def test_friction_is_told_beside_what_drives_the_machine_and_what_it_carries(seen):
    late = EffectSpec("input_delay", {"delay": 2e-3})
    weight = EffectSpec("constant_load", {"force": 2.0})
    scene, held, model = seen(late, weight, SKEWED)
    passing = EffectSpec("viscous_friction", {"coefficient": 20.0})
    standing = judge(scene, held, replace(model, effects=(late, weight, passing)), 6)
    outcome = Outcome(standing, [], held, {})
    found = with_dry_friction(scene, held, outcome, model, scene.noise).standing
    assert found.model.names == ("input_delay", "constant_load", "coulomb_friction")
    assert found.model.effects[0].parameters["delay"] == pytest.approx(2e-3, rel=0.2)
    # A level for each direction beside a weight: one number says both.
    level, force = (found.model.effects[k].parameters for k in (2, 1))
    assert level["level"] == pytest.approx(1.8, rel=0.3)
    assert force["force"] == pytest.approx(2.6, rel=0.3)


ROUGH = {
    "grid": [0.0, 0.025, 0.05], "positive": [2.0, 12.0, 6.0], "negative": [8.0, 2.0, 12.0],
}  # fmt: skip


@pytest.mark.parametrize(
    ("true", "told"),
    [
        (EffectSpec("coulomb_friction", {"level": 2.0}), "coulomb_friction"),
        (EffectSpec("position_dependent_friction", {"level": 7.0, "table": ROUGH}), None),
    ],
)
def test_a_table_that_free_runs_found_beside_cogging_stays_where_the_filter_has_one(
    seen, true, told
):
    wave = EffectSpec("cogging", {"amplitude": 1.5, "period": 0.012, "phase": 0.3})
    scene, held, model = seen(wave, true)
    flat = [2.0, 2.1, 1.8, 2.0, 2.1]
    table = {"grid": [0.0, 0.0125, 0.025, 0.0375, 0.05], "positive": flat, "negative": flat}
    stood = EffectSpec("position_dependent_friction", {"level": 2.0, "table": table})
    standing = judge(scene, held, replace(model, effects=(wave, stood)), 6)
    outcome = Outcome(standing, [], held, {})
    found = with_dry_friction(scene, held, outcome, model, scene.noise)
    if told is None:
        assert found is outcome
        return
    assert found.standing.model.names == ("cogging", told)
    cogging, friction = found.standing.model.effects
    assert cogging.parameters["amplitude"] == pytest.approx(1.5, rel=0.1)
    assert friction.parameters["level"] == pytest.approx(2.0, rel=0.1)


def test_levels_by_direction_are_begun_from_the_means_of_a_table(seen):  # type: ignore[no-untyped-def]
    scene, _, model = seen(SKEWED)
    rows = {"positive": [1.0, 1.4], "negative": [2.6, 2.2]}
    spec = EffectSpec(
        "position_dependent_friction", {"level": 1.8, "table": {"grid": [-0.1, 0.1], **rows}}
    )
    found = dry_in_noise._of_the_mean(Slip(model.with_effect(spec), scene.noise), scene.trials)
    right = refitted(Slip(model.with_effect(SKEWED), scene.noise), scene.trials)
    assert found.model.names == ("asymmetric_friction",)
    assert found.worth(scene.trials) > right.worth(scene.trials) - 1.0


def test_plain_friction_is_begun_from_levels_by_direction(seen):  # type: ignore[no-untyped-def]
    scene, _, model = seen(EffectSpec("coulomb_friction", {"level": 2.0}))
    spec = EffectSpec("asymmetric_friction", {"level_positive": 2.3, "level_negative": 1.5})
    either = refitted(Slip(model.with_effect(spec), scene.noise), scene.trials)
    plain = dry_in_noise._of_one_level(either, scene.trials)
    assert plain.model.names == ("coulomb_friction",)
    assert plain.model.effects[0].parameters["level"] == pytest.approx(2.0, rel=0.1)
    assert plain.worth(scene.trials) > either.worth(scene.trials) - 2.0  # chi squared of one number


def test_forms_of_friction_in_the_filters_terms():
    stribeck = EffectSpec(
        "stribeck_friction",
        {"coulomb_level": 2.0, "static_level": 3.0, "stribeck_velocity": 0.01},
    )
    np.testing.assert_allclose(levels(stribeck, 2.0), [[0.0], [1.0], [1.0]])
    assert ease(stribeck, 2.0) == (0.0, 0.5, 0.01)
    by_place = EffectSpec("position_dependent_friction", {"table": TABLE, "level": 2.0})
    np.testing.assert_allclose(levels(by_place, 2.0), [[-0.1, 0.1], [0.5, 1.0], [1.0, 1.5]])
    np.testing.assert_allclose(levels(SKEWED, 1.0), [[0.0], [1.2], [2.4]])


def test_a_contact_that_yields_is_a_stiff_one_where_it_is_stiff(seen):
    scene, _, model = seen(SKEWED)
    dry = EffectSpec("coulomb_friction", {"level": 0.7})
    soft, stiff = (
        EffectSpec("presliding_friction", {"level": 0.7, "stiffness": k, "micro_damping": 0.0})
        for k in (1e3, 1e9)
    )
    plain, far, near = (
        Slip(model.with_effect(spec), scene.noise).scaled(scene.trials)[0]
        for spec in (dry, soft, stiff)
    )
    assert near == pytest.approx(plain, abs=1e-6)
    assert abs(far - plain) > 5.0


def test_a_contact_is_told_that_turns_by_more_than_a_radian_in_a_sample(seen):
    true = {"level": 1.8, "stiffness": 1e6, "micro_damping": 0.0}
    scene, held, model = seen(EffectSpec("presliding_friction", true))
    begun = EffectSpec("presliding_friction", {**true, "level": 0.6, "stiffness": 5e5})
    dry = EffectSpec("coulomb_friction", {"level": 0.6})
    found, rigid = (
        refitted(Slip(model.with_effect(spec), scene.noise), scene.trials) for spec in (begun, dry)
    )
    for ground in (scene, held):
        assert found.scaled(ground.trials)[0] > rigid.scaled(ground.trials)[0] + 15.0
    told = found.model.effects[0].parameters
    assert told["level"] == pytest.approx(true["level"], rel=0.2)
    assert told["stiffness"] == pytest.approx(true["stiffness"], rel=0.4)


def test_on_a_quiet_machine_free_runs_tell_the_form(seen, monkeypatch):
    scene, held, model = seen(SKEWED)
    quiet, loud = Noise(1e-7, 5e-4), Noise(1e-7, LOUD)
    stands = model.with_effect(SKEWED)
    assert dry_in_noise._still(stands, quiet)
    assert not dry_in_noise._still(stands, loud)
    assert not dry_in_noise._still(model, quiet)
    monkeypatch.setattr(dry_in_noise, "_forms", lambda *_: pytest.fail("no form is to be tried"))
    before = Outcome(judge(scene, held, stands, 1), [], held, {})
    assert with_dry_friction(scene, held, before, model, quiet) is before


@pytest.mark.parametrize(
    ("brought", "more", "form", "numbers", "taken"),
    [
        (21717.0, 252.0, "position_dependent_friction", 1, False),
        (21717.0, 2000.0, "position_dependent_friction", 1, True),
        (12826.0, 24.0, "stribeck_friction", 3, False),
        (12826.0, 900.0, "stribeck_friction", 3, True),
        (45.0, 45.0, "position_dependent_friction", 1, True),  # little, and held out alike
        (45.0, 30.0, "position_dependent_friction", 1, False),
    ],
)
def test_another_form_must_say_more_than_the_filter_errs_by(  # type: ignore[no-untyped-def]
    monkeypatch, brought, more, form, numbers, taken
):
    """A table that fits the filter's own error is 1.2 % ahead of plain friction, a Stribeck curve 0.2 %."""
    monkeypatch.setattr(dry_in_noise, "credible", lambda judged: True)

    def judged(score, name, numbers):  # type: ignore[no-untyped-def]
        model = SimpleNamespace(names=(name,), coordinates=range(numbers))
        white = SimpleNamespace(white=np.zeros(16332))
        return SimpleNamespace(
            score=score, held_out=score / 3.0, model=model, fit=white, price=None
        )

    forms = [judged(brought, "coulomb_friction", 1), judged(brought + more, form, numbers)]
    assert dry_in_noise._best(forms, judged(0.0, "nothing", 0)) is forms[taken]


def test_the_second_look_asks_for_the_same_friction_beyond_none_alone(monkeypatch):
    """Free runs may be likelier under the stated noise: they have been beaten under the loudest."""

    def judged(fitted, held_out, name, level):  # type: ignore[no-untyped-def]
        spec = EffectSpec(name, {"level": level})
        model = SimpleNamespace(names=(name,), effects=(spec,))
        return SimpleNamespace(score=fitted + held_out, held_out=held_out, model=model)

    plain = judged(0.0, 0.0, "coulomb_friction", 0.0)
    best = judged(860.0, 150.0, "coulomb_friction", 0.21)
    free = judged(770.0, 207.0, "nothing", 0.0)
    monkeypatch.setattr(dry_in_noise, "_forms", lambda *_: (plain, [best]))
    monkeypatch.setattr(dry_in_noise, "crosses", lambda *_: False)
    monkeypatch.setattr(dry_in_noise, "_best", lambda rivals, none: rivals[0])
    monkeypatch.setattr(dry_in_noise, "_by_free_runs", lambda *_: free)

    def look(alike=None):  # type: ignore[no-untyped-def]
        return dry_in_noise._clear(None, None, free, (None, None), (), alike)

    assert look() is None
    assert look(judged(1.0, 1.0, "coulomb_friction", 0.25)) == (best, free, [best])
    assert look(judged(1.0, 1.0, "coulomb_friction", 0.31)) is None
    assert look(judged(1.0, 1.0, "asymmetric_friction", 0.21)) is None


@pytest.mark.parametrize(("ahead", "led"), [((2000.0, 900.0), True), ((2000.0, 400.0), False)])
def test_no_form_is_tried_where_free_runs_of_the_one_that_stands_are_far_ahead(
    seen, monkeypatch, ahead, led
):
    scene, held, model = seen(SKEWED)
    standing = judge(scene, held, model.with_effect(SKEWED), 1)
    bare = judge(scene, held, model, 1)
    asked = scene, held, standing, (model, model), (scene.noise,)

    def free(standing, best, *_):  # type: ignore[no-untyped-def]
        fitted, judging = dry_in_noise._worth(best)
        return SimpleNamespace(score=fitted + judging + sum(ahead), held_out=judging + ahead[1])

    monkeypatch.setattr(dry_in_noise, "_by_free_runs", free)
    assert dry_in_noise._led_by_free_runs(*asked) is led
    assert not dry_in_noise._led_by_free_runs(scene, held, bare, (model, model), (scene.noise,))


@pytest.mark.parametrize(
    ("fitted", "held_out", "shown", "beats"),
    [
        (50.0, 20.0, 100.0, True),
        (26.0, 13.0, 100.0, True),
        (50.0, 2.0, 100.0, False),  # the held-out recording could have told it
        (11.0, 12.0, 100.0, False),
        (50.0, 1.0, 5.0, True),  # it hardly sees friction, and does not speak against this one
        (50.0, -1.0, 5.0, False),
        (20.0, 1.0, 5.0, False),
    ],
)
def test_a_held_out_recording_is_asked_what_it_can_tell(fitted, held_out, shown, beats):  # type: ignore[no-untyped-def]
    def judged(fitted, held_out):  # type: ignore[no-untyped-def]
        return SimpleNamespace(score=fitted + held_out, held_out=held_out)

    plain, other = judged(-200.0, -shown), judged(-fitted, -held_out)
    assert dry_in_noise._beats(judged(0.0, 0.0), (plain, other), plain) is beats


def test_a_step_is_as_fine_as_the_likelihood_asks(tmp_path):
    """On a stage with a spring, made by the challenge's own simulation, a step of one sample takes what
    friction does within it for noise: 0.79 of the level, and 1.9 times the noise."""
    rng = np.random.default_rng([1, 41])
    setup = draw_setup("stiffness", "careful", rng)
    scales = measure(setup)
    build, (friction,) = assemble(setup, [Part("coulomb_friction", "motor", 1, 1.0)], scales)
    true, constant = friction["level"], setup.parameters["constant"]
    noise = draw_noise(setup, scales, rng)
    noise = replace(noise, force=0.3 * true / constant, force_coloured=0.0)
    experiment = setup.fit[0]
    run = write.columns(
        experiment, *run_stage(build, setup, experiment, noise, rng), setup.sample_time
    )
    NullCase("stiffness", write.plant_text(setup, noise, None), (run,), ()).save(tmp_path)
    plant, recording = load_plant(tmp_path / "plant.toml"), read_recording(tmp_path / "fit_1.csv")
    base = Base.of(plant, float(np.ptp(recording.y)))
    told = Noise(plant.machine.sensor_noise, plant.machine.force_noise)
    trials = [prepare(base.simulator, recording, told.sensor)]
    level = true / constant * base.simulator.force_per_input
    begun = Model(base).with_effect(EffectSpec("coulomb_friction", {"level": 0.7 * level}))
    ways = [refitted(way, trials) for way in dry_in_noise._ways(begun, [told])]
    coarse, fine = sorted(ways, key=lambda way: way.parts)
    found = {way.parts: way.model.effects[0].parameters["level"] / level for way in ways}
    assert found[2] == pytest.approx(1.0, abs=0.1)
    assert abs(found[2] - 1.0) < abs(found[1] - 1.0)
    assert fine.worth(trials) > coarse.worth(trials) + 1000.0
    best = finer(coarse, tuple(trials))  # as a play beside friction is held against none
    assert best.parts == 2
    assert best.worth(trials) >= fine.worth(trials) - 1.0
    none = Slip(Model(base), told)
    assert finer(none, tuple(trials)) is none

"""Play in a coupling where the loop rattles: no free run agrees with another, prediction does."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise, partly_coloured
from ffl.diagnose.predict import rattling as prediction
from ffl.diagnose.predict import switching
from ffl.diagnose.predict.joining import needed
from ffl.diagnose.predict.moving import doubted, gap_at, masses
from ffl.diagnose.predict.play import (
    Hypothesis,
    _along_valley,
    _forms,
    of_another_mass,
    settled,
    start,
)
from ffl.diagnose.predict.rattling import (
    beyond_prediction,
    brings,
    burdened,
    crossed,
    followed,
    settling,
    unexplained,
)
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.recordings import Recording
from ffl.systems import Controller, EffectSpec, Imperfections, Move, Physics, Plant, Zpk, moves

STEP, GAP = 0.001, 5e-4
NOISE = Noise(1e-6, 0.01)
LOAD = {"kind": "load", "load_fraction": 0.5, "frequency": 120.0, "damping": 0.2}


@pytest.fixture(scope="module")
def plant():
    """Two masses of 5 kg on a spring of 45 Hz, driven at one and measured at the other."""
    zeros = np.array([-6.758, -0.6914, -0.02822])
    poles = np.array([0.9994, 1.0, 0.9556 + 0.2686j, 0.9556 - 0.2686j])
    servo_zeros, servo_poles = np.array([0.9852, 0.9944, -1.0]), np.array([0.7991, 0.7637, 1.0])
    return Plant(
        "stage",
        Zpk(zeros, poles, 1.3585e-8, STEP),
        Controller.of_error(Zpk(servo_zeros, servo_poles, 409.5, STEP)),
        "A",
        "m",
        "made for the tests",
        Physics(14.7, 36.4),
        Imperfections(1e-7, 1e-6, 0.01, None),
    )


@pytest.fixture(scope="module")
def rigid():
    """5 kg and a lead with 15 Hz bandwidth."""
    zero, pole = np.exp(-2 * np.pi * 5.0 * STEP), np.exp(-2 * np.pi * 45.0 * STEP)
    lead = Zpk(np.array([zero]), np.array([pole]), 1.0, STEP)
    gain = 5.0 * (2 * np.pi * 15.0) ** 2 / abs(lead.response([15.0])[0])
    system = Zpk(np.array([-1.0]), np.array([1.0, 1.0]), STEP**2 / 10.0, STEP)
    controller = Controller.of_error(replace(lead, gain=gain))
    machine = Imperfections(1e-7, 1e-6, 0.01, None)
    return Plant("stage", system, controller, "N", "m", "for tests", Physics(5.0, 1.0), machine)


def path(*signs):
    steps = [Move(0.2 + 0.6 * k, 0.05 * s, 0.25, 4.0, 200.0) for k, s in enumerate(signs)]
    return moves(steps, 2.6, STEP)


def records(plant, seed=0):
    machine, rng = SimulatedMachine(plant), np.random.default_rng(seed)
    return [machine.run(r, 0 * r, rng) for r in (path(1, -1, 1, -1), path(1, 1, -1, -1))]


@pytest.fixture(scope="module")
def worn(plant):
    spec = EffectSpec(
        "backlash", {"gap": GAP}, {"kind": "coupling", "mass_ratio": 0.7, "damping": 0.04}
    )
    return replace(plant, effects=(spec,))


@pytest.fixture(scope="module")
def rattling(worn):
    return records(worn)


def scene_of(plant, recordings):
    base = Base.of(plant, max(float(np.ptp(r.y)) for r in recordings))
    trials = tuple(prepare(base.simulator, r, 1e-6) for r in recordings)
    return Scene(plant.loop, trials, NOISE), Model(base)


def test_without_a_gap_it_predicts_what_whitening_leaves(plant):
    scene, model = scene_of(plant, records(plant))
    mode = model.base.simulator.mechanics.modes[1]
    own = mode.damping / (2.0 * np.sqrt(mode.stiffness))
    form = {"kind": "coupling", "mass_ratio": 0.7, "damping": own}
    without = Hypothesis.of(model, 1e-12, form, NOISE)
    white, logs = without.predict(scene.trials)
    free = scene.whiten(scene.residuals(model))
    assert np.mean((white - free)[500:] ** 2) < 3e-3
    likelihood = -0.5 * (white @ white) - logs.sum()
    assert likelihood == pytest.approx(scene.log_likelihood(free), abs=20.0)


def test_two_free_runs_of_one_rattling_machine_part_and_their_predictions_do_not(
    plant, worn, rattling
):
    scene, model = scene_of(plant, rattling)
    true = replace(model, effects=worn.effects)
    white = scene.whiten(scene.residuals(true))
    assert np.mean(white**2) > 30.0
    ahead, _ = Hypothesis(true, NOISE).predict(scene.trials)
    assert np.mean(ahead**2) < 2.0


def test_the_play_is_found_by_prediction(plant, rattling):
    scene, model = scene_of(plant, rattling)
    begun, levels = start(scene, model)
    assert begun is not None
    (spec,) = settled(begun, scene, levels).model.effects
    assert spec.parameters["gap"] == pytest.approx(GAP, rel=0.1)
    assert spec.options["damping"] == pytest.approx(0.04, rel=0.1)


@pytest.mark.parametrize("gap", [GAP, 1e-9])
def test_a_machine_may_rest_anywhere(plant, worn, rattling, gap):
    """Its first sample speaks neither for a play as wide nor against one: a dead zone lets it
    rest there as well."""
    scene, model = scene_of(plant, rattling)
    first = replace(scene.trials[0], y=scene.trials[0].y + 0.4 * GAP)
    spec = replace(worn.effects[0], parameters={"gap": gap})
    ahead, _ = Hypothesis(replace(model, effects=(spec,)), NOISE).predict([first])
    assert np.abs(ahead[:20]).max() < 6.0


def test_a_play_is_judged_against_the_same_prediction_without_it(plant, rattling):
    scene, model = scene_of(plant, rattling)
    begun, levels = start(scene, model)
    found = settled(begun, scene, levels)
    assert min(beyond_prediction(found, scene, scene)) > 1000.0
    sound, _ = scene_of(plant, records(plant))
    assert max(beyond_prediction(found, sound, sound)) < 0.0


@pytest.mark.parametrize("loud", [1.0, 10.0])
def test_a_load_on_a_spring_is_no_play_at_any_noise(rigid, loud):
    """What contact and noise bring by themselves is not the gap's."""
    hung = EffectSpec("flexible_mode", {"mass_fraction": 0.5, "frequency": 120.0, "damping": 0.2})
    scene, model = scene_of(rigid, records(replace(rigid, effects=(hung,))))
    noise = replace(NOISE, force=loud * NOISE.force)
    tight = Hypothesis.of(model, 1e-9 * model.base.travel, LOAD, noise)
    assert max(beyond_prediction(tight, scene, scene)) < 5.0


def test_who_foretells_nothing_beside_the_play_goes(plant, worn, rattling):
    scene, model = scene_of(plant, rattling)
    idle = EffectSpec("encoder_ripple", {"period": 0.006, "amplitude": 0.0, "phase": 0.0})
    both = Hypothesis(replace(model, effects=(idle, *worn.effects)), NOISE)
    assert needed(both, scene.trials).model.names == ("backlash",)


@pytest.mark.parametrize(
    "effects", [(), (EffectSpec("coulomb_friction", {"level": 8.0}, {"side": "load"}),)]
)
def test_neither_noise_nor_friction_is_foretold_better_by_a_play(plant, effects):
    scene, model = scene_of(plant, records(replace(plant, effects=effects)))
    begun, levels = start(scene, model)
    if begun is not None:
        nothing = judge(scene, None, model, rounds=6)
        assert settled(begun, scene, levels).scaled(scene.trials)[0] < nothing.fitted + 10.0


@pytest.mark.slow(20)
def test_a_rattling_loop_is_diagnosed(plant, rattling):
    found = diagnose(plant, rattling[:1], rattling[1:]).answer()
    assert found["verdict"] in ("explained", "partly_explained")
    (effect,) = found["effects"]
    assert effect["name"] == "backlash"
    assert effect["parameters"]["gap"]["value"] == pytest.approx(GAP, rel=0.1)
    assert any("rattles" in note for note in found["notes"])


def test_a_load_behind_a_play_in_a_stage_that_the_model_has_as_rigid(rigid):
    """How much of the mass is behind the gap, and on what contact, is found with the gap."""
    spec = EffectSpec("backlash", {"gap": GAP}, LOAD)
    scene, model = scene_of(rigid, records(replace(rigid, effects=(spec,))))
    begun, levels = start(scene, model)
    assert begun is not None
    (found,) = settled(begun, scene, levels).model.effects
    assert found.parameters["gap"] == pytest.approx(GAP, rel=0.1)
    assert found.options["load_fraction"] == pytest.approx(0.5, rel=0.1)
    assert found.options["frequency"] == pytest.approx(120.0, rel=0.1)


def test_the_damping_of_a_rigid_plant_may_be_its_loads(rigid):
    """A model's one damping is motor's or load's once a play parts them; which, is found with the gap."""
    rate = 1.5
    pole, turn = np.exp(-rate * STEP), rate * STEP
    first = turn - 1.0 + pole  # a zero-order hold before 1/(m s (s + rate))
    zero, gain = -(1.0 - pole - turn * pole) / first, first / (5.0 * rate**2)
    rubbed = replace(rigid, system=Zpk(np.array([zero]), np.array([1.0, pole]), gain, STEP))
    spec = EffectSpec("backlash", {"gap": GAP}, {**LOAD, "damped": "load"})
    scene, model = scene_of(rubbed, records(replace(rubbed, effects=(spec,))))
    begun, levels = start(scene, model)
    assert begun is not None
    best = settled(begun, scene, levels)
    (found,) = best.model.effects
    assert found.options["damped"] == "load"
    assert found.parameters["gap"] == pytest.approx(GAP, rel=0.02)
    assert found.options["load_fraction"] == pytest.approx(0.5, rel=0.02)
    kept = {key: value for key, value in found.options.items() if key != "damped"}
    other = replace(best, model=replace(best.model, effects=(replace(found, options=kept),)))
    assert best.worth(scene.trials) > settled(other, scene).worth(scene.trials) + 30.0


def test_a_mass_beyond_the_line_is_the_same_number_under_its_other_name(rigid):
    """And so is a damping, though it acts at the motor, not on everything."""
    play = EffectSpec("backlash", {"gap": GAP}, LOAD)
    more = (
        EffectSpec("mass_change", {"change": 0.08}),
        EffectSpec("viscous_friction", {"coefficient": 15.0}),
    )
    scene, model = scene_of(rigid, records(replace(rigid, effects=(*more, play))))
    worn = replace(model, corrections={"mass": 0.08, "damping": 3.0})
    before = Hypothesis(worn.with_effect(play), NOISE)
    found = crossed(before, scene)
    assert found.model.names == ("mass_change", "viscous_friction", "backlash")
    nominal, _ = scene_of(rigid, records(replace(rigid, effects=(play,))))
    assert crossed(before, nominal).model.names == (
        "backlash",
    )  # no better beyond the line than on it
    assert not {"mass", "damping"} & set(found.model.corrections)
    assert found.worth(scene.trials) > before.worth(scene.trials) - 1.0


@pytest.mark.parametrize("force", [0.0, 3.0])
def test_a_constant_force_beside_the_play_is_found_and_none_is_made_up(rigid, force):
    play, load = (
        EffectSpec("backlash", {"gap": GAP}, LOAD),
        EffectSpec("constant_load", {"force": force}),
    )
    scene, model = scene_of(rigid, records(replace(rigid, effects=(load, play))))
    found = burdened(Hypothesis(model.with_effect(play), NOISE), scene)
    if not force:
        assert found.model.names == ("backlash",)
        return
    assert found.model.names == ("constant_load", "backlash")
    assert found.model.effects[0].parameters["force"] == pytest.approx(force, rel=0.02)


def test_noise_partly_coloured_is_as_loud_as_it_was():
    noise = partly_coloured(NOISE)
    assert np.hypot(noise.sensor, noise.sensor_coloured) == pytest.approx(NOISE.sensor)
    assert np.hypot(noise.force, noise.force_coloured) == pytest.approx(NOISE.force)


@pytest.fixture(scope="module")
def astray(plant, rattling):
    """Where refining may end: gap/(1 + mass ratio) right, and neither of both."""
    scene, model = scene_of(plant, rattling)
    form = {"kind": "coupling", "mass_ratio": 1.6, "damping": 0.04}
    return scene, Hypothesis.of(model, GAP * 2.6 / 1.7, form, NOISE)


def test_gap_and_mass_ratio_are_moved_along_their_valley(astray):
    scene, wrong = astray
    found = _along_valley(wrong, scene.trials)
    (spec,) = found.model.effects
    assert spec.options["mass_ratio"] == pytest.approx(0.7, abs=0.2)
    assert spec.parameters["gap"] == pytest.approx(GAP, rel=0.12)
    again = spec.parameters["gap"] / (1.0 + spec.options["mass_ratio"])
    assert again == pytest.approx(GAP / 1.7, rel=1e-6)


def test_standard_errors_of_a_play_hold_the_truth(astray):
    """Derivatives with a jump in them tell a gap closer than it is."""
    scene, wrong = astray
    point = _along_valley(wrong, scene.trials)
    told = point.fit(scene.trials)
    at = gap_at(point.model)
    off = abs(point.theta[at] - GAP)
    wider = doubted(told, point, scene.trials, 25.0)
    assert wider.spread[at] > 1.5 * told.spread[at]
    assert off < 2.5 * wider.spread[at] < 0.5 * GAP
    corrections = slice(0, 4)
    assert np.array_equal(wider.jacobian[:, corrections], told.jacobian[:, corrections])


def test_no_contact_rings_faster_than_samples_show(rigid, monkeypatch):
    """At 20 Hz a contact of 130 Hz took 409 sub-steps of each sample, and a search no end."""
    slow = replace(
        rigid, system=Zpk(np.array([-1.0]), np.array([1.0, 1.0]), 2.5e-4, 0.05), controller=None
    )
    model, taken = Model(Base.of(slow, 0.1)), []
    assert max(form["frequency"] for form in _forms(model)) <= 0.35 / 0.05
    assert {form["frequency"] for form in _forms(Model(Base.of(rigid, 0.1)))} == {60.0, 130.0}

    def noted(*arguments):
        taken.append(arguments[-1])
        return np.zeros(1), np.ones(1)

    monkeypatch.setattr(switching, "_filter", noted)
    t = 0.05 * np.arange(100)
    recording = Recording.from_signals(0.05, u=np.sin(t), y=0.1 * np.sin(t))
    trial = prepare(model.base.simulator, recording, 1e-6)
    Hypothesis.of(model, GAP, {**LOAD, "measured": "motor", "frequency": 2000.0}, NOISE).predict(
        [trial]
    )
    assert taken == [switching.MOST_SUBSTEPS]


def test_a_guess_of_the_force_noise_is_no_statement(rigid):
    """What is left is louder than a guess, and no louder than a drive may be: nothing that rattles."""
    rng = np.random.default_rng(0)
    r = path(1, -1)
    loud = replace(rigid, machine=Imperfections(0.0, 1e-8, 0.08, None))
    prior = Noise(1e-8, 0.01)
    run = SimulatedMachine(loud).run(r, np.zeros_like(r), rng)
    for stated, told in ((0.01, True), (0.0, False)):
        plant = replace(rigid, machine=replace(rigid.machine, force_noise=stated))
        model = Model(Base.of(plant, 0.1))
        scene = Scene(plant.loop, (prepare(model.base.simulator, run, 1e-8),), prior)
        assert unexplained(scene, scene.residuals(model), model, prior) is told


def test_no_play_is_looked_for_where_free_runs_follow(stage, references, scenes, monkeypatch):
    """A drag in its place leaves next to nothing of the mismatch, though louder than the stated noise; half
    of it leaves a quarter."""
    rng = np.random.default_rng(0)
    drag = EffectSpec("viscous_friction", {"coefficient": 20.0})
    machine = SimulatedMachine(replace(stage, effects=(drag,)))
    runs = [machine.run(r, np.zeros_like(r), rng) for r in references]
    scene, held, model = scenes(runs)
    quiet = Noise(0.1 * scene.noise.sensor, 0.1 * scene.noise.force)
    said: list[str] = []
    monkeypatch.setattr(prediction, "started", lambda *_: (None, ()))
    for coefficient, looked in ((20.0, False), (10.0, True)):
        other = replace(drag, parameters={"coefficient": coefficient})
        standing = judge(scene, held, model.with_effect(other), 0)
        left = scene.residuals(standing.model)
        assert unexplained(replace(scene, noise=quiet), left, model, quiet)
        assert followed(scene, left, model) is not looked
        said.clear()
        prediction.with_rattling(
            scene, held, Outcome(standing, [], held, {}), model, quiet, said.append
        )
        assert bool(said) is looked


def test_a_gap_must_say_something_where_all_other_numbers_are_free(plant, rattling):
    """Beside a spring 4 % off some gap always foretells better than none."""

    def begun(runs):  # type: ignore[no-untyped-def]
        base = Base.of(plant, max(float(np.ptp(r.y)) for r in runs))
        scene = Scene(plant.loop, (prepare(base.simulator, runs[0], NOISE.sensor),), NOISE)
        return start(scene, Model(base))[0], scene

    stiffer = replace(Model(Base.of(plant)), corrections={"mode_1_frequency": 0.04}).plant()
    found, scene = begun(records(stiffer))
    assert found is not None
    assert not brings(found, scene)
    assert brings(*begun(rattling))


def test_a_gap_that_brings_nothing_once_fitted_is_not_gone_on_with(
    stage, record, scenes, monkeypatch
):
    """A guide that warms left much; beside friction the gap of the grid was ahead, and fitted 0.0."""
    scene, held, model = scenes(record(stage))
    outcome = Outcome(judge(scene, held, model, 1), [], held, {})
    monkeypatch.setattr(prediction, "unexplained", lambda *_: True)
    monkeypatch.setattr(prediction, "_mapped", lambda *_: False)
    monkeypatch.setattr(prediction, "started", lambda *_: ("a gap", (1.0,)))
    monkeypatch.setattr(prediction, "brings", lambda *_: True)
    monkeypatch.setattr(prediction, "settled", lambda *_: "fitted")
    monkeypatch.setattr(prediction, "needed", lambda *_: pytest.fail("it was gone on with"))

    def goes_on(beyond: float, before: float, after: float) -> bool:
        ahead = {"a gap": before, "fitted": after}
        monkeypatch.setattr(prediction, "beyond_prediction", lambda *_: [beyond])
        monkeypatch.setattr(prediction, "behind", lambda h, *by: ahead[h] < -sum(by[2:]))
        try:
            found = prediction.with_rattling(scene, held, outcome, model, scene.noise)
        except pytest.fail.Exception:
            return True
        assert found is outcome
        return False

    assert goes_on(31.0, -999.0, 1.0)
    assert not goes_on(29.0, 0.0, 1.0)
    assert not goes_on(31.0, -1001.0, 1.0)  # far behind what stands before it is fitted
    assert goes_on(31.0, 0.0, -15.0)  # behind it by less than half of what the gap brings
    assert not goes_on(31.0, 0.0, -16.0)


def test_a_play_that_its_company_does_not_bring_ahead_is_not_gone_on_with(
    stage, record, scenes, monkeypatch
):
    """Beside an encoder's ripple of 29 um a play of 0.5 mm was 791 behind coloured noise, and 4,909 ahead
    with the ripple."""
    scene, held, model = scenes(record(stage))
    outcome = Outcome(judge(scene, held, model, 1), [], held, {})
    company = SimpleNamespace(found="in company", trials=scene.trials)
    ways = {
        "unexplained": True,
        "_mapped": False,
        "started": ("a gap", (1.0,)),
        "brings": True,
        "settled": "fitted",
        "beyond_prediction": [2056.0],
        "needed": "fitted",
        "burdened": "fitted",
        "accompanied": company,
    }
    for name, value in ways.items():
        monkeypatch.setattr(prediction, name, lambda *_, value=value: value)
    ahead = {"a gap": -817.0, "fitted": -791.0, "in company": -1.0}
    monkeypatch.setattr(prediction, "behind", lambda h, *by: ahead[h] < -sum(by[2:]))
    assert prediction.with_rattling(scene, held, outcome, model, scene.noise) is outcome
    ahead["in company"] = 4909.0
    with pytest.raises(AttributeError):  # it is gone on with
        prediction.with_rattling(scene, held, outcome, model, scene.noise)


def test_a_play_is_begun_with_another_mass_where_no_derivative_leads(plant, worn, rattling):
    """The plant file has 8 % less mass than the machine."""
    scene, model = scene_of(plant, rattling)
    right = Hypothesis(replace(model, effects=worn.effects), NOISE)
    (k,) = masses(right.model)
    assert of_another_mass(right, scene.trials) is right
    theta = right.theta
    theta[k] = -0.08
    found = of_another_mass(right.at(theta), scene.trials)
    assert abs(found.theta[k]) <= 0.025
    assert found.worth(scene.trials) > right.at(theta).worth(scene.trials) + 100.0


@pytest.mark.slow(20)
@pytest.mark.parametrize("slow", [0.6, None])
def test_a_force_that_settles_is_no_constant_one(rigid, slow):
    """Seconds after the start they are the same."""
    play = EffectSpec("backlash", {"gap": GAP}, LOAD)
    load = EffectSpec("constant_load", {"force": 3.0})
    drift = EffectSpec("drift", {"amplitude": 3.0, "time_constant": slow or 1.0})
    built = drift if slow else load
    scene, model = scene_of(rigid, records(replace(rigid, effects=(built, play))))
    begun = Hypothesis(replace(model, effects=(load, play)), NOISE)

    def again(point, trials):  # type: ignore[no-untyped-def]
        return settled(point, replace(scene, trials=tuple(trials)))

    found, trials = settling(begun, scene.trials, scene.trials, again, False)
    assert trials == scene.trials
    assert found.model.names == (built.name, "backlash")
    if slow:
        (settled_by, _) = found.model.effects
        assert settled_by.parameters["time_constant"] == pytest.approx(slow, rel=0.05)
        assert settled_by.parameters["amplitude"] == pytest.approx(3.0, rel=0.02)

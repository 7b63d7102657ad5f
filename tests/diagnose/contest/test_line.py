"""What the named effects come to when all is said."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.contest import line
from ffl.diagnose.contest.judging import credible, judge
from ffl.diagnose.contest.line import (
    _preloaded,
    _pruned,
    _without_idle,
    across_the_line,
    against_the_refused,
    astray,
    on_the_line,
    released,
)
from ffl.diagnose.contest.rounds import Outcome, Step
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.amounts import claims, of_its_own, sizes
from ffl.diagnose.hypothesis.corrections import corrections
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.maps.outcome import Contest
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.proof.verdict import verdict
from ffl.diagnose.recorded.trials import prepare
from ffl.machines import SimulatedMachine
from ffl.recordings import Recording
from ffl.systems import EffectSpec
from ffl.systems.plant import Imperfections
from ffl.systems.plant_file import plant_from_dict

NOISE = Noise(1e-7, 2e-3)
FREE = {"name": "free", "plant": {"form": "czpk", "zeros": [], "poles": [0.0, 0.0], "gain": 1.0}}


def scene_of(plant, recordings):  # type: ignore[no-untyped-def]
    base = Base.of(plant, max(float(np.ptp(r.y)) for r in recordings))
    trials = tuple(prepare(base.simulator, r, 1e-7) for r in recordings)
    return Scene(plant.loop, trials, NOISE), Model(base)


def test_friction_by_direction_beside_a_spring_is_even_friction_about_another_centre(stage, record):  # type: ignore[no-untyped-def]
    spring = EffectSpec("linear_stiffness", {"stiffness": 200.0, "centre": 0.01})
    even = EffectSpec("coulomb_friction", {"level": 3.0})
    scene, model = scene_of(stage, record(replace(stage, effects=(even, spring))))
    uneven = EffectSpec("asymmetric_friction", {"level_positive": 3.4, "level_negative": 2.6})
    moved = replace(spring, parameters={"stiffness": 200.0, "centre": 0.012})
    judged = judge(scene, None, replace(model, effects=(uneven, moved)), rounds=4)
    found = across_the_line(scene, None, judged).model
    assert found.names == ("coulomb_friction", "linear_stiffness")
    assert found.effects[0].parameters["level"] == pytest.approx(3.0, rel=0.02)
    assert found.effects[1].parameters["centre"] == pytest.approx(0.01, abs=1e-4)


def test_friction_by_direction_without_a_spring_stays(stage, record):  # type: ignore[no-untyped-def]
    uneven = EffectSpec("asymmetric_friction", {"level_positive": 3.4, "level_negative": 2.6})
    scene, model = scene_of(stage, record(replace(stage, effects=(uneven,))))
    judged = judge(scene, None, model.with_effect(uneven), rounds=4)
    assert across_the_line(scene, None, judged).model.names == ("asymmetric_friction",)


def test_more_mass_of_a_stage_that_a_play_divides_is_more_in_all_its_parts(stage, record):  # type: ignore[no-untyped-def]
    behind = {"kind": "load", "load_fraction": 0.3, "frequency": 40.0, "damping": 0.1}
    play = EffectSpec("backlash", {"gap": 3e-4}, {**behind, "measured": "motor"})
    heavier = EffectSpec("mass_change", {"change": 0.08}, {"side": "all"})
    scene, model = scene_of(stage, record(replace(stage, effects=(play, heavier))))
    begun = replace(model, corrections={"mass": 0.08}).with_effect(play)
    found = across_the_line(scene, None, judge(scene, None, begun, rounds=4)).model
    assert found.names == ("backlash", "mass_change")
    assert found.effects[1].parameters["change"] == pytest.approx(0.08, abs=0.005)
    assert found.effects[1].options == {"side": "all"}


def test_a_correction_beyond_the_line_is_held_on_it(stage, record):  # type: ignore[no-untyped-def]
    """So that an effect that competes with it says what it has to say alone."""
    scene, model = scene_of(stage, record(replace(stage, effects=())))
    far = judge(scene, None, replace(model, corrections={"mass": 0.08, "damping": 0.0}), rounds=0)
    assert abs(sizes(scene, far.model)["mass"]) > 0.02
    near = on_the_line(None, far).model
    assert abs(sizes(scene, near)["mass"]) < 0.02
    assert "mass" in near.held


@pytest.mark.parametrize(("own", "named"), [(0.012, ()), (0.05, ("mass_change",))])
def test_a_mass_said_twice_is_one_number(stage, record, own, named):  # type: ignore[no-untyped-def]
    """0.3 % as an effect beside 1.2 % as a correction is 1.5 %: no effect."""
    heavy = EffectSpec("mass_change", {"change": 1.003 * (1.0 + own) - 1.0})
    scene, model = scene_of(stage, record(replace(stage, effects=(heavy,))))
    twice = replace(model, corrections={"mass": own, "damping": 0.0})
    judged = judge(scene, None, twice.with_effect(EffectSpec("mass_change", {"change": 0.003})), 0)
    assert across_the_line(scene, None, judged).model.names == named


@pytest.mark.parametrize("stiffness", [60.0, 0.05], ids=["a spring and a load", "a load"])
def test_a_spring_about_a_far_centre_is_a_load_and_a_spring_if_that_is_worth_it(
    stage, record, stiffness
):  # type: ignore[no-untyped-def]
    far = EffectSpec("linear_stiffness", {"stiffness": stiffness, "centre": 18.0 / stiffness})
    there = (EffectSpec("constant_load", {"force": 18.0}),)
    if stiffness > 1.0:
        there = (EffectSpec("linear_stiffness", {"stiffness": stiffness}), *there)
    scene, model = scene_of(stage, record(replace(stage, effects=there)))
    scene, held = (replace(scene, trials=(trial,)) for trial in scene.trials)
    found = _preloaded(held, judge(scene, held, model.with_effect(far), rounds=4)).model
    assert found.names == tuple(spec.name for spec in there)
    assert found.effects[-1].parameters["force"] == pytest.approx(18.0, rel=0.01)
    assert found.effects[0].parameters.get("stiffness", 60.0) == pytest.approx(60.0, rel=0.05)


@pytest.mark.parametrize("aside", [0.0, 0.5], ids=["0 passed", "0 not passed"])
def test_a_spring_about_a_near_centre_stays(stage, record, aside):  # type: ignore[no-untyped-def]
    scene, model = scene_of(stage, record(replace(stage, effects=())))
    trials = tuple(replace(t, y=t.y + aside) for t in scene.trials)
    near = EffectSpec("linear_stiffness", {"stiffness": 60.0, "centre": aside + 0.02})
    judged = judge(scene, None, model.with_effect(near), rounds=0)
    kept = _preloaded(None, replace(judged, scene=replace(scene, trials=trials))).model
    assert kept.names == ("linear_stiffness",)


def test_an_effect_that_takes_nothing_off_goes(stage, record):  # type: ignore[no-untyped-def]
    dry = EffectSpec("coulomb_friction", {"level": 3.0})
    idle = EffectSpec("cogging", {"amplitude": 1e-5, "period": 0.004})
    working = EffectSpec("cogging", {"amplitude": 1.0, "period": 0.004})
    scene, model = scene_of(stage, record(replace(stage, effects=(dry, working))))
    both = judge(scene, None, replace(model, effects=(dry, working)), rounds=0)
    assert _without_idle(None, both) is both
    scene, model = scene_of(stage, record(replace(stage, effects=(dry,))))
    both = judge(scene, None, replace(model, effects=(dry, idle)), rounds=0)
    assert _without_idle(None, both).model.names == ("coulomb_friction",)


def test_an_effect_that_does_nothing_beside_a_held_correction_is_dropped(stage, record):  # type: ignore[no-untyped-def]
    dry = EffectSpec("coulomb_friction", {"level": 3.0})
    idle = EffectSpec("hardening_spring", {"cubic_coefficient": 0.0, "centre": 0.0})
    scene, model = scene_of(stage, record(replace(stage, effects=(dry,))))
    judged = judge(scene, None, replace(model, effects=(dry, idle)), rounds=2)
    assert _pruned(None, judged).model.names == ("coulomb_friction",)


def test_an_effect_that_the_models_own_number_undoes_is_none(two_masses, references):
    """A damper at the motor in the place of the machine's own passed for a delay; gone, nobody was left."""
    machine = SimulatedMachine(two_masses)
    recording = machine.run(references[0], 0 * references[0], np.random.default_rng(0))
    scene, model = scene_of(two_masses, [recording])
    damper = EffectSpec("viscous_friction", {"coefficient": 30.0}, {"side": "motor"})
    judged = judge(scene, None, model.with_effect(damper), rounds=0)
    mass = model.base.simulator.mechanics.moving_mass * model.base.simulator.force_per_input
    for share, alright in ((0.0, True), (-0.5, True), (-1.0, False), (-1.5, False)):
        other = replace(judged.model, corrections={"damping": share * 30.0 / mass})
        as_it_is = replace(judged, fit=replace(judged.fit, model=other))
        assert credible(as_it_is) is alright


def test_numbers_that_no_machine_has_are_no_finding(two_masses, references):
    """A blind case ended in an error: a mass change beyond what there is at its point."""
    machine = SimulatedMachine(two_masses)
    recording = machine.run(references[0], 0 * references[0], np.random.default_rng(0))
    scene, model = scene_of(two_masses, [recording])
    gone = EffectSpec("mass_change", {"change": -0.95}, {"side": "motor"})
    impossible = replace(model, corrections={"mass": 0.01}).with_effect(gone)
    judged = judge(scene, None, impossible, rounds=2)
    assert not np.isfinite(judged.score)
    assert not credible(judged)


@pytest.mark.parametrize(
    ("answers", "named"), [((True, True), ("mass_change",)), ((True, False), ())]
)
def test_a_number_that_is_worth_nothing_as_an_effect_stays_on_the_line(
    stage, record, monkeypatch, answers, named
):
    """Free it was worth more than on the line, at a point of the machine it was not: a null."""
    heavy = EffectSpec("mass_change", {"change": 0.05})
    scene, model = scene_of(stage, record(replace(stage, effects=(heavy,))))
    judged = judge(
        scene, None, replace(model, corrections={"mass": 0.05, "damping": 0.0}), rounds=2
    )
    said = iter(answers)
    monkeypatch.setattr(line, "_beyond", lambda *_: next(said))
    found = across_the_line(scene, None, judged).model
    assert found.names == named
    assert named or found.corrections["mass"] == pytest.approx(0.02, rel=0.05)


@pytest.mark.parametrize(
    "true",
    [
        EffectSpec("coulomb_friction", {"level": 2.0}),
        EffectSpec("viscous_friction", {"coefficient": 20.0}),
    ],
)
def test_a_number_beyond_the_line_stands_against_who_was_refused(stage, record, true):  # type: ignore[no-untyped-def]
    """What came in as a number of the model's own had no rival yet."""
    scene, model = scene_of(stage, record(replace(stage, effects=(true,))))
    nothing = judge(scene, None, model, rounds=10)
    dry = EffectSpec("coulomb_friction", {"level": 0.3})
    refused = judge(scene, None, nothing.model.with_effect(dry), rounds=10)
    step = Step(nothing, (), (refused,), None)
    outcome = Outcome(nothing, [step], None, {})
    standing = across_the_line(scene, None, nothing)
    assert standing.model.names == ("viscous_friction",)
    found, after = against_the_refused(None, standing, outcome)
    assert found.model.names == (true.name,)
    others = {name for name, _ in after.contenders[true.name]}
    siblings = {"quadratic_drag"}  # tried too, where the damper brings little
    assert others - siblings == {"viscous_friction", "coulomb_friction"}
    (value,) = true.parameters.values()
    assert next(iter(found.model.effects[0].parameters.values())) == pytest.approx(value, rel=0.2)


@pytest.mark.parametrize(
    "true",
    [
        EffectSpec("quadratic_drag", {"coefficient": 60.0}),
        EffectSpec("viscous_friction", {"coefficient": 20.0}),
    ],
)
def test_beside_an_effect_it_does_as_well(stage, record, true):  # type: ignore[no-untyped-def]
    """A drag was refused beside a friction for the little that it brings over a free damping."""
    dry = EffectSpec("coulomb_friction", {"level": 1.0})
    scene, model = scene_of(stage, record(replace(stage, effects=(dry, true))))
    alone = judge(scene, None, model.with_effect(dry), rounds=10)
    drag = EffectSpec("quadratic_drag", {"coefficient": 10.0})
    refused = judge(scene, None, alone.model.with_effect(drag), rounds=10)
    step = Step(alone, (), (refused,), None)
    outcome = Outcome(alone, [step], None, {"coulomb_friction": [("coulomb_friction", alone)]})
    standing = across_the_line(scene, None, alone)
    assert standing.model.names == ("coulomb_friction", "viscous_friction")
    found, after = against_the_refused(None, standing, outcome)
    assert set(found.model.names) == {"coulomb_friction", true.name}
    values = {spec.name: next(iter(spec.parameters.values())) for spec in found.model.effects}
    assert values[true.name] == pytest.approx(next(iter(true.parameters.values())), rel=0.1)
    assert values["coulomb_friction"] == pytest.approx(1.0, rel=0.1)
    assert set(after.contenders) >= {"coulomb_friction", true.name}


@pytest.mark.parametrize(
    ("gain", "lag", "claimed"),
    [(0.015, -0.019, False), (0.0, -0.03, True), (0.03, 0.0, True), (-0.018, 0.018, False)],
)
def test_a_speed_without_a_stated_mass_has_a_gain_and_a_lag(gain, lag, claimed):
    """Each of the two within 2 % is no mass of 3.5 %."""
    plant = plant_from_dict(
        {
            "name": "motor", "sample_time": 0.01, "units": {"input": "V", "output": "m/s"},
            "plant": {"form": "czpk", "zeros": [], "poles": [-4.0], "gain": 4.0},
        }
    )  # fmt: skip
    base = Base.of(plant, 1.0)
    mass, damping = (1.0 + lag) / (1.0 + gain) - 1.0, 4.0 / (1.0 + gain) - 4.0
    u = np.repeat([1.0, -1.0, 0.5], 100)
    trial = prepare(
        base.simulator, Recording.from_signals(0.01, u=u, y=plant.system.filter(u)), 1e-3
    )
    scene = Scene(plant.loop, (trial,), Noise(1e-3, 1e-3))
    size = sizes(scene, Model(base), {"mass": mass, "damping": damping})["mass"]
    assert claims("mass", size) is claimed
    assert abs(size) == pytest.approx(max(abs(gain), abs(lag)), abs=1e-9)
    # A damping 8 % off is another gain at rest, and no mass.
    assert sizes(scene, Model(base), {"mass": -0.008, "damping": 0.32})["mass"] == -0.008


def test_what_is_added_to_a_spring_is_told_as_a_share_of_it():
    plant = plant_from_dict(
        {
            "name": "galvanometer", "sample_time": 1e-3, "units": {"input": "A", "output": "rad"},
            "plant": {"form": "czpk", "zeros": [], "poles": [[-1.0, 30.0], [-1.0, -30.0]], "gain": 901.0},
        }
    )  # fmt: skip
    model = Model(Base.of(plant, 1.0))
    for name, key, own in (
        ("linear_stiffness", "stiffness", 1.0),
        ("viscous_friction", "coefficient", 2 / 901),
    ):
        spec = EffectSpec(name, {key: 0.03 * own, "centre": 0.0})
        assert of_its_own(model, spec) == pytest.approx(0.03, rel=2e-3)
    assert of_its_own(model, EffectSpec("coulomb_friction", {"level": 1.0})) is None
    free = replace(plant, system=plant_from_dict({**FREE, "sample_time": 1e-3}).system)
    assert (
        of_its_own(Model(Base.of(free, 1.0)), EffectSpec("linear_stiffness", {"stiffness": 1.0}))
        is None
    )


@pytest.mark.parametrize(("coefficient", "first"), [(28.0, True), (20.0, False)])
def test_a_faint_drag_is_told_or_listed_beside_a_damper(stage, record, coefficient, first):  # type: ignore[no-untyped-def]
    """Beside a damping that is free it brings nothing, and the damping alone becomes a damper for sure."""
    loud = replace(stage, machine=Imperfections(1e-7, 1e-7, 0.2, None))
    drag = EffectSpec("quadratic_drag", {"coefficient": coefficient})
    fit, held = record(replace(loud, effects=(drag,)), 2)
    (finding,) = diagnose(loud, [fit], [held]).findings
    told = {finding.name: finding.confidence, **dict(finding.alternatives)}
    assert finding.name == ("quadratic_drag" if first else "viscous_friction")
    assert told["quadratic_drag"] > 0.4
    assert finding.confidence < 0.9


@pytest.mark.parametrize(
    ("off", "said"), [({"mass": 0.3}, "mass"), ({"mass": 0.03}, ""), ({"mass": 0.0}, "")]
)
def test_a_number_far_off_that_no_effect_bears_out_is_not_passed_over(stage, record, off, said):  # type: ignore[no-untyped-def]
    """Twice the line and surely beyond it: "nothing missing" would be wrong, and so would a name."""
    heavier = EffectSpec("mass_change", {"change": off["mass"]})
    scene, model = scene_of(stage, record(replace(stage, effects=(heavier,))))
    judged = judge(scene, None, replace(model, corrections=off), rounds=0)
    found = astray(judged)
    assert "".join(found) == said
    told, place = verdict(stage, judged, Contest("named", None, None, 0.0, 0.0, None))
    if said:
        assert found["mass"] == pytest.approx(0.3)
        assert (told, place.component) == ("inconclusive", "plant")
        assert "mass 30 % off" in place.where


def test_one_that_might_be_on_the_line_is_a_number(stage, record):  # type: ignore[no-untyped-def]
    scene, model = scene_of(stage, record(replace(stage, effects=())))
    scene = replace(scene, noise=Noise(1e-2, 2.0))  # as loud as the motion
    assert not astray(judge(scene, None, replace(model, corrections={"mass": 0.3}), rounds=0))


@pytest.mark.parametrize(("own", "kept"), [(0.03, True), (0.08, False)])
def test_a_number_a_little_beyond_the_line_that_says_more_there_stays(
    stage, record, monkeypatch, own, kept
):  # type: ignore[no-untyped-def]
    """Where it is no effect: held on the line, what stands beside it would make up for it."""
    friction = EffectSpec("coulomb_friction", {"level": 2.0})
    heavy = EffectSpec("mass_change", {"change": own})
    scene, model = scene_of(stage, record(replace(stage, effects=(friction, heavy))))
    begun = replace(model, corrections={"mass": own, "damping": 0.0}).with_effect(friction)
    monkeypatch.setattr(line, "_beyond", lambda *_: False)
    judged = judge(scene, None, begun, rounds=3)
    found = across_the_line(scene, None, judged)
    assert "mass_change" not in found.model.names
    assert ("mass" in found.model.held) is not kept
    assert found.model.corrections["mass"] == pytest.approx(own if kept else 0.02, abs=1e-3)


def test_what_was_held_on_the_line_is_told_and_has_its_share_of_the_doubt(stage, record):  # type: ignore[no-untyped-def]
    friction = EffectSpec("viscous_friction", {"coefficient": 3.0})
    heavy = EffectSpec("mass_change", {"change": 0.03})
    scene, model = scene_of(stage, record(replace(stage, effects=(friction, heavy))))
    on_it = replace(model, corrections={"mass": 0.02}, held=frozenset({"mass", "damping"}))
    judged = judge(scene, None, on_it.with_effect(friction), rounds=3)
    free = released(judged)
    assert free.model.held == {"damping"}  # what stands as stated stays so
    assert free.model.corrections == judged.model.corrections
    assert free.model.effects == judged.model.effects
    names = [c.name for c in free.model.coordinates]
    before = [c.name for c in judged.model.coordinates]
    at, was = names.index("coefficient"), before.index("coefficient")
    assert free.fit.spread[at] > 1.01 * judged.fit.spread[was]
    assert "mass" in {c.name for c in corrections(free)}
    assert "mass" not in {c.name for c in corrections(judged)}
    assert released(free) is free

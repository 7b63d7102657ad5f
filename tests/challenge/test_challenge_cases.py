"""Cases: every effect can be made, is visible, is what its truth says; the rest is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from ffl.challenge import make_case, null_recordings
from ffl.challenge.body import FAMILIES
from ffl.challenge.build import Build
from ffl.challenge.case import DETECTABLE, UNDETECTABLE, Trace, _beyond_the_line, _truth_effect
from ffl.challenge.draw import draw_setup, measure
from ffl.challenge.faults import FAULTS
from ffl.challenge.outside import OUTSIDE
from ffl.challenge.physics import EFFECTS
from ffl.challenge.stage import Part, assemble
from ffl.errors import InputError
from ffl.systems import load_plant


def read(path):
    return np.loadtxt(path, delimiter=",", skiprows=1)


@pytest.mark.parametrize("effect", [*EFFECTS, *OUTSIDE])
def test_every_effect_makes_a_visible_case(effect, tmp_path):
    machine = "stiffness" if effect == "sensor_nonlinearity" else "rigid"
    truth = make_case(11, effect, machine, out_dir=tmp_path, name="a")
    entry = truth["effects"][0]
    assert entry["name"] == effect
    assert entry["energy_beyond_nominal"] >= DETECTABLE
    files = sorted(p.name for p in (tmp_path / "a").iterdir())
    assert "plant.toml" in files
    assert "fit_1.csv" in files
    assert "validate_1.csv" in files
    rows = read(tmp_path / "a" / "fit_1.csv")
    assert rows.shape[1] == 5
    assert np.all(np.isfinite(rows))
    expected = ["unnamed", "partly_explained"] if effect in OUTSIDE else ["explained"]
    assert truth["verdicts"][: len(expected)] == expected


@pytest.mark.parametrize("machine", FAMILIES)
def test_the_plant_file_is_read_and_the_columns_agree_with_its_controller(machine, tmp_path):
    truth = make_case(3, None, machine, out_dir=tmp_path, name="a", doubt="exact")
    plant = load_plant(tmp_path / "a" / "plant.toml")
    t, r, f, u, y = read(tmp_path / "a" / "fit_1.csv").T
    assert np.allclose(np.diff(t), plant.sample_time, rtol=1e-3)
    assert truth["verdicts"] == ["nothing_missing"]
    if plant.controller is None:
        np.testing.assert_allclose(u, f, rtol=1e-9)
        return
    # From rest the controller's state is zero before the pre-roll, so compare after it decayed.
    free = u - f - plant.controller.reference.filter(r) + plant.controller.output.filter(y)
    if machine not in ("printer", "kernel2018") and abs(free[-1]) < 1e-6 * np.abs(u).max():
        assert np.abs(free[len(free) // 2 :]).max() < 1e-6 * np.abs(u).max()


def test_a_case_is_a_function_of_its_seed(tmp_path):
    one = make_case(5, "cogging", "rigid", "noise", out_dir=tmp_path, name="a")
    two = make_case(5, "cogging", "rigid", "noise", out_dir=tmp_path, name="b")
    other = make_case(6, "cogging", "rigid", "noise", out_dir=tmp_path, name="c")
    assert one["effects"] == two["effects"] != other["effects"]
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


def test_concealments_are_what_they_say(tmp_path):
    noisy = make_case(8, "coulomb_friction", "rigid", "noise", out_dir=tmp_path, name="a")
    assert 0.8 < noisy["effects"][0]["power_ratio"] < 1.25
    hidden = make_case(8, "drift", "two_mass_motor", "feedback", out_dir=tmp_path, name="b")
    assert hidden["effects"][0]["trace_share"] <= 0.05
    weak = make_case(8, "cogging", "rigid", "weak", out_dir=tmp_path, name="c")
    assert weak["effects"][0]["energy"] <= UNDETECTABLE
    assert weak["verdicts"] == ["nothing_missing", "inconclusive"]
    masked = make_case(8, "cogging", "rigid", "masked", out_dir=tmp_path, name="d")
    assert [e["name"] for e in masked["effects"]] == ["cogging", "mass_change"]
    change = masked["effects"][1]["parameters"]["change"]
    assert 0.05 <= abs(change) <= 0.1


@pytest.mark.slow(5)
def test_an_oracle_cannot_tell_lag_from_delay_in_noise_but_friction_from_viscous(tmp_path):
    lag = make_case(102, "actuator_lag", "rigid", "noise", out_dir=tmp_path, oracle=True)
    assert lag["effects"][0]["rivals"]["input_delay"] < 25
    bus = make_case(102, "lost_commands", "rigid", "outside", out_dir=tmp_path, oracle=True)
    rivals = bus["effects"][0]["rivals"]  # no delay makes what comes at random
    assert 25 < rivals["input_delay"] < bus["effects"][0]["energy_beyond_nominal"]
    dry = make_case(102, "coulomb_friction", "rigid", out_dir=tmp_path, oracle=True)
    assert dry["effects"][0]["rivals"]["viscous_friction"] > 1e3


def on_stage(effect, at="motor", seed=3, machine="rigid", size=1.0):
    setup = draw_setup(machine, "exact", np.random.default_rng(seed))
    scales = measure(setup)
    build, parameters = assemble(setup, [Part(effect, at, seed, size)], scales)
    return setup, build, parameters[0]


def test_a_beam_gives_the_stated_resonance_and_takes_no_mass_away():
    setup, build, p = on_stage("flexible_mode")
    total = np.ones(len(build.motor)) @ build.mass @ np.ones(len(build.motor))
    assert total == pytest.approx(setup.true.moving_mass)
    squares = scipy.linalg.eigh(build.stiffness, build.mass, eigvals_only=True)
    assert squares[0] == pytest.approx(0.0, abs=1e-6 * squares[1])
    assert np.sqrt(squares[1]) / (2 * np.pi) == pytest.approx(p["frequency"], rel=1e-3)
    # An antiresonance at the beam's clamped frequency: the share of the first mode follows.
    two_modes = p["mass_fraction"] * (1 + 0.188 / 0.613)
    assert build.mass[0, 0] == pytest.approx(total * (1 - two_modes))


def test_backlash_leaves_the_load_where_it_is_until_the_gap_closes():
    setup, build, p = on_stage("backlash", at="transmission")
    n = len(build.motor)
    assert n == 2
    assert build.mass[0, 0] + build.mass[1, 1] == pytest.approx(setup.true.moving_mass)
    build.gauge = np.array([0.0, 1.0])
    force = np.full(400, 0.2)
    load, _, x, _ = build.run(None, np.zeros(400), force, 1e-3, 40)
    assert np.all(load[x < 0.5 * p["gap"]] == 0)
    assert load[-1] > 0


def test_presliding_levels_off_at_its_level_with_its_stiffness():
    _, build, p = on_stage("presliding_friction")
    row = build.elements[0]
    springs, yields = row[3:19:2], row[4:19:2]
    assert np.sum(springs * yields) == pytest.approx(p["level"])
    # The first chord lies 7 % below the tangent at the origin (node at 0.15 of the reach).
    assert 0.9 < springs.sum() / p["stiffness"] < 1.0


@pytest.mark.parametrize("effect", ["mass_change", "viscous_friction", "input_delay"])
def test_what_is_an_effect_lies_beyond_the_line_for_corrections(effect):
    setup, build, p = on_stage(effect, size=0.01)
    if effect == "mass_change":
        assert abs(p["change"]) > 0.02
        assert build.mass[0, 0] == pytest.approx(setup.true.mass[0, 0] * (1 + p["change"]))
    elif effect == "input_delay":
        assert p["delay"] > 0.1 * setup.sample_time
    else:
        scales = measure(setup)
        assert p["coefficient"] * scales.speed_rms > 0.02 * scales.force_rms


@pytest.mark.parametrize(("friction", "beyond"), [(0.01, True), (30.0, False)])
def test_a_damper_beside_strong_friction_may_be_a_correction(friction, beyond):
    setup = draw_setup("rigid", "exact", np.random.default_rng(3))
    parts = [
        Part("viscous_friction", "motor", 3, 0.01),
        Part("coulomb_friction", "motor", 3, friction),
    ]
    assert _beyond_the_line(setup, parts, measure(setup)) is beyond


@pytest.mark.parametrize(("share", "beyond"), [(1.0, False), (-0.5, True)])
def test_a_mass_that_a_wrong_nominal_one_has_swallowed_is_no_effect(share, beyond):
    """On a rigid stage both are one number: a payload of 6 % beside a model 6 % too heavy is none."""
    setup = draw_setup("rigid", "exact", np.random.default_rng(3))
    part = Part("mass_change", "motor", 3, 1.0)
    own = assemble(setup, [part], measure(setup))[1][0]
    off = share * (1.0 / (1.0 + own["change"]) - 1.0)
    wrong = replace(setup, corrections={"mass": off})
    assert _beyond_the_line(wrong, [part], measure(setup)) is beyond


@pytest.mark.parametrize("machine", ["rigid", "stiffness"])
def test_a_damper_is_counted_beside_what_the_model_has(machine):
    """The machine's own damping and the damper are the model's damping and the coefficient."""
    setup = draw_setup(machine, "careful", np.random.default_rng(4))
    found = _truth_effect(Part("viscous_friction", "motor", 1, 1.0), {"coefficient": 2.0}, setup,
                          Trace(0.0, 0.0, 0.0, 0.0))  # fmt: skip
    per_unit = 1.0 if setup.physics_known else setup.true.constant
    model = setup.nominal.damping[0, 0]
    assert model != pytest.approx(setup.true.damping[0, 0], rel=1e-4)
    total = model + per_unit * found["parameters"]["coefficient"]
    assert total == pytest.approx(setup.true.damping[0, 0] + 2.0)


def test_a_spring_is_counted_beside_the_one_that_the_model_has():
    """-k_true x - k (x - centre) is the model's spring and the truth's, wherever the stage is."""
    setup = draw_setup("stiffness", "careful", np.random.default_rng(4))
    added = {"stiffness": 50.0, "centre": 1e-3}
    found = _truth_effect(Part("linear_stiffness", "motor", 1, 1.0), added, setup,
                          Trace(0.0, 0.0, 0.0, 0.0))["parameters"]  # fmt: skip
    per_unit = 1.0 if setup.physics_known else setup.true.constant
    true, model = setup.true.stiffness[0, 0], setup.nominal.stiffness[0, 0]
    assert model != pytest.approx(true, rel=1e-4)
    for x in (-2e-3, 1e-3, 4e-3):
        force = -true * x - 50.0 * (x - 1e-3)
        beside = -per_unit * found["stiffness"] * (x - found["centre"])
        assert -model * x + beside == pytest.approx(force, rel=1e-9)


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_spoil_the_recording(fault, tmp_path):
    clean = make_case(21, None, "rigid", out_dir=tmp_path, name="a")
    truth = make_case(21, None, "rigid", out_dir=tmp_path, name="b", fault=fault)
    assert clean["fault"] is None
    assert truth["fault"]["name"] == fault
    assert truth["verdicts"] == ["inconclusive", "refused"]
    rows = read(tmp_path / "b" / "fit_1.csv")
    if fault == "gaps":
        assert np.diff(rows[:, 0]).max() > 10 * np.diff(rows[:, 0]).min()
    if fault == "frozen_sensor":
        assert (np.diff(rows[:, 4]) == 0).sum() > 0.05 * len(rows)


def test_null_recordings_differ_and_stay_on_the_reference(tmp_path):
    cases = list(null_recordings(6, 1))
    assert [c.machine for c in cases] == list(FAMILIES)
    for case in cases:
        assert case.plant.startswith("name = ")
        for t, r, _, _, y in (a.T for a in case.fit + case.validate):
            assert np.all(np.diff(t) > 0)
            if case.machine != "stiffness":
                assert np.abs(r - y).max() < 0.5 * np.ptp(r)
    cases[0].save(tmp_path)
    np.testing.assert_allclose(read(tmp_path / "fit_1.csv"), cases[0].fit[0], rtol=1e-9, atol=1e-7)
    assert load_plant(tmp_path / "plant.toml").name == "rigid"
    again = next(null_recordings(1, 1))
    np.testing.assert_array_equal(again.fit[0], cases[0].fit[0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"effect": "gremlins"}, "effect 'gremlins' is unknown"),
        ({"machine": "spaceship"}, "machine 'spaceship' is unknown"),
        ({"effect": "sensor_nonlinearity"}, "does not go with machine 'rigid'"),
        ({"concealment": "fog"}, "concealment 'fog' is unknown"),
        ({"machine": "stiffness", "concealment": "feedback"}, "no feedback to hide behind"),
        (
            {"effect": "drift", "machine": "stiffness", "concealment": "masked"},
            "mask with a second effect",
        ),
        ({"fault": "fire"}, "fault 'fire' is unknown"),
    ],
)
def test_bad_input_is_refused(arguments, message, tmp_path):
    with pytest.raises(InputError, match=message):
        make_case(1, out_dir=tmp_path, **arguments)
    assert list(tmp_path.iterdir()) == []


def test_truth_is_written_where_asked_and_only_there(tmp_path):
    make_case(2, "drift", "rigid", out_dir=tmp_path / "c", truth_dir=tmp_path / "t", name="x")
    truth = json.loads((tmp_path / "t" / "x.json").read_text())
    assert truth["effects"][0]["name"] == "drift"
    text = (tmp_path / "c" / "x" / "plant.toml").read_text()
    assert "drift" not in text


def test_a_build_without_effects_has_no_elements():
    setup = draw_setup("rigid", "exact", np.random.default_rng(1))
    assert Build.of(setup.true).elements == []


@pytest.mark.parametrize("machine", FAMILIES)
@pytest.mark.parametrize("doubt", ["careful", "wrong"])
def test_wrong_parameters_stay_corrections_by_the_contract(machine, doubt):
    for seed in range(3):
        setup = draw_setup(machine, doubt, np.random.default_rng([seed, 7]))
        scales = measure(setup)
        wrong = setup.corrections
        assert abs(wrong["mass"]) <= 0.02
        if machine in ("rigid", "stiffness", "printer"):
            error = setup.true.damping[0, 0] - setup.nominal.damping[0, 0]
            assert abs(error) * scales.speed_rms < 0.02 * scales.force_rms
        if machine == "stiffness":
            error = setup.true.stiffness / setup.nominal.stiffness - 1
            assert abs(error[0, 0]) < 0.02


def test_a_change_of_mass_is_counted_beside_what_the_model_has():
    """On a rigid stage a nominal mass 1 % too small and a payload are one number."""
    setup = draw_setup("rigid", "exact", np.random.default_rng(3))
    wrong = replace(setup, corrections={"mass": 0.01})
    found = _truth_effect(Part("mass_change", "motor", 1, 1.0), {"change": -0.05}, wrong,
                          Trace(0.0, 0.0, 0.0, 0.0))  # fmt: skip
    assert found["parameters"]["change"] == pytest.approx(1.01 * 0.95 - 1.0)

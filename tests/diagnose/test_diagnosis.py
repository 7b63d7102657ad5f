"""End to end on a stage whose missing physics is known."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.hypothesis.linear import corrected_plant, corrections_of
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.proof.prove import nrmse, run_plant
from ffl.diagnose.recorded.trials import commanded, prepare
from ffl.effects import mechanics_of
from ffl.errors import InputError
from ffl.machines import Simulator
from ffl.recordings import Recording
from ffl.report.diagnosis import print_answer, write
from ffl.systems import load_plant
from ffl.systems.plant import EffectSpec


def _answer(stage, record, effects=(), **changes):  # type: ignore[no-untyped-def]
    machine = replace(stage, effects=tuple(effects), **changes)
    fit, judge = record(machine)
    return diagnose(stage, [fit], [judge], rng=np.random.default_rng(0))


@pytest.fixture(scope="module")
def coulomb(stage, record):  # type: ignore[no-untyped-def]
    return _answer(stage, record, [EffectSpec("coulomb_friction", {"level": 2.0})])


def test_nothing_missing(stage, record):  # type: ignore[no-untyped-def]
    answer = _answer(stage, record).answer()
    assert answer["verdict"] == "nothing_missing"
    assert answer["effects"] == []
    check = answer["validation"]
    assert check["nrmse_after"] == pytest.approx(check["noise_floor"], rel=0.2)


def test_coulomb_is_named_measured_and_proven(coulomb):  # type: ignore[no-untyped-def]
    answer = coulomb.answer()
    assert answer["verdict"] == "explained"
    assert [e["name"] for e in answer["effects"]] == ["coulomb_friction"]
    level = answer["effects"][0]["parameters"]["level"]
    assert level["unit"] == "N"
    assert level["value"] == pytest.approx(2.0, abs=max(5 * level["std_error"], 0.02))
    check = answer["validation"]
    assert check["nrmse_after"] < 1.2 * check["noise_floor"] < 0.2 * check["nrmse_before"]
    assert "direction" in answer["location"]["depends_on"]


def test_answer_is_strict_json(coulomb):  # type: ignore[no-untyped-def]
    text = json.dumps(coulomb.answer(), allow_nan=False)
    assert json.loads(text)["schema"] == 1
    for effect in coulomb.answer()["effects"]:
        rivals = sum(a["confidence"] for a in effect["alternatives"])
        assert 0 <= effect["confidence"] + rivals <= 1 + 1e-9


def test_augmented_plant_reruns_to_the_last_bit(coulomb, stage, record, tmp_path):  # type: ignore[no-untyped-def]
    write(coulomb, tmp_path)
    plant = load_plant(str(tmp_path / "augmented.toml"))
    machine = replace(stage, effects=(EffectSpec("coulomb_friction", {"level": 2.0}),))
    judge = record(machine)[1]
    trial = prepare(Simulator(stage), judge, 1e-7)
    again = nrmse([trial.y], [run_plant(plant, trial).y])
    assert again == coulomb.answer()["validation"]["nrmse_after"]
    page = (tmp_path / "report.html").read_text()
    assert "coulomb_friction" in page
    assert "http" not in page.replace("http://www.w3.org", "")


def test_mass_beyond_two_per_cent_is_an_effect_and_below_a_correction(stage, record):  # type: ignore[no-untyped-def]
    heavier = corrected_plant(stage, mechanics_of(stage.system), {"mass": 0.06}).system
    answer = _answer(stage, record, system=heavier).answer()
    assert [e["name"] for e in answer["effects"]] == ["mass_change"]
    change = answer["effects"][0]["parameters"]["change"]["value"]
    assert change == pytest.approx(0.06, abs=0.003)
    slightly = corrected_plant(stage, mechanics_of(stage.system), {"mass": 0.01}).system
    answer = _answer(stage, record, system=slightly).answer()
    assert answer["verdict"] == "nothing_missing"
    masses = [c["relative"] for c in answer["model_corrections"] if c["name"] == "mass"]
    assert masses == [pytest.approx(0.01, abs=0.002)]


@pytest.mark.parametrize("lead", [2e-5, 9e-5])
def test_a_lead_below_a_tenth_of_a_sample_is_a_correction(stage, record, lead):  # type: ignore[no-untyped-def]
    """The sensor is read that much after the sample: as much as a simulation that steps speed before
    position makes of it, and was told as a map of velocity."""
    ahead = (EffectSpec("sensor_lead", {"lead": lead}),)
    answer = _answer(stage, record, effects=ahead).answer()
    assert (answer["verdict"], answer["effects"]) == ("nothing_missing", [])
    (told,) = [c for c in answer["model_corrections"] if c["name"] == "sensor_lead"]
    assert told["relative"] == pytest.approx(lead / stage.sample_time, rel=0.1)
    assert told["unit"] == "samples"


def test_corrections_are_modal_and_leave_the_nominal_alone(stage):  # type: ignore[no-untyped-def]
    mechanics = mechanics_of(stage.system)
    assert [c.name for c in corrections_of(mechanics)] == ["mass", "damping"]
    f = np.array([1.0, 10.0, 100.0])
    heavier = corrected_plant(stage, mechanics, {"mass": 0.25}).system
    np.testing.assert_allclose(heavier.response(f), stage.system.response(f) / 1.25, rtol=1e-9)
    assert corrected_plant(stage, mechanics, {"mass": 0.0}) is stage


def test_what_judges_must_not_be_fitted(stage, record):  # type: ignore[no-untyped-def]
    fit, _ = record(stage)
    with pytest.raises(InputError, match="validate with another recording"):
        diagnose(stage, [fit], [fit])


def test_a_command_that_was_not_recorded_follows_from_the_controller(stage, record, coulomb):  # type: ignore[no-untyped-def]
    machine = replace(stage, effects=(EffectSpec("coulomb_friction", {"level": 2.0}),))
    whole = record(machine)[0]
    silent = replace(whole, u=np.full(len(whole), np.nan), missing=frozenset({"u"}))
    u = commanded(stage, silent).u
    assert np.abs(u - whole.u).max() < 1e-6 * np.ptp(whole.u)
    moving = silent[len(silent) // 3 :]
    assert np.isnan(commanded(stage, moving).u).all()


def test_numbers_are_printed_with_their_errors(coulomb, capsys):  # type: ignore[no-untyped-def]
    print_answer({**coulomb.answer(), "notes": ["nothing judged"]})
    level = coulomb.answer()["effects"][0]["parameters"]["level"]
    said = capsys.readouterr().out
    assert f"± {level['std_error']:.2g} N" in said
    assert "note: nothing judged" in said


@pytest.mark.slow(10)
def test_cogging_is_told_with_its_harmonic_and_nothing_else(stage, record):  # type: ignore[no-untyped-def]
    """A second harmonic is no ripple of the scale; a lighter machine does not stretch the period."""
    true = {"amplitude": 3.0, "period": 0.0213, "phase": 0.4, "amplitude_2": 0.8, "phase_2": 1.1}
    light = replace(stage, system=replace(stage.system, gain=1.05 * stage.system.gain))
    fit, judge = (r[:2150] for r in record(replace(light, effects=(EffectSpec("cogging", true),))))
    answer = diagnose(stage, [fit], [judge], rng=np.random.default_rng(0)).answer()
    assert [e["name"] for e in answer["effects"]] == ["cogging", "mass_change"]
    found = answer["effects"][0]["parameters"]
    for name, value in true.items():
        error = max(4 * found[name]["std_error"], 1e-3 * value)
        assert found[name]["value"] == pytest.approx(value, abs=error), name
    check = answer["validation"]
    assert check["nrmse_after"] < 2.0 * check["noise_floor"] < 0.01 * check["nrmse_before"]


def test_a_ripple_of_two_tracks_is_told_with_its_harmonic_and_nothing_else(stage, record):  # type: ignore[no-untyped-def]
    """Offsets of sine and cosine tracks, read by the arctangent, repeat at half the period too: no
    cogging."""
    turn = 2 * np.pi / 0.0213
    amplitude = 0.02 / turn  # offsets of 2 % of the tracks
    true = {"amplitude": amplitude, "period": 0.0213, "phase": 0.4,
            "amplitude_2": 0.5 * turn * amplitude**2, "phase_2": 0.8 + 0.5 * np.pi}  # fmt: skip
    fit, judge = (
        r[:2150] for r in record(replace(stage, effects=(EffectSpec("encoder_ripple", true),)))
    )
    answer = diagnose(stage, [fit], [judge], rng=np.random.default_rng(0)).answer()
    assert [e["name"] for e in answer["effects"]] == ["encoder_ripple"]
    found = answer["effects"][0]["parameters"]
    for name, value in true.items():
        error = max(4 * found[name]["std_error"], 1e-3 * value)
        assert found[name]["value"] == pytest.approx(value, abs=error), name


def test_a_loop_at_rest_stands_where_a_rippled_scale_shows_the_reference(stage, record):  # type: ignore[no-untyped-def]
    """The recording begins after the loop has settled; the model begins there too."""
    ripple = EffectSpec("encoder_ripple", {"amplitude": 5e-5, "period": 0.021, "phase": 1.0})
    machine = replace(stage, effects=(ripple,))
    settled = record(machine)[0][180:]
    trial = prepare(Simulator(stage), settled, 1e-7)
    assert trial.at_rest
    left = trial.y - Model(Base.of(stage), effects=(ripple,)).simulate(trial).y
    assert np.abs(left[:60]).max() < 1e-6


def test_a_spring_that_pulls_from_where_nobody_was_is_a_spring_and_a_load(stage, record):  # type: ignore[no-untyped-def]
    spring = EffectSpec("linear_stiffness", {"stiffness": 60.0, "centre": 0.2})
    answer = _answer(stage, record, [spring]).answer()
    found = {e["name"]: e["parameters"] for e in answer["effects"]}
    assert set(found) == {"linear_stiffness", "constant_load"}
    assert "centre" not in found["linear_stiffness"]
    stiffness, force = found["linear_stiffness"]["stiffness"], found["constant_load"]["force"]
    assert stiffness["value"] == pytest.approx(60.0, abs=4 * stiffness["std_error"])
    assert force["value"] == pytest.approx(12.0, abs=4 * force["std_error"])


def test_the_lines_of_an_answer_say_what_stands(capsys):
    """A number that the data do not see, a map that has no name, a fault that came before any proof."""
    numbers = {"exponent": {"value": 0.8, "unit": "", "std_error": 1.7}}
    effect = {
        "name": "hysteresis", "location": "plant", "confidence": 0.6, "says": "It remembers.",
        "parameters": numbers, "alternatives": [],
    }  # fmt: skip
    answer = {
        "verdict": "unnamed", "effects": [effect], "location": {}, "advice": [],
        "model_corrections": [{"name": "mode_1_frequency", "relative": -0.3}],
        "validation": {
            "nrmse_before": 0.1, "nrmse_after": 0.2, "nrmse_with_map": 0.01, "noise_floor": 0.005
        },
    }  # fmt: skip
    print_answer(answer)
    said = capsys.readouterr().out
    assert "exponent not told (0.8 ± 1.7)" in said
    assert "mode_1_frequency: -30 %, as far as it may go" in said
    assert "nrmse 0.1 -> 0.01 with the map (without it 0.2), noise alone 0.005" in said
    print_answer({**answer, "validation": {**answer["validation"], "noise_untold": True}})
    assert "without it 0.2), noise cannot be told from what is left" in capsys.readouterr().out
    middle = {"centre": {"value": -7.2e-8, "unit": "m", "std_error": 1.7e-7}}
    spring = {**effect, "name": "hardening_spring", "parameters": middle}
    print_answer({**answer, "effects": [spring]})
    assert "centre -7.2e-08 ± 1.7e-07 m" in capsys.readouterr().out
    fault = {"verdict": "inconclusive", "effects": [], "location": {}, "advice": ["flip y"]}
    print_answer({**fault, "model_corrections": []})
    assert "is to be mended before these recordings can tell" in capsys.readouterr().out


def test_a_block_written_twice_is_refused(stage, record):  # type: ignore[no-untyped-def]
    fit, held = record(stage)
    at = np.concatenate([np.arange(640), np.arange(600, len(fit))])
    columns = {name: getattr(fit, name)[at] for name in ("r", "f", "u", "y")}
    twice = Recording.from_signals(fit.sample_time, **columns)
    with pytest.raises(InputError, match=r"the 40 samples from .* written twice"):
        diagnose(stage, [twice], [held])

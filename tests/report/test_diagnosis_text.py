"""What of an answer is said, and what is left unsaid."""

import pytest

from ffl.report.diagnosis import print_answer

NOTHING = {
    "verdict": "unnamed",
    "effects": [],
    "model_corrections": [],
    "location": {},
    "advice": [],
    "notes": [],
}
ERRORS = {
    "nrmse_before": 0.1,
    "nrmse_after": 0.08,
    "noise_floor": 0.02,
    "u_nrmse_before": 0.3,
    "u_nrmse_after": 0.25,
}


def said_of(capsys, verdict="unnamed", **proof):
    print_answer({**NOTHING, "verdict": verdict, "validation": {**ERRORS, **proof}})
    return capsys.readouterr().out.splitlines()[1:]


def test_both_figures_are_said_with_the_map_and_without(capsys):
    y, u = said_of(capsys, nrmse_with_map=0.03, u_nrmse_with_map=0.04)
    assert "nrmse 0.1 -> 0.03 with the map (without it 0.08), noise alone 0.02" in y
    assert "nrmse 0.3 -> 0.04 with the map (without it 0.25)" in u
    y, u = said_of(capsys)
    assert "map" not in y + u
    assert said_of(capsys, u_noise_floor=0.06)[1].endswith("0.25, noise alone 0.06")
    assert "noise alone" not in said_of(capsys, u_noise_floor=0.06, noise_untold=True)[1]


@pytest.mark.parametrize(
    ("proof", "within"),
    [({}, False), ({"nrmse_with_map": 0.015}, True), ({"nrmse_after": 0.015}, True)],
)
def test_it_is_said_where_less_is_left_than_noise_would_leave(capsys, proof, within):
    assert ("what is left is within it" in said_of(capsys, **proof)[0]) == within
    partly = said_of(capsys, "partly_explained", **proof)[0]
    assert "within it" not in partly  # what has structure may be as small as noise
    assert ("by estimate" in partly) == within


def test_a_number_without_an_error_says_why(capsys):
    effect = {
        "name": "sensor_nonlinearity",
        "location": "sensor",
        "confidence": 0.97,
        "says": "It clips.",
        "parameters": {"level": {"value": 0.0042, "unit": "m", "note": "seen directly"}},
        "alternatives": [],
    }
    print_answer({**NOTHING, "effects": [effect]})
    assert "level 0.0042 m (seen directly)" in capsys.readouterr().out


def test_a_rival_of_no_chance_is_not_said(capsys):
    effect = {
        "name": "coulomb_friction",
        "location": "plant",
        "confidence": 0.97,
        "says": "Dry friction of 2 N.",
        "parameters": {"level": {"value": 2.0, "unit": "N", "std_error": 0.1}},
        "alternatives": [
            {"name": "mass_change", "confidence": 0.0012},
            {"name": "hysteresis", "confidence": 0.02},
        ],
    }
    answer = {
        "verdict": "explained",
        "effects": [effect],
        "model_corrections": [],
        "location": {},
        "advice": [],
        "notes": [],
    }
    print_answer(answer)
    said = capsys.readouterr().out
    assert "or hysteresis (0.02)" in said
    assert "mass_change" not in said

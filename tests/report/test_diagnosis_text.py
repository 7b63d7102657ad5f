"""What of an answer is said, and what is left unsaid."""

from ffl.report.diagnosis import print_answer


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

"""How an answer's numbers are held against the truth's."""

import numpy as np
import pytest

from ffl.challenge.judge import _about, _parameters, judge

TRUE = {"linear_coefficient": -0.8, "quadratic_coefficient": 12.0, "centre": 0.05}


def told_about(centre):  # type: ignore[no-untyped-def]
    """The true gain as somebody would state it who counts from `centre` and scales it to 1 there."""
    a, b = TRUE["linear_coefficient"], TRUE["quadratic_coefficient"]
    way = centre - TRUE["centre"]
    size = 1.0 + a * way + b * way**2
    numbers = {"linear_coefficient": (a + 2 * b * way) / size, "quadratic_coefficient": b / size}
    entries = {name: {"value": v, "std_error": 0.01} for name, v in numbers.items()}
    return {**entries, "centre": {"value": centre}}


@pytest.mark.parametrize("centre", [0.05, -0.02, 0.2])
def test_a_gain_is_the_same_about_any_centre(centre):
    back = _about(told_about(centre), TRUE["centre"])
    for name in ("linear_coefficient", "quadratic_coefficient"):
        assert back[name]["value"] == pytest.approx(TRUE[name], rel=1e-9)
        assert back[name]["std_error"] > 0.0


def test_its_errors_are_those_of_the_law_and_not_of_where_it_is_counted_from():
    truth = {"effects": [{"name": "position_dependent_gain", "parameters": TRUE}]}
    told = told_about(0.2)
    told["linear_coefficient"] = {"value": told["linear_coefficient"]["value"], "std_error": 0.01}
    found = _parameters(
        truth, {"effects": [{"name": "position_dependent_gain", "parameters": told}]}
    )
    assert {name for _, name, _, _ in found} == {"linear_coefficient", "quadratic_coefficient"}
    assert all(error < 1e-9 for _, _, error, _ in found)
    told["linear_coefficient"]["value"] += 0.5
    found = _parameters(
        truth, {"effects": [{"name": "position_dependent_gain", "parameters": told}]}
    )
    assert np.max([error for _, _, error, _ in found]) > 0.1


TWO = [
    {"name": "constant_load", "location": "environment", "parameters": {},
     "rivals": {"drift": 900.0}},
    {"name": "input_delay", "location": "actuator", "parameters": {},
     "rivals": {"actuator_lag": 0.4, "viscous_friction": 800.0}},
]  # fmt: skip


def said(**names):  # type: ignore[no-untyped-def]
    """An answer with these names, each with its confidence and its alternatives."""
    effects = [
        {"name": n, "location": "plant", "confidence": sure, "parameters": {},
         "alternatives": [{"name": other, "probability": 0.4} for other in others]}
        for n, (sure, others) in names.items()
    ]  # fmt: skip
    return {"answer": {"verdict": "explained", "effects": effects, "location": {}}}


@pytest.mark.parametrize(
    ("names", "exact", "told"),
    [
        ({"constant_load": (0.94, ()), "input_delay": (0.5, ())}, True, True),
        ({"constant_load": (0.94, ()), "actuator_lag": (0.5, ("input_delay",))}, False, True),
        ({"constant_load": (0.94, ()), "actuator_lag": (0.94, ("input_delay",))}, False, False),
        ({"constant_load": (0.94, ()), "actuator_lag": (0.5, ())}, False, False),
        ({"drift": (0.5, ("constant_load",)), "input_delay": (0.5, ())}, False, False),
        ({"constant_load": (0.94, ())}, False, False),
    ],
)
def test_of_several_what_nobody_can_tell_apart_is_told_by_both_names(names, exact, told):
    truth = {
        "case": "c", "kind": "several", "machine": "rigid", "concealment": "none", "effects": TWO,
        "oracle": {},
    }  # fmt: skip
    found = judge(truth, said(**names))
    assert (found.exact, found.told, found.right) == (exact, told, exact)


def test_what_is_left_is_held_against_the_oracle_and_against_the_noise():
    floors = {
        "nrmse_after": 0.01,
        "nrmse_fitted": 0.02,
        "u_nrmse_after": 0.1,
        "u_nrmse_fitted": 0.1,
    }
    truth = {"kind": "single", "machine": "rigid", "concealment": "none", "effects": TWO[:1],
             "case": "c", "oracle": {"validate_1.csv": floors}}  # fmt: skip
    answer = said(constant_load=(0.97, []))
    answer["answer"]["validation"] = {
        "nrmse_before": 0.5,
        "nrmse_after": 0.02,
        "u_nrmse_after": 0.3,
    }
    verdict = judge(truth, answer)
    assert (verdict.nrmse_ratio, verdict.noise_ratio) == pytest.approx((1.0, 2.0))
    answer["answer"]["validation"]["nrmse_before"] = 0.01  # concealed by feedback: u shows it
    assert judge(truth, answer).noise_ratio == pytest.approx(3.0)
    del floors["nrmse_fitted"], floors["u_nrmse_fitted"]  # a truth of before
    assert judge(truth, answer).nrmse_ratio == pytest.approx(3.0)

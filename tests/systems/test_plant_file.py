"""Plant files: every mistake is one line with file, key and mend; floats round-trip exactly."""

import numpy as np
import pytest

from ffl.errors import InputError
from ffl.systems import as_state_space, load_plant, plant_from_dict, plant_to_dict, save_plant
from ffl.systems.perturb import perturbed

BASE = """
name = "x"
sample_time = 0.01
[plant]
form = "zpk"
zeros = []
poles = [0.5]
gain = 1.0
"""


@pytest.mark.parametrize(
    "name",
    ["flatbed_printer", "flatbed_printer_built", "emps", "kernel2018_loop", "bayes2025_system"],
)
def test_shipped_plants_load_are_stable_and_round_trip(name, tmp_path):
    plant = load_plant(name)
    plant.require_stable()
    save_plant(plant, tmp_path / "p.toml")
    assert plant_to_dict(load_plant(tmp_path / "p.toml")) == plant_to_dict(plant)


def test_printer_zeros_are_those_of_the_paper():
    zeros = load_plant("flatbed_printer").system.zeros
    expected = [0.9039, 0.9853, 0.9854 + 0.0457j, 0.9854 - 0.0457j, 0.9988]
    expected += [1.008 + 0.0477j, 1.008 - 0.0477j, 1.078]
    assert np.sort_complex(zeros) == pytest.approx(np.sort_complex(np.array(expected, complex)))
    assert load_plant("flatbed_printer").system.relative_degree == 2


def test_zeros_of_the_kernel_papers_loop():
    """The paper prints 1.003 +- 0.184i, 0.982 +- 0.0839i (0.0840 by its own factors) and 0.983."""
    from ffl.systems import as_zpk

    zeros = as_zpk(load_plant("kernel2018_loop").loop.reference_to_output).zeros
    upper = np.sort_complex(zeros[zeros.imag >= 0])
    assert upper == pytest.approx([0.9815 + 0.0840j, 0.9834, 1.0035 + 0.1844j], abs=1e-4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BASE.replace("gain", "gian"), r"unknown key 'plant.gian'; did you mean 'gain'"),
        (BASE.replace('name = "x"', 'nmae = "x"'), r"unknown key 'nmae'; did you mean 'name'"),
        (BASE.replace("gain = 1.0", ""), r"'plant.gain' is missing"),
        (BASE.replace('form = "zpk"', 'form = "zpkk"'), r"plant.form = 'zpkk': did you mean"),
        (BASE.replace('form = "zpk"', ""), r"'plant.form' is missing"),
        (BASE + '[controller]\nform = "tf"\n', r"controller.form = 'tf': known: czpk, ss, zpk"),
        (BASE.replace("0.01", "-0.01"), r"sample_time = -0.01"),
        (
            BASE.replace("[0.5]", "[[0.5, 0.1]]"),
            r"plant: poles holds 0.5\+0.1i without its conjugate",
        ),
        (BASE.replace("[0.5]", "[nan]"), r"poles\[0\]"),
        (BASE.replace("zeros = []", "zeros = [0.1, 0.2]"), r"plant: more zeros than poles"),
        (BASE.replace('"zpk"', '"zkp"'), r"form"),
        (BASE + "[machine]\nsensor_noise = -1.0\n", r"machine.sensor_noise = -1"),
        (BASE + "[controller]\nform = 'zpk'\ngain = 1.0\nzeros=[0.1]\n", r"controller: more zeros"),
        (BASE + "[physics]\nmas = 1.0\n", r"unknown key 'physics.mas'; did you mean 'mass'"),
        ("name = ", r"not valid TOML"),
        ("", r"is missing"),
    ],
)
def test_mistakes_are_named(tmp_path, text, message):
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        load_plant(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_names_get_a_suggestion():
    with pytest.raises(InputError, match="did you mean 'flatbed_printer'"):
        load_plant("flatbed_priner")
    with pytest.raises(InputError, match="no such file"):
        load_plant("nowhere/x.toml")


def test_forms_describe_the_same_system():
    base = {"name": "x", "sample_time": 0.01}
    a = plant_from_dict({**base, "plant": {"form": "zpk", "poles": [0.5], "gain": 2.0, "delay": 1}})
    b = plant_from_dict(
        {
            **base,
            "plant": {"form": "ss", "A": [[0.5]], "B": [1.0], "C": [2.0], "D": 0.0, "delay": 1},
        }
    )
    rate = np.log(0.5) / 0.01
    c = plant_from_dict(
        {**base, "plant": {"form": "czpk", "poles": [rate], "gain": -rate * 4.0, "delay": 1}}
    )
    u = np.random.default_rng(0).standard_normal(50)
    y = as_state_space(a.system).filter(u)
    assert as_state_space(b.system).filter(u) == pytest.approx(y)
    assert as_state_space(c.system).filter(u) == pytest.approx(y)


def test_perturbed_machines_differ_as_asked_and_are_stable():
    plant = load_plant("flatbed_printer")
    one = perturbed(plant, np.random.default_rng(5))
    two = perturbed(plant, np.random.default_rng(5))
    assert one.loop.is_stable
    assert np.array_equal(one.system.poles, two.system.poles)
    assert len(one.system.poles) == len(plant.system.poles) + 2
    static = one.system.response([0.05]) / plant.system.response([0.05])
    assert 0.85 < abs(static[0]) < 1.15
    assert np.sum(np.abs(one.system.zeros) > 1) == 3

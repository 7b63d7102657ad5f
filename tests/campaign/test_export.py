"""What is exported computes the same feedforward as the basis, in C too."""

import ctypes
import json
import shutil
import subprocess

import numpy as np
import pytest

from ffl.bases import make_basis
from ffl.bases.friction import STANDS
from ffl.campaign import load_campaign, run_campaign
from ffl.campaign.c_header import c_header
from ffl.campaign.export import realise
from ffl.cli import execute
from ffl.errors import InputError

OBF = {
    "kind": "obf",
    "poles": [0.9, [0.98, 0.05], [0.98, -0.05]],
    "outside": [[1.008, 0.0477], [1.008, -0.0477], 1.078],
    "feedthrough": True,
    "repeat": 2,
}
CASES = {
    "obf": [OBF],
    "fir": [{"kind": "fir", "preview": 3, "lag": 2}],
    "derivatives": [{"kind": "derivatives", "orders": ["velocity", "acceleration", "snap"]}],
    "friction": [{"kind": "friction", "asymmetric": True, "velocity": 0.05}],
    "filter": [{"kind": "filter", "taps": [0.4, -1.2, 0.7], "first": -2}],
    "combination": [
        {"kind": "combination", "basis": [OBF, {"kind": "friction"}], "theta": list(range(1, 16))},
        {"kind": "fir", "delays": [0]},
    ],
    "sum": [{"kind": "fir", "delays": [0]}, OBF, {"kind": "friction"}],
}


needs_c = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


@pytest.fixture(params=CASES)
def case(request):
    """(basis, theta, reference, feedforward); the reference rests at a value other than zero."""
    basis = make_basis(CASES[request.param], 1e-3)
    theta = np.random.default_rng(5).standard_normal(basis.n_parameters)
    reference = np.full(400, 0.3)
    reference[100:300] += 0.01 * np.cumsum(np.hanning(200) - 0.3)
    reference[300:] = reference[299]
    return basis, theta, reference, basis.regressors(reference) @ theta


def run_sections(table, reference, backwards):
    """The description in the exported file, taken literally."""
    r = reference[::-1] if backwards else reference
    sections = [{k: np.array(v) for k, v in section.items()} for section in table]
    states = [section["rest"] * r[0] for section in sections]
    f = np.zeros(len(r))
    for t, v in enumerate(r):
        for k, s in enumerate(sections):
            x = states[k]
            w = s["c"] @ x + s["d"] * v
            states[k] = s["a"] @ x + s["b"] * v
            f[t] += s["gain"] @ (states[k] if backwards else x)
            v = w
    return f[::-1] if backwards else f


def test_sections_as_described_give_the_feedforward(case):
    basis, theta, reference, expected = case
    table = json.loads(json.dumps(realise(basis, theta).table()))
    f = run_sections(table["forwards"], reference, False)
    f += run_sections(table["backwards"], reference, True)
    index = np.arange(len(reference))
    for delay, gain in zip(table["taps"]["delay"], table["taps"]["gain"], strict=True):
        f += gain * reference[np.clip(index - delay, 0, len(reference) - 1)]
    for term in table["friction"]:
        v = np.gradient(reference, 1e-3)
        v[0] = (reference[1] - reference[0]) / 2e-3
        v[-1] = (reference[-1] - reference[-2]) / 2e-3
        moving = np.abs(v) > term["stands"] * np.abs(v).max()
        sign = np.clip(v / term["velocity"], -1, 1) if term["velocity"] else np.sign(v) * moving
        f += sign * np.where(sign > 0, term["level_positive"], term["level_negative"])
    np.testing.assert_allclose(f, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def compiled(realisation, reference, folder):
    """f as the C header computes it."""
    (folder / "learned.h").write_text(c_header(realisation, "test"))
    (folder / "use.c").write_text(
        '#include "learned.h"\n'
        "void use(const double *r, double *f, int n) { ffl_feedforward(r, f, n); }\n"
    )
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "use.c", "-o", "use.so"], cwd=folder, check=True)
    f, pointer = np.empty_like(reference), ctypes.POINTER(ctypes.c_double)
    use = ctypes.CDLL(str(folder / "use.so")).use
    use(reference.ctypes.data_as(pointer), f.ctypes.data_as(pointer), len(f))
    return f


@needs_c
def test_the_c_header_gives_the_feedforward(case, tmp_path):
    basis, theta, reference, expected = case
    f = compiled(realise(basis, theta), reference, tmp_path)
    np.testing.assert_allclose(f, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_a_free_signal_is_no_filter():
    with pytest.raises(InputError, match="not a filter of the reference"):
        realise(make_basis([{"kind": "free"}], 1e-3), np.zeros(10))


@pytest.mark.parametrize("asymmetric", [False, True])
@needs_c
def test_rounding_of_a_reference_at_rest_is_no_motion_in_c(asymmetric, tmp_path):
    """Rests at 0.1 and 0.133 that rounding moves by 1e-16: no friction there, in C as in the basis."""
    reference = np.concatenate([np.zeros(50), np.linspace(0, 0.133, 100), np.full(200, 0.133)])
    reference[200:] += 1e-16 * np.random.default_rng(3).integers(-2, 3, 150)
    assert np.any(np.diff(reference[200:]))
    basis = make_basis([{"kind": "friction", "asymmetric": asymmetric}], 5e-4)
    theta = np.array([3.0, 4.0])[: basis.n_parameters]
    expected = basis.regressors(reference) @ theta
    assert not np.any(expected[160:])
    assert np.all(expected[60:140] == 3.0)
    np.testing.assert_array_equal(compiled(realise(basis, theta), reference, tmp_path), expected)


@pytest.mark.parametrize("name", CASES)
def test_the_c_header_states_the_sample_time(name):
    basis = make_basis(CASES[name], 5e-4)
    text = c_header(realise(basis, np.ones(basis.n_parameters)), "test")
    assert "#define FFL_SAMPLE_TIME 0.0005\n" in text


def test_json_states_the_friction_formula_and_a_free_run_is_refused(
    write_campaign, tmp_path, capfd, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    friction = 'basis = [{ kind = "friction" }]'
    path = write_campaign(('basis = [{ kind = "fir", preview = 2, lag = 2 }]', friction))
    run_campaign(load_campaign(path), tmp_path / "out")
    export = ["export", "out", "--format", "json", "--out", "f.json", "--run"]
    assert execute([*export, "fir"]) == 0
    document = json.loads((tmp_path / "f.json").read_text())
    assert document["friction"][0]["stands"] == STANDS
    assert "s = 0 where |v(t)| <= stands times the largest |v|" in document["how"]
    (tmp_path / "f.json").unlink()
    for format in ("json", "c"):
        assert execute([*export, "free", "--format", format]) == 2
        said = capfd.readouterr().err
        assert said == "ffl: basis 'free' is not a filter of the reference; export csv or mat\n"
    assert not (tmp_path / "f.json").exists()

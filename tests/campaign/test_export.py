"""What is exported computes the same feedforward as the basis, in C too."""

import ctypes
import json
import shutil
import subprocess

import numpy as np
import pytest

from ffl.bases import make_basis
from ffl.campaign.c_header import c_header
from ffl.campaign.export import realise
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
    "sum": [{"kind": "fir", "delays": [0]}, OBF, {"kind": "friction"}],
}


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
        sign = np.clip(v / term["velocity"], -1, 1) if term["velocity"] else np.sign(v)
        f += sign * np.where(sign > 0, term["level_positive"], term["level_negative"])
    np.testing.assert_allclose(f, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_c_header_gives_the_feedforward(case, tmp_path):
    basis, theta, reference, expected = case
    (tmp_path / "learned.h").write_text(c_header(realise(basis, theta), "test"))
    (tmp_path / "use.c").write_text(
        '#include "learned.h"\n'
        "void use(const double *r, double *f, int n) { ffl_feedforward(r, f, n); }\n"
    )
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "use.c", "-o", "use.so"], cwd=tmp_path, check=True)
    f, pointer = np.empty_like(reference), ctypes.POINTER(ctypes.c_double)
    use = ctypes.CDLL(str(tmp_path / "use.so")).use
    use(reference.ctypes.data_as(pointer), f.ctypes.data_as(pointer), len(f))
    np.testing.assert_allclose(f, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_a_free_signal_is_no_filter():
    with pytest.raises(InputError, match="not a filter of the reference"):
        realise(make_basis([{"kind": "free"}], 1e-3), np.zeros(10))

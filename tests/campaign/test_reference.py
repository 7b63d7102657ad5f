import numpy as np
import pytest

from ffl.campaign.forms import FileForm, MultisineForm
from ffl.campaign.reference import build_reference, check_rest, lead
from ffl.errors import InputError


@pytest.mark.parametrize("n", [20, 60])
def test_a_lead_in_meets_position_velocity_and_acceleration(n):
    steps = np.arange(50.0)
    signal = 3.0 + 0.4 * steps - 0.02 * steps**2 + 1e-4 * steps**3
    joined = np.concatenate([lead(signal, n), signal])
    k = np.arange(-n, 0) / n + 1.0
    assert joined[0] == 0.0
    quintic = np.polynomial.Polynomial.fit(k, joined[:n], 5).convert()
    assert quintic(1.0) == pytest.approx(3.0, rel=1e-6)
    assert quintic.deriv()(1.0) / n == pytest.approx(0.4, rel=1e-6)
    assert quintic.deriv(2)(1.0) / n**2 == pytest.approx(-0.04, rel=1e-6)
    assert abs(quintic.deriv()(0.0)) < 1e-6
    check_rest(joined)


def test_multisine_has_its_band_and_rms(tmp_path):
    form = MultisineForm(kind="multisine", band=[2.0, 20.0], rms=0.01, duration=5.0, taper=0.0)
    reference = build_reference(form, 1e-3, tmp_path)
    assert len(reference) == 5000
    inner = reference[500:-500]
    assert np.sqrt(np.mean(inner**2)) == pytest.approx(0.01)
    spectrum = np.abs(np.fft.rfft(inner)) ** 2
    f = np.fft.rfftfreq(len(inner), 1e-3)
    assert spectrum[(f < 1.9) | (f > 20.1)].sum() < 1e-20 * spectrum.sum()
    np.testing.assert_array_equal(reference, build_reference(form, 1e-3, tmp_path))


def test_a_taper_keeps_the_rms_and_fits_between_the_rests(tmp_path):
    """Scaled before its taper, a reference of 1e-3 came out as 0.64e-3."""
    form = {"kind": "multisine", "band": [2.0, 20.0], "rms": 1e-3, "duration": 3.0, "rest": 0.5}
    reference = build_reference(MultisineForm(**form, taper=1.0), 1e-3, tmp_path)
    assert np.sqrt(np.mean(reference[500:-500] ** 2)) == pytest.approx(1e-3)
    with pytest.raises(InputError, match=r"taper = 1.1 s is more than half of the 2 s between"):
        build_reference(MultisineForm(**form, taper=1.1), 1e-3, tmp_path)


def test_a_band_beyond_nyquist_is_refused(tmp_path):
    form = MultisineForm(kind="multisine", band=[2.0, 600.0], rms=0.01, duration=5.0)
    with pytest.raises(InputError, match="<= 500 Hz"):
        build_reference(form, 1e-3, tmp_path)


@pytest.mark.parametrize(
    ("reference", "says"),
    [
        (np.ones(20), "constant"),
        (np.arange(20.0), "does not start at rest"),
        (1.0 + np.r_[0, 0, np.arange(20.0) ** 4], "does not start at rest"),
        (np.r_[0.0, 0.0, np.nan, 1.0], "sample 2 is not a finite number"),
    ],
)
def test_rest_is_checked(reference, says):
    with pytest.raises(InputError, match=says):
        check_rest(reference)


def test_a_table_of_time_and_reference_is_enough(tmp_path, monkeypatch):
    path = tmp_path / "path.csv"
    path.write_text("t,r\n" + "".join(f"{k / 1000:.3f},{k * k / 1e4}\n" for k in range(30)))
    form = FileForm(kind="file", file="path.csv", start=0.005, duration=0.02)
    np.testing.assert_allclose(
        build_reference(form, 1e-3, tmp_path), np.arange(5.0, 25.0) ** 2 / 1e4
    )
    monkeypatch.setenv("FFL_DATA", str(tmp_path))
    found = build_reference(form, 1e-3, tmp_path / "elsewhere")
    assert len(found) == 20
    with pytest.raises(InputError, match="sample time"):
        build_reference(form, 2e-3, tmp_path)

"""Best linear models of the public benchmarks, fitted on estimation data only."""

import os
from pathlib import Path

import numpy as np
import pytest

from ffl.identify.linear import as_signals, best_linear, fit_linear
from ffl.recordings import read_recording
from ffl.systems import load_plant

FOLDER = Path(os.environ.get("FFL_DATA", Path("..") / "shared" / "data"))


def recording(path, mapping, name=None):
    file = FOLDER / path
    if not file.is_file():
        pytest.skip(f"{file} is missing; get it from nonlinearbenchmark.org and set FFL_DATA")
    return as_signals(read_recording(file, mapping, name=name))[0]


def test_silverbox_arrow_from_the_multisine_part():
    """The shared figure for the best linear model is 14.4 mV."""
    multisine = recording("silverbox/SNLS80mV.mat", "silverbox", "multisine")
    arrow = recording("silverbox/SNLS80mV.mat", "silverbox", "arrow")
    model = fit_linear(multisine.cut(0, 30_000), 2)
    assert model.overlay(arrow).rmse < 14.6e-3
    assert model.poles[0].frequency_hz == pytest.approx(69.5, abs=0.5)


def test_cascaded_tanks_are_two_lags():
    estimation = recording("cascaded_tanks/dataBenchmark.csv", "cascaded_tanks", "estimation")
    test = recording("cascaded_tanks/dataBenchmark.csv", "cascaded_tanks", "test")
    model = best_linear(estimation, (1, 2, 3, 4))
    assert model.structure.order == 2
    assert model.overlay(test).rmse < 0.60


def test_coupled_drives_from_both_uniform_sets():
    """Published protocol: 300 samples of each set estimate, the last 200 test. The sensor does not
    see the sign, so no linear model is good (shared figure 0.416); this one is stable and no worse
    than 0.60 ticks/s (output: 0.9)."""
    sets = [recording("ced/DATAUNIF.csv", "ced_uniform", f"uniform_{k}") for k in (1, 2)]
    model = best_linear([whole.cut(0, 300) for whole in sets], (1, 2, 3, 4))
    assert model.system.is_stable
    for whole in sets:
        overlay = model.overlay(whole, 300)
        assert np.sqrt(np.mean((overlay.measured - overlay.output)[-200:] ** 2)) < 0.60


def test_emps_mass_in_closed_loop():
    """Documented: 95.1 kg, offset -3.165 N on the side of the friction (so a load of +3.165 N)."""
    estimation = recording("emps/DATA_EMPS.mat", "emps")
    test = recording("emps/DATA_EMPS_PULSES.mat", "emps")
    controller = load_plant("emps").controller
    model = fit_linear(estimation, 2, controller=controller, integrators=1)
    zero, gain = model.zeros[0].value.real, model.system.gain
    assert estimation.sample_time**2 / (gain * (1 - zero)) == pytest.approx(95.1, rel=0.02)
    assert model.load == pytest.approx(3.165, abs=0.1)
    assert model.overlay(test).rmse < 8e-6

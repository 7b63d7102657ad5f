import numpy as np
import pytest

from ffl.systems import Move, load_plant, moves


@pytest.fixture(scope="session")
def model():
    return load_plant("flatbed_printer")


@pytest.fixture(scope="session")
def reference():
    return moves([Move(0.8, 0.1, 0.4, 3.0, 60.0)], 3.0, 1e-3)


@pytest.fixture(scope="session")
def first_trial(model, reference):
    """Error and command of a trial with feedback only, on the machine as built, some noise."""
    built = load_plant("flatbed_printer_built")
    rng = np.random.default_rng(0)
    n = len(reference)
    noise = [0.01 * rng.standard_normal(n), 3e-7 * rng.standard_normal(n)]
    y, u = built.loop.system.filter(np.column_stack([reference, np.zeros(n), *noise])).T
    return reference - y, u

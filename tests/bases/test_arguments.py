"""What a file gives a basis is of the type that the basis states, or one line says what to give."""

import numpy as np
import pytest

from ffl.bases import make_basis
from ffl.errors import InputError


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ({"kind": "fir", "delays": [0.5, 1]}, r"\[0\].delays = \[0.5, 1\]: give a list of whole"),
        ({"kind": "fir", "preview": "3"}, r"\[0\].preview = '3': give a whole number"),
        ({"kind": "fir", "lag": True}, r"\[0\].lag = True: give a whole number"),
        ({"kind": "obf", "poles": ["0.5"]}, r"\[0\].poles = \['0.5'\]: give a list of reals or of"),
        (
            {"kind": "obf", "poles": [[0.5, 0.1, 0.2]]},
            r"\[0\].poles = .*: give a list of reals or of",
        ),
        (
            {"kind": "obf", "poles": [0.5], "feedthrough": "no"},
            "feedthrough = 'no': give true or false",
        ),
        (
            {"kind": "derivatives", "orders": "velocity"},
            "orders = 'velocity': give a list of names",
        ),
        ({"kind": "friction", "velocity": "a"}, "velocity = 'a': give a number"),
        ({"kind": "friction", "asymmetric": 1}, "asymmetric = 1: give true or false"),
        ({"kind": "filter", "taps": 1.0}, "taps = 1.0: give a list of numbers"),
        (
            {"kind": "obf", "poles": [0.5], "repeat": 100000},
            "repeat = 100000 gives 100000 parameters",
        ),
        ({"kind": "fir", "preview": 10**12}, "gives 1000000000001 parameters; at most 5000"),
    ],
)
def test_arguments_of_another_type_are_refused(spec, says):
    with pytest.raises(InputError, match=says):
        make_basis([spec], 1e-3)


def test_numbers_of_numpy_are_numbers():
    poles = np.array([0.5, 0.3 + 0.1j, 0.3 - 0.1j])
    basis = make_basis([{"kind": "obf", "poles": poles, "repeat": np.int64(2)}], 1e-3)
    assert basis.n_parameters == 6

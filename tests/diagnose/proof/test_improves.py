"""What was named explains nothing where held-out runs are no nearer for it."""

import pytest

from ffl.diagnose.proof.prove import Proof


@pytest.mark.parametrize(
    ("y", "u", "improves"),
    [
        ((0.2, 0.1), (None, None), True),
        ((0.2, 0.2), (None, None), False),
        ((0.002, 0.0024), (0.3, 0.1), True),  # feedback hides it in y
        ((0.002, 0.0024), (0.021, 0.023), False),
    ],
)
def test_what_is_nearer_in_y_or_in_u_is_nearer(y, u, improves):
    proof = Proof(("held.csv",), *y, 0.001, *u, None, (0.0, 0.0), ())
    assert proof.improves is improves

"""What was told by prediction and whose free runs part from the machine."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from ffl.diagnose.proof.rules import PARTED, parted


@pytest.mark.parametrize(
    ("names", "predicted", "times", "far"),
    [
        (("saturation", "stribeck_friction"), True, 1.1 * PARTED, True),
        (("saturation", "stribeck_friction"), True, 0.9 * PARTED, False),
        (("coulomb_friction",), False, 1.1 * PARTED, False),  # judged by its free runs anyway
        (("coulomb_friction", "backlash"), True, 1.1 * PARTED, False),  # a loop that rattles parts
    ],
)
def test_a_friction_whose_free_runs_are_far_off_is_none(names, predicted, times, far):
    standing = SimpleNamespace(predicted=predicted, model=SimpleNamespace(names=names))
    proof = SimpleNamespace(nrmse_before=0.04, nrmse_after=0.04 * times)
    assert parted(standing, proof) is far

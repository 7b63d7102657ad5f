"""What is advised where a map without a name is all that is found."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffl.diagnose.proof.conclude import _advice
from ffl.diagnose.recorded.where import Place


@pytest.mark.parametrize("said", ["unnamed", "explained"])
def test_a_controller_that_is_not_stated_is_asked_for(stage, said):
    place = Place("plant", "a dependence on position", ("position",))
    held = _advice(said, place, None, stage)
    free = _advice(said, place, None, replace(stage, controller=None))
    assert len(held) == (said == "unnamed")
    assert [line for line in free if "state it and record r" in line] == list(free[1:])
    assert len(free) == 2 * len(held)

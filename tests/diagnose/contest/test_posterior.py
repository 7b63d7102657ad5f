"""How sure a name is."""

from types import SimpleNamespace

import pytest

from ffl.diagnose.contest.posterior import (
    ELSE,
    ELSE_IF_FAR,
    ELSE_IF_MORE_IS_LEFT,
    ELSE_IF_MOST_IS_LEFT,
    none_of_them,
    probabilities,
)


@pytest.mark.parametrize(
    ("complete", "loud", "far", "share"),
    [
        (True, 0.0, False, ELSE),
        (True, 20.0, False, ELSE),
        (False, 3.0, False, ELSE_IF_MORE_IS_LEFT),
        (False, 3.0, True, ELSE_IF_FAR),
        (False, 20.0, True, ELSE_IF_MOST_IS_LEFT),
    ],
)
def test_what_names_share_goes_with_what_is_left(complete, loud, far, share):
    contenders = {
        "cogging": [(n, SimpleNamespace(score=s)) for n, s in (("cogging", 9.0), ("drift", 5.0))]
    }
    found = probabilities("cogging", contenders, none_of_them(complete, loud, far))
    assert sum(found.values()) == pytest.approx(1.0 - share)
    assert found["cogging"] / found["drift"] == pytest.approx(2.718281828)

"""How sure a name is."""

from types import SimpleNamespace

import pytest

from ffl.diagnose.contest.posterior import (
    ELSE,
    ELSE_IF_MORE_IS_LEFT,
    ELSE_IF_MOST_IS_LEFT,
    none_of_them,
    probabilities,
)


@pytest.mark.parametrize(
    ("complete", "loud", "share"),
    [
        (True, 0.0, ELSE),
        (True, 20.0, ELSE),
        (False, 3.0, ELSE_IF_MORE_IS_LEFT),
        (False, 20.0, ELSE_IF_MOST_IS_LEFT),
    ],
)
def test_what_names_share_goes_with_what_is_left(complete, loud, share):
    contenders = {
        "cogging": [(n, SimpleNamespace(score=s)) for n, s in (("cogging", 9.0), ("drift", 5.0))]
    }
    found = probabilities("cogging", contenders, none_of_them(complete, loud))
    assert sum(found.values()) == pytest.approx(1.0 - share)
    assert found["cogging"] / found["drift"] == pytest.approx(2.718281828)

"""What is said where a name does not hold on held-out recordings, and of another machine."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.maps.terms import TERMS
from ffl.diagnose.maps.unnamed import Contest
from ffl.diagnose.proof.verdict import foretold, is_unlike, refuted


def contest(verdict, winner=None):  # type: ignore[no-untyped-def]
    return Contest(verdict, None, winner, 0.0, 0.0, None, variables=("position",) if winner else ())


def by_position():  # type: ignore[no-untyped-def]
    """A map of the position that won beside a name."""
    part = SimpleNamespace(place=Place("force", "motor"), term=TERMS[0])
    return SimpleNamespace(parts=(part,), alike=(), ranking=(), variables=("position",))


def test_a_map_is_said_where_the_name_beside_it_does_not_hold():
    said, place = refuted(contest("partly", by_position()))
    assert said == "unnamed"
    assert "places along the stroke" in place.where
    assert place.port == Place("force", "motor").words
    assert place.component == "plant"


def test_nothing_is_said_where_no_map_is_beside_it():
    said, place = refuted(contest("named"))
    assert said == "inconclusive"
    assert "does not hold on the held-out recordings" in place.where
    assert not place.depends_on


@pytest.mark.parametrize(
    ("error", "with_map", "another"),
    [
        (0.3, None, False),
        (0.6, None, True),
        (0.6, 0.4, False),  # the map makes it the machine recorded
        (0.9, 0.6, True),
        (1.95, 0.62, False),  # far off without the map, and with it a third of that
        (1.95, 1.2, True),
    ],
)
def test_free_runs_far_off_are_another_machine_s_unless_a_map_brings_them_near(
    error, with_map, another
):
    assert is_unlike(error, with_map) is another


@pytest.mark.parametrize(
    ("off", "said", "words"),
    [(1.2, "explained", "rattles"), (12.0, "partly_explained", "leave 12 times")],
)
def test_a_play_is_not_all_where_free_runs_part_further_than_noise_parts_them(off, said, words):
    proof = SimpleNamespace(nrmse_after=off * 4e-5, noise_floor=4e-5)
    found, note = foretold("explained", proof)
    assert found == said
    assert words in note
    assert foretold("unnamed", proof)[0] == "unnamed"

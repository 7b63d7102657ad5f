"""What is said where a name does not hold on held-out recordings, and of another machine."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.maps.outcome import Contest
from ffl.diagnose.maps.terms import TERMS
from ffl.diagnose.proof import verdict as ending
from ffl.diagnose.proof.verdict import foretold, is_unlike, louder_than_noise, refuted


def contest(verdict, winner=None):  # type: ignore[no-untyped-def]
    return Contest(verdict, None, winner, 0.0, 0.0, None, variables=("position",) if winner else ())


def by_position():  # type: ignore[no-untyped-def]
    """A map of the position that won beside a name."""
    part = SimpleNamespace(place=Place("force", "motor"), term=TERMS[0])
    return SimpleNamespace(parts=(part,), alike=(), ranking=(), variables=("position",))


def proof(off, before):  # type: ignore[no-untyped-def]
    """Held-out free runs so many times off, and those of the model alone, as noise parts two."""
    return SimpleNamespace(nrmse_after=off * 4e-5, noise_floor=4e-5, improves=off < before)


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


@pytest.mark.parametrize("instead", [False, True])
def test_a_map_in_the_place_of_a_name_is_not_what_the_name_left(monkeypatch, instead):
    """Of a telescope's friction: "what is left: -67 sign(velocity)" beside that very friction."""
    for quick in ("coloured", "bent"):
        monkeypatch.setattr(ending, quick, lambda standing: False)
    monkeypatch.setattr(ending, "loudness", lambda plant, standing: 1.0)
    effects = (SimpleNamespace(name="coulomb_friction"),)
    stands = SimpleNamespace(model=SimpleNamespace(effects=effects), held_white=[])
    found = replace(contest("partly", by_position()), instead=instead)
    said, place = ending.verdict(None, stands, found)
    assert said == "partly_explained"
    assert ("what is left" in place.where) is not instead
    assert ("in its place" in place.where) is instead


@pytest.mark.parametrize(("left", "loud"), [((), "4"), (("direction",), "4"), ((), "1")])
def test_structure_that_remains_is_said_with_its_power_and_its_state(monkeypatch, left, loud):  # type: ignore[no-untyped-def]
    """Of an elevator's play: "structure remains", and not a word of what."""
    for quick in ("coloured", "bent"):
        monkeypatch.setattr(ending, quick, lambda standing: False)
    monkeypatch.setattr(ending, "loudness", lambda plant, standing: 1.0)
    monkeypatch.setattr(ending, "states", lambda white, motions: ())
    monkeypatch.setattr(ending, "goes_with", lambda found: left)
    effects = (SimpleNamespace(name="backlash"),)
    stands = SimpleNamespace(
        model=SimpleNamespace(effects=effects), held_white=np.full(100, float(loud) ** 0.5),
        scene=SimpleNamespace(trials=()), fit=SimpleNamespace(white=np.ones(100)),
    )  # fmt: skip
    said, place = ending.verdict(None, stands, contest("named"))
    assert said == ("explained" if loud == "1" else "partly_explained")
    assert ("what is left" in place.where) is bool(left)
    assert (f"{loud} times the power" in louder_than_noise(stands)) is (loud == "4")


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
    found, notes = foretold("explained", proof(off, 0.5 * off), ["backlash"])
    assert found == said
    assert words in notes[0]
    assert foretold("unnamed", proof(off, 0.5 * off), ["backlash"])[0] == "unnamed"


@pytest.mark.parametrize(
    ("off", "before", "said", "words"),
    [
        (1.1, 3.0, "explained", ()),
        (12.0, 13.0, "partly_explained", ("leave 12 times",)),
        (1.4, 1.0, "explained", ("no nearer",)),
        (2.6, 2.0, "partly_explained", ("leave 2.6 times",)),
    ],
)
def test_a_friction_in_noise_whose_free_runs_are_no_nearer_is_all_where_noise_parts_them_as_far(
    off, before, said, words
):
    found, notes = foretold("explained", proof(off, before), ["coulomb_friction"])
    assert found == said
    assert "sticks and slips" in notes[0]
    assert len(notes) == 1 + bool(words)
    assert all(word in notes[-1] for word in words)
    assert foretold("unnamed", proof(off, before), ["coulomb_friction"])[0] == "unnamed"

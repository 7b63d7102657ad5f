"""A sensor that glitches: y is put on its path, and what the controller made of it is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose import diagnose
from ffl.diagnose.recorded.equation import stated_ratio
from ffl.diagnose.recorded.glitches import without_glitches, without_turns
from ffl.machines import SimulatedMachine
from ffl.systems.plant import EffectSpec
from ffl.systems.zpk import as_state_space

AT = np.array([400, 911, 1500, 2222])


def logged(recording):
    """Glitches of what writes the file: nobody acted on them."""
    y = recording.y.copy()
    y[AT] += 2e-4
    return replace(recording, y=y)


def seen(plant, references, seed):
    """Recordings of a machine whose controller got the glitches: to first order what is known in f, and
    the sensor shows them as well."""
    rng, out = np.random.default_rng(seed), []
    for r in references:
        glitch = np.zeros(len(r))
        glitch[AT] = 2e-4 * rng.choice([-1.0, 1.0], len(AT))
        answer = as_state_space(plant.controller.output).filter(glitch)
        made = SimulatedMachine(plant).run(r, -answer, rng)
        out.append(replace(made, y=made.y + glitch, f=0.0 * made.f))
    return out


def test_a_recording_without_is_as_it_was(stage, record):
    recordings = record(stage)
    kept, notes = without_glitches(stage, recordings)
    assert not notes
    assert all(a is b for a, b in zip(kept, recordings, strict=True))


def test_what_only_the_file_shows_is_put_back_and_no_more(stage, record):
    clean = record(stage)[0]
    (kept,), notes = without_glitches(stage, [logged(clean)])
    assert np.abs(kept.y - clean.y).max() < 2e-6
    assert np.array_equal(kept.f, clean.f)
    assert "4 times, at 0.4 s, 0.911 s, 1.5 s and later: put back on it" in notes[0]


def test_what_the_controller_made_of_it_is_known(stage, references):
    recording = seen(stage, references, 0)[0]
    assert stated_ratio(stage, recording) < 1e-6
    (kept,), notes = without_glitches(stage, [recording])
    assert stated_ratio(stage, kept) < 1e-6
    assert np.any(kept.f)
    assert notes[0].endswith("what the controller made of it is taken as known")


@pytest.mark.parametrize("level", [0.0, 2.0])
def test_glitches_are_neither_physics_nor_do_they_hide_it(stage, references, level):
    friction = (EffectSpec("coulomb_friction", {"level": level}),) if level else ()
    fitted, judging = seen(replace(stage, effects=friction), references, 1)
    found = diagnose(stage, [fitted], [judging]).answer()
    assert found["verdict"] == ("explained" if level else "nothing_missing")
    assert [e["name"] for e in found["effects"]] == ["coulomb_friction"] * bool(level)
    assert sum("leaves its path" in note for note in found["notes"]) == 2


def test_an_angle_is_carried_on_over_the_turn_and_a_length_is_not(stage, record):
    """A path of 0.05 m as one of 500 deg: the same numbers, and a scale that ends at 360."""
    runs = [replace(r, r=1e4 * r.r, y=1e4 * r.y) for r in record(stage)]
    angles = replace(stage, output_unit="deg")
    wrapped = [replace(r, y=np.mod(r.y, 360.0)) for r in runs]
    kept, notes = without_turns(angles, wrapped)
    assert all("starts again after 360 deg" in note for note in notes)
    for one, whole in zip(kept, runs, strict=True):
        np.testing.assert_allclose(one.y, whole.y, atol=1e-6)
    assert without_turns(stage, wrapped) == (wrapped, [])


def test_a_position_is_carried_on_where_its_counter_is_full(stage, record):
    """16 bits of 0.5 um, 33 mm, under moves of 50 mm; begun in another of its ranges than r."""
    step = 5e-7
    runs = [replace(r, y=step * np.round(r.y / step)) for r in record(stage)]
    wrapped = [replace(r, y=r.y - 2**16 * step * np.round(r.y / (2**16 * step))) for r in runs]
    wrapped[1] = replace(wrapped[1], y=wrapped[1].y + 2**16 * step)
    kept, notes = without_turns(stage, wrapped)
    assert all("y wraps around after 2^16 = 65536 steps of 5e-07 m" in note for note in notes)
    assert [note.split(":")[0] for note in notes] == [r.source for r in runs]
    assert "unwrapped, carried on by 0.032768 m" in notes[0]
    for one, whole in zip(kept, runs, strict=True):
        np.testing.assert_allclose(one.y, whole.y, atol=1e-9)
    assert without_turns(stage, runs) == (runs, [])

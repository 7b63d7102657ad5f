"""Formulas put together of shapes: what an engineer would write, and not what comes near it."""

from __future__ import annotations

import numpy as np
import pytest

from ffl.diagnose.maps.composed import Map, columns_of, composed
from ffl.diagnose.maps.shapes import Shape, library

LAWS = {
    "two hinges, a slack strap's": (
        np.linspace(-40.0, 60.0, 49),
        lambda z: -1.658 * np.maximum(0.0, z - 28.6) + 0.698 * np.maximum(0.0, -14.3 - z),
        False,
        ["max(0, {z} - {0})", "max(0, {0} - {z})"],
        [28.6, -14.3],
    ),
    "an amplifier weak about zero": (
        np.linspace(-6.0, 6.0, 33),
        lambda z: -0.65 * z + 0.217 * z * np.abs(z),
        True,
        ["{z}", "{z} |{z}|"],
        [],
    ),
    "a fluid that thins": (
        np.linspace(-0.05, 0.05, 41),
        lambda z: -1500.0 * np.sign(z) * np.abs(z) ** 0.4,
        True,
        ["sign({z}) |{z}|^{0}"],
        [0.4],
    ),
    "one way alone": (
        np.linspace(-0.3, 0.3, 41),
        lambda z: -22.0 * np.maximum(0.0, z),
        True,
        ["max(0, {z})"],
        [],
    ),
    "a slider crank's inertia, five knots a period": (
        np.linspace(-4.0, 14.0, 29),
        lambda z: -0.015 * np.cos(2.0 * z),
        False,
        ["sin(2 pi {z}/{0} + {phase})"],
        [np.pi],
    ),
}


def test_a_line_a_hinge_at_a_knot_and_a_constant_are_drawn_as_they_are():
    z = np.array([-2.0, -1.0, -0.9, 0.0, 0.5, 3.0])
    laws = [lambda z: 3.0 * z - 1.0, np.ones_like, lambda z: np.maximum(0.0, z - 0.5)]
    for law in laws:
        drawn = Map(z, np.eye(6), z).columns([Shape("", law)])[:, 0]
        np.testing.assert_allclose(drawn, law(z), atol=1e-12)


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_told_as_it_was_built(name):
    z, law, signed, texts, inner = LAWS[name]
    rng = np.random.default_rng(4)
    r = np.linalg.qr(rng.normal(size=(4 * len(z), len(z))))[1] * 40.0 / np.abs(law(z)).max()
    q = r @ Map(z, r, z).columns([Shape("", law)])[:, 0] + rng.normal(size=len(z))
    pool = list(library(z[0], z[-1], signed, 4.0 * np.diff(z).max()))
    best, seen = float(q @ q), Map(z, r, q)
    found = composed(pool, seen, best)
    assert sorted(s.text for s in found) == sorted(texts)
    told = sorted(v for s in found for v in s.inner)
    np.testing.assert_allclose(told, sorted(inner), rtol=0.08)
    weights = np.linalg.lstsq(r @ seen.columns(found), q, rcond=None)[0]
    error = columns_of(found, z) @ weights - law(z)
    assert np.abs(error).max() < 0.05 * np.abs(law(z)).max()


def test_what_begins_at_a_moment_is_told_as_that():
    t = np.linspace(0.0, 4.0, 33)
    late = np.where(t > 1.9, 1.1, 0.0)
    r = 50.0 * np.eye(len(t))
    found = composed(list(library(0.0, 4.0, False, 0.5, timed=True)), Map(t, r, r @ late), 1e4)
    assert [s.text for s in found] == ["[from {z} {0} on]"]
    assert found[0].inner[0] == pytest.approx(1.9, abs=0.07)


def test_noise_alone_has_no_formula():
    rng = np.random.default_rng(8)
    z = np.linspace(-1.0, 1.0, 41)
    q = rng.normal(size=41)
    assert composed(list(library(-1.0, 1.0, True)), Map(z, np.eye(41), q), 4.0) == []

"""Shapes that a formula is put together from: what an engineer would draw through a map by hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ffl.systems.state_space import Array

POWERS = (0.3, 0.5, 0.7, 1.5, 2.5)
LEAST = (
    0.7  # periods of a wave that the variable's range holds: less of one is a line or a parabola
)


@dataclass(frozen=True)
class Shape:
    """s(z; inner): `columns` (k, m) over the grid; `text` with {z} and the inner numbers; `step`: how far
    each of these is moved first where it is refined; `most`: how large one may become."""

    text: str
    columns: Callable[..., Array]
    inner: tuple[float, ...] = ()
    step: float = 0.0
    most: float = np.inf

    @property
    def numbers(self) -> int:
        """Its inner numbers and its weights."""
        return len(self.inner) + self.weights

    @property
    def weights(self) -> int:
        return 2 if self.columns is wave else 1


def one(z: Array) -> Array:
    return np.ones_like(z)


def ramp(z: Array, c: float = 0.0) -> Array:
    return np.maximum(0.0, z - c)


def fall(z: Array, c: float = 0.0) -> Array:
    return np.maximum(0.0, c - z)


def bump(z: Array, c: float, w: float) -> Array:
    return np.exp(-0.5 * ((z - c) / w) ** 2)


def switch(z: Array, c: float) -> Array:
    """1 from c on; between two knots of the grid what a map can draw of it."""
    return np.clip((z - c) / np.gradient(z) + 0.5, 0.0, 1.0)


def brake(z: Array, w: float) -> Array:
    return z / (1.0 + (z / w) ** 2)


def power(z: Array, p: float) -> Array:
    return np.sign(z) * np.abs(z) ** p


def wave(z: Array, p: float) -> Array:
    return np.column_stack([np.sin(2 * np.pi * z / p), np.cos(2 * np.pi * z / p)])


STRAIGHT = Shape("{z}", lambda z: z)


def library(
    low: float, high: float, signed: bool, finest: float = 0.0, timed: bool = False
) -> Iterator[Shape]:
    """Shapes over low..high; `signed` variables may switch at zero, what is `timed` at any moment.
    `finest`: least period of a wave."""
    extent = high - low
    step = 0.02 * extent
    yield Shape("", one)
    yield STRAIGHT
    yield Shape("{z}^2", lambda z: z**2)
    yield Shape("{z}^3", lambda z: z**3)
    if signed:
        yield Shape("|{z}|", np.abs)
        yield Shape("sign({z})", np.sign)
        yield Shape("{z} |{z}|", lambda z: z * np.abs(z))
        yield Shape("max(0, {z})", ramp)
        yield Shape("max(0, -{z})", fall)
        for p in POWERS:
            yield Shape("sign({z}) |{z}|^{0}", power, (p,), 0.1)
        for w in np.geomspace(0.01, 1.0, 12) * 0.5 * extent:
            yield Shape("{z}/(1 + ({z}/{0})^2)", brake, (w,), step)
            yield Shape("tanh({z}/{0})", lambda z, w: np.tanh(z / w), (w,), step)
    for c in np.linspace(low, high, 31)[1:-1]:
        yield Shape("max(0, {z} - {0})", ramp, (c,), step)
        yield Shape("max(0, {0} - {z})", fall, (c,), step)
        if timed:
            yield Shape("[from {z} {0} on]", switch, (c,), step)
        for w in np.geomspace(0.02, 0.3, 6) * extent:
            yield Shape("exp(-(({z} - {0})/{1})^2/2)", bump, (c, w), step)
    longest = extent / LEAST
    for p in [p for p in extent / np.geomspace(LEAST, 12.0, 60) if p > finest]:
        yield Shape("sin(2 pi {z}/{0} + {phase})", wave, (p,), step, longest)

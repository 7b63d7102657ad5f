"""What the true structure leaves held out once it is fitted: to first order, the oracle's error.

An oracle that knows which effects there are and in which form still has to learn their numbers from
recordings that noise runs through. Its numbers are those an effect was drawn by (size, place, phase,
...), as likely anywhere in the range they are drawn from, and the nominal parameters within a careful
engineer's doubt. With J their traces in the whitened fitting recordings, stacked on the rows of what was
known before, R its triangular factor, and J_v their traces in a held-out recording of N samples,
estimation adds to the held-out mean square, on average,

    E |J_v d|^2 / N = |J_v R^-1|_F^2 / N,    d ~ (0, (R'R)^-1).

Numbers that an effect is not drawn by, and those in which the machine is not smooth, are taken as known:
who has to fit them leaves more.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from ffl.challenge.body import FAMILIES
from ffl.challenge.build import Build, Scales
from ffl.challenge.detect import Lens
from ffl.challenge.draw import Setup
from ffl.challenge.linear import Noise
from ffl.challenge.stage import Part, assemble, run, whole_run

STEP = 0.004  # of the range a number is drawn from, or of a nominal parameter's doubt
SPREAD = 1.0 / np.sqrt(12.0)  # standard deviation of a uniform number, of its range
ROUGH = 0.5  # forward and backward differences further apart, of their sum: not smooth


class Nudged:
    """The generator of `seed` whose number `which` comes moved by `step` of the range it is drawn from."""

    def __init__(self, seed: int, which: int, step: float) -> None:
        self.rng = np.random.default_rng(seed)
        self.which, self.step, self.drawn = which, step, 0

    def uniform(
        self, low: float = 0.0, high: float = 1.0, size: int | None = None
    ) -> float | np.ndarray:
        values = np.array(self.rng.uniform(low, high, size))
        at = self.which - self.drawn
        if 0 <= at < values.size:
            values.flat[at] += self.step * (high - low)
        self.drawn += values.size
        return values if size else float(values)

    def choice(self, values: list) -> object:
        return self.rng.choice(values)

    def random(self) -> float:
        return self.rng.random()


@dataclass(frozen=True)
class Moved(Part):
    """An effect with one of the numbers it was drawn by moved."""

    which: int = 0
    step: float = 0.0

    def generator(self) -> Nudged:
        return Nudged(self.seed, self.which, self.step)


def _numbers(part: Part, setup: Setup, scales: Scales) -> int:
    """How many numbers the effect is drawn by."""
    counted = Nudged(part.seed, -1, 0.0)
    part.make(Build.of(setup.true), counted, scales)
    return counted.drawn


def _machines(setup: Setup, parts: list[Part], scales: Scales) -> Iterator[tuple[Callable, float]]:
    """One number after another: the machine with it moved by a factor, and what was known of it before."""
    for k, part in enumerate(parts):
        for which in range(_numbers(part, setup, scales)):

            def effect(step: float, k: int = k, part: Part = part, which: int = which) -> Build:
                moved = Moved(part.name, part.at, part.seed, part.size, which, step)
                return assemble(setup, [*parts[:k], moved, *parts[k + 1 :]], scales)[0]

            yield effect, SPREAD
    family = FAMILIES[setup.family]
    for key, sd in family.doubts:
        doubt = max(sd, abs(setup.corrections.get(key, 0.0)))

        def nominal(step: float, key: str = key, doubt: float = doubt) -> Build:
            changed = {**setup.parameters, key: setup.parameters[key] * (1.0 + step * doubt)}
            return assemble(replace(setup, true=family.assemble(changed)), parts, scales)[0]

        yield nominal, 1.0


def fitted(
    setup: Setup, parts: list[Part], scales: Scales, noise: Noise
) -> list[tuple[float, float]]:
    """Mean squares that estimation adds in y and in u of each held-out recording."""
    lens = Lens(setup)

    def runs(build: Build) -> list[np.ndarray]:
        fit = [whole_run(build, setup, e, None)[0] for e in setup.fit]
        return [
            lens.whiten(noise, fit),
            *(s for e in setup.validate for s in run(build, setup, e, None)),
        ]

    centre = runs(assemble(setup, parts, scales)[0])
    columns, known = [], []
    for machine, spread in _machines(setup, parts, scales):
        sides = [
            [a - b for a, b in zip(runs(machine(s)), centre, strict=True)] for s in (STEP, -STEP)
        ]
        if not all(np.all(np.isfinite(x)) for side in sides for x in side):
            continue
        slope = [(a - b) / (2.0 * STEP) for a, b in zip(*sides, strict=True)]
        bend = [(a + b) / (2.0 * STEP) for a, b in zip(*sides, strict=True)]
        if all(
            np.linalg.norm(b) <= ROUGH * np.linalg.norm(s) for s, b in zip(slope, bend, strict=True)
        ):
            columns.append(slope)
            known.append(1.0 / spread)
    if not columns:
        return [(0.0, 0.0)] * len(setup.validate)
    traces = [np.array(rows).T for rows in zip(*columns, strict=True)]
    r = np.linalg.qr(np.vstack([traces[0], np.diag(known)]), mode="r")
    added = [
        float(np.sum(scipy.linalg.solve_triangular(r, t.T, trans="T") ** 2) / len(t))
        for t in traces[1:]
    ]
    return list(zip(added[::2], added[1::2], strict=True))


def floors_of(
    y: np.ndarray,
    y0: np.ndarray,
    u: np.ndarray,
    u0: np.ndarray,
    added: tuple[float, float] | None,
) -> dict[str, float]:
    """NRMSE that noise alone leaves in y and u, of which y0 and u0 are free, and, where it is known what
    estimation adds, that the true structure leaves once fitted."""
    found = {}
    for key, noisy, clean, more in zip(
        ("", "u_"), (y, u), (y0, u0), added or (None, None), strict=True
    ):
        scale = float(np.std(noisy))
        found[key + "nrmse_after"] = float(np.std(noisy - clean)) / scale
        if more is not None:
            found[key + "nrmse_fitted"] = math.hypot(
                found[key + "nrmse_after"], math.sqrt(more) / scale
            )
    return found

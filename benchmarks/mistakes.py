"""Recordings and plant files as people get them wrong: is the mistake said by its own name, and only then?

Cheap recordings of the challenge with nothing missing, over all its machines; in each one thing is wrong
that has nothing to do with physics. What is sound must stay sound.

    python benchmarks/mistakes.py [--count 60] [--seed 1] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from _cases import read_case

from ffl.challenge.make import null_case
from ffl.diagnose.recorded.mistaken import mistakes
from ffl.diagnose.recorded.sound import soundness
from ffl.recordings import Recording
from ffl.systems import Controller, Plant

Spoil = Callable[[Plant, Recording], tuple[Plant, Recording]]


@dataclass(frozen=True)
class Mistake:
    """What is wrong, the kinds of fault that say so, and whether it needs a controller."""

    about: str
    kinds: tuple[str, ...]
    spoil: Spoil
    closed: bool | None = None  # None: either


def _late(x: np.ndarray, n: int) -> np.ndarray:
    return np.concatenate([np.full(n, x[0]), x[:-n]])


def _scaled(plant: Plant, factor: float) -> Plant:
    return replace(plant, system=replace(plant.system, gain=factor * plant.system.gain))


def _controlled(plant: Plant, factor: float) -> Plant:
    c = plant.controller
    assert c is not None
    sides = {side: getattr(c, side) for side in ("reference", "output")}
    sides = {side: replace(part, gain=factor * part.gain) for side, part in sides.items()}
    return replace(plant, controller=Controller(**sides))


MISTAKES = (
    Mistake("nothing", (), lambda p, r: (p, r)),
    Mistake("u a thousand times too large", ("unit",), lambda p, r: (p, replace(r, u=1e3 * r.u))),
    Mistake("y a thousandth", ("unit",), lambda p, r: (p, replace(r, y=1e-3 * r.y))),
    Mistake(
        "y and r in millimetres",
        ("unit",),
        lambda p, r: (p, replace(r, y=1e3 * r.y, r=1e3 * r.r)),
        closed=True,
    ),
    Mistake("y in degrees", ("unit",), lambda p, r: (p, replace(r, y=r.y * 180 / np.pi))),
    Mistake("u with the other sign", ("sign",), lambda p, r: (p, replace(r, u=-r.u))),
    Mistake("y with the other sign", ("sign",), lambda p, r: (p, replace(r, y=-r.y))),
    Mistake("u and y exchanged", ("columns",), lambda p, r: (p, replace(r, u=r.y, y=r.u))),
    Mistake("u a sample late", ("shift",), lambda p, r: (p, replace(r, u=_late(r.u, 1))), True),
    Mistake("the controller left out", (), lambda p, r: (replace(p, controller=None), r), True),
    Mistake(
        "u three samples late, no controller",
        ("shift",),
        lambda p, r: (replace(p, controller=None), replace(r, u=_late(r.u, 3))),
    ),
    Mistake("y five samples late", ("shift",), lambda p, r: (p, replace(r, y=_late(r.y, 5))), True),
    Mistake(
        "the controller's gain 30 % too large",
        ("controller",),
        lambda p, r: (_controlled(p, 1.3), r),
        closed=True,
    ),
    Mistake("the plant's gain five times too large", ("unit",), lambda p, r: (_scaled(p, 5.0), r)),
    Mistake("the plant's gain a tenth", ("unit",), lambda p, r: (_scaled(p, 0.1), r)),
)


def said(plant: Plant, recordings: list[Recording]) -> str:
    """The kind of the first fault, or what keeps a diagnosis from beginning."""
    poles = plant.loop.poles
    if len(poles) and np.abs(poles).max() > 1.0 + 1e-9:
        return (
            "unstable"  # refused in a line that names the loop's pole, the controller and the gain
        )
    faults = mistakes(plant, recordings, soundness(plant, recordings).faults)
    return faults[0].kind if faults else "none"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    counts: dict[str, dict[str, int]] = {m.about: {} for m in MISTAKES}
    for number in range(asked.count):
        with tempfile.TemporaryDirectory() as folder:
            null_case(number, asked.seed).save(folder)
            plant, recordings, _ = read_case(Path(folder))
        for mistake in MISTAKES:
            if mistake.closed is not None and mistake.closed != (plant.controller is not None):
                continue
            spoiled = [mistake.spoil(plant, r) for r in recordings]
            word = said(spoiled[0][0], [r for _, r in spoiled])
            counts[mistake.about][word] = counts[mistake.about].get(word, 0) + 1
    if asked.json:
        print(json.dumps(counts, indent=2))
        return
    print(f"{'mistake':40} {'cases':>5} {'by name':>8}   said otherwise")
    for mistake in MISTAKES:
        own = counts[mistake.about]
        right = sum(own.get(kind, 0) for kind in mistake.kinds or ("none",))
        others = {k: n for k, n in own.items() if k not in (mistake.kinds or ("none",))}
        rest = ", ".join(f"{k} {n}" for k, n in sorted(others.items()))
        print(f"{mistake.about:40} {sum(own.values()):5d} {right:8d}   {rest}")


if __name__ == "__main__":
    main()

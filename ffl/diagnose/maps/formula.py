"""The simplest formula for a map that was found: a sparse regression over a small library of shapes.

To first order the data see a map only through R c = Q'target (the triangle of its whitened traces), so
a shape s(z) on the map's grid costs |q - R s b|^2, exactly what it would cost on the recordings, and
hundreds of shapes are tried in milliseconds (`composed`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffl.diagnose.hypothesis.triangle import lengths, triangle
from ffl.diagnose.maps.composed import Map, columns_of, composed
from ffl.diagnose.maps.freemodel import FreeModel, FreeScreen, Part, held_motion, tables_of
from ffl.diagnose.maps.shapes import STRAIGHT, Shape, library, one, wave
from ffl.systems.state_space import Array

STRAIGHTER = 0.1  # of a map of the command: what beside its formula goes in proportion to that
KNOTS = 4.0  # of a map to a period: a faster wave is what lies between them
UNEVEN = "velocity"  # what maps have knots of that lie close about zero


@dataclass(frozen=True)
class Formula:
    """`text` in words; `grid`, `values`: the formula over the map's own variable where it has one;
    `share`: of what the free map explains, how much the formula does; `pushes`: the force that it adds in
    proportion to the speed, by no other variable."""

    text: str
    grid: Array | None
    values: Array | None
    share: float
    pushes: float = 0.0


def formula(
    screen: FreeScreen, free: FreeModel, white: Array, index: int, scale: float,
    whole: bool = True, held: bool = False,
) -> Formula | None:  # fmt: skip
    """The formula of map `index` beside the other maps; `scale`: of its signal to its unit. `whole`: with
    what the map holds beside it in proportion to its variable, which is a number of the model's own.
    `held`: beside these numbers as stated, else beside those that suit it best."""
    part = free.parts[index]
    motions = [free.follow(trial, [part.place]) for trial in screen.scene.trials]
    if any(m is None for m in motions):
        return None
    along = [m[1] for m in motions if m is not None]
    table = tables_of(screen, [(part.term, part.place)], [part.ranges], along)[0]
    own = screen.from_nominal(free.model)
    target = white + own + table @ part.coefficients
    if not held:
        table, target = screen.beyond(table), screen.beyond(target)
    r, q = triangle(table, target)
    drawn = np.linalg.lstsq(r, q, rcond=1e-10)[0] if held else part.coefficients
    best = float(q @ q) - float(np.sum((q - r @ drawn) ** 2))
    if part.term.bank is not None:
        return _of_history(screen, part, along, target, best, scale)
    if part.term.grid is None:
        plain = len(part.coefficients) == 1 or part.term.along == "speed"
        return _plain(part, r, q, best, scale) if plain else None
    return _of_map(part, r, q, best, scale, whole)


def _of_map(
    part: Part, r: Array, q: Array, best: float, scale: float, whole: bool
) -> Formula | None:
    assert part.term.grid is not None
    z = part.term.grid(part.ranges)
    cost = float(q @ q)
    signed = part.term.along not in ("position", "time")
    finest = KNOTS * float(np.diff(z).max()) if part.term.along != UNEVEN else 0.0
    pool = library(float(z[0]), float(z[-1]), signed, finest, part.term.along == "time")
    seen = Map(z, r, q)
    shapes = composed(list(pool), seen, best)
    if not shapes:
        return None
    drawn = seen.columns(shapes)
    weights = np.linalg.lstsq(r @ drawn, q, rcond=1e-10)[0]
    left = float(np.sum((q - r @ drawn @ weights) ** 2))
    slope = _proportional(part, z, drawn @ weights, r) if whole else 0.0
    if slope:
        shapes, weights = [*shapes, STRAIGHT], np.append(weights, slope)
    table = columns_of(shapes, z)
    return Formula(
        _text(part, shapes, weights * scale), z, table @ weights * scale,
        min(1.0, (cost - left) / best) if best > 0 else 0.0,
        _by_speed(part, shapes, weights * scale),
    )  # fmt: skip


def _by_speed(part: Part, shapes: Sequence[Shape], weights: Array) -> float:
    """Weight of what is a force in proportion to the speed alone: a number of the linear model's own."""
    ways = {("position", "velocity"): one, ("velocity", ""): STRAIGHT.columns}
    own = ways.get((part.term.along, part.term.driver or ""))
    if own is None or part.place.port != "force":
        return 0.0
    each = np.repeat([s.columns is own for s in shapes], [s.weights for s in shapes])
    return float(weights[each].sum())


def _proportional(part: Part, z: Array, formula: Array, r: Array) -> float:
    """What is left of a map of the command, of the speed or of the position beside its `formula`, in
    proportion to that, 0 where it is little: mass, damping and stiffness could make up for it, so no shape
    is missed for want of it, but they stand where the map was found beside them. (A gain of 0.78 one way:
    0.11 |u|, and -0.11 u untold.)"""
    if part.term.driver or part.place.port == "output":
        return 0.0
    drawn, weight = part.coefficients, lengths(r)
    line = np.column_stack([np.ones(len(z)), z]) * weight[:, None]
    _, slope = np.linalg.lstsq(line, weight * (drawn - formula), rcond=1e-10)[0]
    large = np.linalg.norm(weight * slope * z) > STRAIGHTER * np.linalg.norm(weight * drawn)
    return float(slope) if large else 0.0


def _text(part: Part, shapes: Sequence[Shape], weights: Array) -> str:
    pieces, at = [], 0
    driver = f"{part.term.driver} " if part.term.driver else ""
    for shape in shapes:
        inner = [f"{v:.4g}" for v in shape.inner]
        if shape.columns is wave:
            a, b = weights[at : at + 2]
            at += 2
            body = shape.text.format(*inner, z=part.term.along, phase=f"{np.arctan2(b, a):.3g}")
            pieces.append(f"{np.hypot(a, b):.4g} {driver}{body}")
            continue
        body = shape.text.format(*inner, z=part.term.along).replace("- -", "+ ")
        pieces.append(f"{weights[at]:.4g} {driver}{body}".rstrip())
        at += 1
    return f"{_what(part)} = " + " + ".join(pieces).replace("+ -", "- ")


def _what(part: Part) -> str:
    return {"force": "force", "command": "added command", "output": "added to y"}[part.place.port]


def _of_history(
    screen: FreeScreen, part: Part, along: Sequence, target: Array, best: float, scale: float
) -> Formula:  # type: ignore[type-arg]
    """One time constant in place of the bank."""
    bank = part.term.bank
    assert bank is not None
    step, duration = part.ranges["step"]
    taus = np.geomspace(2 * step, 2 * duration, 36)
    columns = [bank(held_motion(m[part.place], part.place), part.ranges, taus) for m in along]
    table = screen.beyond(screen.through(part.place, columns))
    size = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
    seen = table.T @ target / size
    k = int(np.argmax(np.abs(seen)))
    value, tau = float(seen[k] / size[k]) * scale, float(taus[k])
    driver = f"{part.term.driver} " if part.term.driver else ""
    body = {
        "faded position": f"(position - lag(position, {tau:.3g} s))",
        "heat": f"lag(command^2, {tau:.3g} s)",
    }[part.term.along]
    share = min(1.0, float(seen[k] ** 2) / best) if best > 0 else 0.0
    return Formula(f"{_what(part)} = {value:.4g} {driver}{body}", None, None, share)


def _plain(part: Part, r: Array, q: Array, best: float, scale: float) -> Formula:
    """A single column says itself; push and pull alike over speed are a polynomial of it."""
    if len(part.coefficients) == 1:
        body = f"{part.term.driver} {part.term.along}".strip()
        text = f"{_what(part)} = {part.coefficients[0] * scale:.4g} {body}"
        return Formula(text, None, None, 1.0)
    half = len(part.coefficients) // 2
    v = np.linspace(0.0, max(abs(s) for s in part.ranges["v"]), half)
    table = np.tile(np.column_stack([v**0, v, v**2]), (2, 1))
    weights = np.linalg.lstsq(r @ table, q, rcond=1e-10)[0]
    share = (float(q @ q) - float(np.sum((q - r @ table @ weights) ** 2))) / best
    a, b, c = weights
    text = f"{_what(part)} = command ({a:.4g} + {b:.4g} speed + {c:.4g} speed^2)"
    return Formula(text.replace("+ -", "- "), None, None, float(np.clip(share, 0.0, 1.0)))

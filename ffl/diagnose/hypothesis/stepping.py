"""Single steps of a fit: damped least squares within bounds, and on along a valley."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy.optimize

from ffl.diagnose.hypothesis.coordinate import Coordinate
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.triangle import lengths, triangle
from ffl.systems.state_space import Array

if TYPE_CHECKING:
    from ffl.diagnose.contest.scene import Scene

TIGHT = 1e-12  # room at a bound, in units of the noise: what is there stays
ALIGNED = 0.8  # cosine from which two steps in a row go the same way
PROBE = 0.1  # of the root sum of squares that is left, by which a difference moves the prediction
WIDEST = 5.0  # usual difference steps of any one number
FARTHEST = 6  # doublings of a step
FEW = 12  # principal directions that are all looked along
TELLING = 0.9  # of a step, and of what it promises: what the directions looked along make of it


def damped(
    r: Array,
    seen: Array,
    damping: float,
    theta: Array,
    lower: Array,
    upper: Array,
    pull: Array,
    units: Array,
) -> tuple[Array, float]:
    """From R and Q' white of the Jacobian, the damped step that is best within the bounds and the
    decrease the linear model promises for it; `pull` draws theta to zero with so many standard
    deviations per unit. What moves nothing by its own size (`units`) stays."""
    white_in = np.append(seen, -pull * theta)
    r = np.vstack([r, np.diag(pull)])
    scale = np.linalg.norm(r, axis=0)
    free = scale * units > 1e-10 * max((scale * units).max(), 1e-300)
    index, step = np.flatnonzero(free), np.zeros(len(theta))
    if not len(index):
        return step, 0.0
    stacked = np.vstack([r[:, index] / scale[index], np.sqrt(damping) * np.eye(len(index))])
    padded = np.append(white_in, np.zeros(len(index)))
    step[index] = np.linalg.lstsq(stacked, padded, rcond=1e-12)[0] / scale[index]
    if np.any((theta + step < lower) | (theta + step > upper)):
        room = (lower - theta)[index] * scale[index], (upper - theta)[index] * scale[index]
        room = (np.minimum(room[0], -TIGHT), np.maximum(room[1], TIGHT))
        step[index] = scipy.optimize.lsq_linear(stacked, padded, room, "bvls").x / scale[index]
    left = white_in - r @ step
    return step, float(white_in @ white_in - left @ left)


def principal_steps(
    j: Array,
    white: Array,
    theta: Array,
    coordinates: Sequence[Coordinate],
    damping: float | None = None,
) -> Array:
    """Steps (p, p), in columns, along the principal directions of `j` in units of its columns, each of
    which moves the prediction by `PROBE` of what is left, `white`: far enough for kinks to even out,
    near enough for one step to go that way. No number moves by more than `WIDEST` of its usual steps,
    and what the data do not see moves by one of its own. With a `damping`, of more than `FEW` only those
    that make up the step with it (p, m)."""
    usual = np.array([c.step for c in coordinates])
    lower, upper = (np.array([getattr(c, k) for c in coordinates]) for k in ("lower", "upper"))
    sizes = lengths(j)
    seen = np.isfinite(sizes) & (sizes > 0)
    steps, chosen = np.diag(usual), np.ones(len(theta), dtype=bool)
    if np.any(seen):
        r, left = triangle(j[:, seen] / sizes[seen], white)
        out, values, across = np.linalg.svd(r)
        along = across.T / sizes[seen][:, None]
        reach = PROBE * np.linalg.norm(white) / np.maximum(values, 1e-12)
        most = WIDEST / np.max(np.abs(along) / usual[seen][:, None], axis=0)
        steps[np.ix_(seen, seen)] = along * np.minimum(reach, most)
        if damping is not None and len(theta) > FEW:
            chosen[:] = False
            chosen[seen] = _telling(values, out.T @ left, damping)
    for k in range(len(theta)):
        ahead = np.all((theta + steps[:, k] <= upper) & (theta + steps[:, k] >= lower))
        steps[:, k] *= 1.0 if ahead else -1.0
    # As far as there are numbers: a step that was cut short may not be counted in full.
    steps = np.clip(theta[:, None] + steps, lower[:, None], upper[:, None]) - theta[:, None]
    return steps[:, chosen & np.any(steps != 0.0, axis=0)]


def _telling(values: Array, seen: Array, damping: float) -> Array:
    """Which singular directions make up `TELLING` of the damped step's length and of what it promises:
    with s and g = u'white of each, s g/(s^2 + d) and g^2 (1 - (d/(s^2 + d))^2)."""
    kept = values**2 / np.maximum(values**2 + damping, 1e-300)
    length = (kept * seen / np.maximum(values, 1e-12)) ** 2
    promise = seen**2 * (1.0 - (1.0 - kept) ** 2)
    chosen = np.zeros(len(values), dtype=bool)
    for share in (length, promise):
        order = np.argsort(share)[::-1]
        enough = np.cumsum(share[order]) >= TELLING * np.sum(share)
        chosen[order[: 1 + int(np.argmax(enough))]] = True
    return chosen


def aligned(step: Array, before: Array, sizes: Array) -> bool:
    """Whether two steps of theta, each number weighed by what it changes (`sizes`), go the same way."""
    one, other = step * sizes, before * sizes
    size = np.linalg.norm(one) * np.linalg.norm(other)
    return bool(size > 0 and one @ other > ALIGNED * size)


def further_on(
    scene: Scene,
    model: Model,
    theta: Array,
    step: Array,
    bounds: tuple[Array, Array],
    now: float,
    cost_of: Callable[[Array, Array], float],
) -> tuple[Array, Model, list[Array], Array] | None:
    """From `theta`, which `step` led to at the cost `now`, on the same way, twice as far each time, while
    the cost falls: (theta, model, residuals, white) there, or None. On the floor of a narrow valley,
    where limits and stops make derivatives rough, every step is too short."""
    best, least = None, now
    for k in range(FARTHEST):
        there = np.clip(theta + 2.0**k * step, *bounds)
        candidate = model.at(there)
        residuals = scene.residuals(candidate)
        if residuals is None:
            break
        white = scene.whiten(residuals)
        cost = cost_of(white, there)
        if cost >= least:
            break
        best, least = (there, candidate, residuals, white), cost
    return best

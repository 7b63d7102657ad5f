"""Standard errors that hold where what is left is not white.

A name that is nearly right, or noise of another colour than the model's, leaves a residual in which
neighbours are alike. White noise of the same power would then tell the numbers better than the residual
does. With e the whitened residual, J its derivatives and H = (J'J)^-1,

    cov theta = H (sum_b s_b s_b') H,   s_b = J_b' e_b,

sums over blocks b of time, longer than what is left remembers (White 1980; blocks as of Newey and
West's lags). Reported is the larger of this and of white noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ffl.diagnose.hypothesis.fit import Fit, root_of
from ffl.systems.state_space import Array

if TYPE_CHECKING:
    from ffl.diagnose.contest.judging import Judged
    from ffl.diagnose.hypothesis.model import Model

BLOCKS = 20  # of all recordings together
FEWEST = 2  # of one recording
STEPS = np.geomspace(1e-5, 0.1, 13)  # relative, of a number whose likelihood goes in steps


def spread(fit: Fit, samples: Sequence[int]) -> Array:
    """Standard deviations of theta, (p,), infinite where the data see nothing; `samples` of each recording
    that was fitted, which sum to the rows of the Jacobian."""
    plain = fit.spread
    if fit.root is None or sum(samples) != len(fit.white):
        return plain
    j = np.where(np.isfinite(fit.jacobian).all(axis=0), fit.jacobian, 0.0)
    return np.fmax(plain, _by_blocks(j, fit.white, *fit.root, samples))


def _by_blocks(j: Array, white: Array, half: Array, scale: Array, samples: Sequence[int]) -> Array:
    """Square roots of the diagonal of H (sum_b s_b s_b') H, (p,), with H = half half'/(scale scale')."""
    rows, at = [], 0
    for n in samples:
        count = max(FEWEST, round(BLOCKS * n / len(white)))
        rows += [b for b in np.array_split(np.arange(at, at + n), count) if len(b)]
        at += n
    sums = np.array([(j[b] / scale).T @ white[b] for b in rows]) @ half
    with np.errstate(over="ignore", invalid="ignore"):
        return np.sqrt(np.sum((half @ sums.T) ** 2, axis=1)) / scale


def own_error_of(judged: Judged, index: int, name: str) -> float | None:
    """As `error_of`, with all numbers but those of effect `index` as they were found: how sure it is that
    there is something, not how large. (Seen through a spring between masses shared nobody knows how, a
    sine that brought 307 of score was 1.3 errors large, and by itself 25.)"""
    own = [
        k for k, c in enumerate(judged.model.coordinates) if (c.kind, c.effect) == ("effect", index)
    ]
    found = _error_among(judged, own, index, name)
    return error_of(judged, index, name) if found is None else found


def error_beside(judged: Judged, index: int, name: str, held: str) -> float | None:
    """As `error_of`, with number `held` of the same effect as it was found: where only what both make
    together is told, like the slope of a ramp, that is all there is to know of `name`."""
    others = [
        k
        for k, c in enumerate(judged.model.coordinates)
        if (c.kind, c.effect, c.name) != ("effect", index, held)
        and np.any(judged.fit.jacobian[:, k])
    ]
    return _error_among(judged, others, index, name)


def _error_among(judged: Judged, among: Sequence[int], index: int, name: str) -> float | None:
    """Standard error of number `name` of effect `index`, in its own unit, with none but the coordinates
    `among` free; None where it is not one of them, or they are not all seen."""
    coordinates, white = [judged.model.coordinates[k] for k in among], judged.fit.white
    keys = [(c.kind, c.effect, c.name, c.place) for c in coordinates]
    wanted, j = ("effect", index, name, None), judged.fit.jacobian[:, among]
    if wanted not in keys or not np.isfinite(j).all() or not np.any(j, axis=0).all():
        return None
    root = root_of(j, white, np.zeros(len(among)))
    assert root is not None
    half, scale = root
    inflate = max(1.0, judged.fit.cost / max(len(white) - len(among), 1))
    plain = np.sqrt(inflate * np.sum(half**2, axis=1)) / scale
    samples = [len(trial) for trial in judged.scene.trials]
    each = np.fmax(plain, _by_blocks(j, white, half, scale, samples))
    at = keys.index(wanted)
    value = float(judged.model.effects[index].parameters[name])
    return float(each[at]) * (value if coordinates[at].log else 1.0)


def stepped_error_of(judged: Judged, index: int, name: str) -> float | None:
    """How far number `name` of effect `index` may be moved, all others as they were found, before what is
    left is surely more: by one in the sum of squares over its own mean, as one standard error of a number
    with a slope is. The larger way of two, to the next of `STEPS`; None where none is far enough."""
    model, spec = judged.model, judged.model.effects[index]
    value = float(spec.parameters[name])
    bar = judged.scene.cost(model) + max(1.0, judged.fit.cost / max(len(judged.fit.white), 1))

    def cost(moved: float) -> float:
        other = replace(spec, parameters={**spec.parameters, name: moved})
        effects = tuple(other if k == index else s for k, s in enumerate(model.effects))
        return judged.scene.cost(replace(model, effects=effects))

    reach = []
    for way in (1.0, -1.0):
        within = [k for k, step in enumerate(STEPS) if not cost(value * (1.0 + way * step)) > bar]
        reach.append(max(within, default=-1) + 1)
    return abs(value) * float(STEPS[max(reach)]) if max(reach) < len(STEPS) else None


def error_of(judged: Judged, index: int, name: str) -> float | None:
    """Standard error of number `name` of effect `index`, in its own unit; None where it is not free."""
    for c, spread in zip(judged.model.coordinates, judged.spread, strict=True):
        if (c.kind, c.effect, c.name, c.place) == ("effect", index, name, None):
            value = float(judged.model.effects[index].parameters[name])
            return float(spread) * (value if c.log else 1.0)
    return None


def errors_through(judged: Judged, numbers: Callable[[Model], Array | None]) -> Array:
    """Standard errors (k,) of `numbers` (k,) that follow from those that are free: their slopes times
    the covariance of theta, as much larger as what is left is not white. None: numbers that a step leads
    nowhere with are taken on its other side."""
    model, plain = judged.model, judged.fit.spread
    theta, here = model.theta, numbers(model)
    assert here is not None
    slopes = np.zeros((len(here), len(theta)))
    for k, c in enumerate(model.coordinates):
        for step in (c.step, -c.step):
            moved = theta.copy()
            moved[k] += step
            if (there := numbers(model.at(moved))) is not None:
                slopes[:, k] = (there - here) / step
                break
    more = np.ones(len(theta))
    np.divide(judged.spread, plain, out=more, where=np.isfinite(plain) & (plain > 0.0))
    slopes *= more
    seen = np.any(slopes != 0.0, axis=0)
    covariance = judged.fit.covariance[np.ix_(seen, seen)]
    return np.sqrt(
        np.maximum(np.einsum("ik,kl,il->i", slopes[:, seen], covariance, slopes[:, seen]), 0.0)
    )

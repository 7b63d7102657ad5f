"""Order by held-out error: blocks left out, errors compared block by block, the simplest kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffl.identify.linear.coordinates import Structure
from ffl.identify.linear.levenberg import Fitted, minimise
from ffl.identify.linear.problem import Problem
from ffl.identify.linear.result import Rung
from ffl.identify.linear.signals import fold_weights
from ffl.systems.state_space import Array

NEGLIGIBLE = 1e-3  # of the output's variance: what a simpler model may cost at most
CLOSE = 0.1  # a rung more than this above the best (NRMSE) is not chosen, however few the blocks
ROUNDING = 1e-18  # of the output's variance: below it every model is exact
SUB_BLOCKS = 8  # per held-out block, for the paired standard error


@dataclass(frozen=True)
class Candidate:
    """A rung before the choice: squared held-out error per sub-block, relative to the variance."""

    structure: Structure
    errors: Array
    estimation: float
    status: str


def held_out(fitted: Fitted, problem: Problem, n_folds: int) -> Candidate:
    """Refits without each block, started at the fit on all data, and runs on through the block.

    The initial state comes from the fitted samples too, so nothing of the block is used: a free run
    for simulation methods, one-step predictions for `prediction_error`.
    """
    plain = replace(problem, autoregression=np.ones(1))
    target = np.concatenate([plain.predictor.target(p) for p in plain.pieces])
    variance = float(np.var(target))
    collected: list[float] = []
    iterations = 5 if problem.n_samples > 20_000 else 15
    for weights in fold_weights(problem.pieces, n_folds):
        kept = replace(problem, weights=weights)
        again = minimise(kept, fitted.point, iterations, 0.1)
        point = again.point if np.isfinite(again.cost) else fitted.point
        judge = replace(plain, weights=weights)
        for piece, weight in zip(problem.pieces, weights, strict=True):
            error = plain.predictor.target(piece) - judge.residual(point, piece).output
            judged = weight[-error.size :] == 0.0
            if piece.shown is not None:
                judged &= piece.shown[-error.size :]
            squares = error[judged] ** 2
            if not squares.size:
                continue
            parts = max(1, min(SUB_BLOCKS, squares.size // 10))
            collected += [float(np.mean(b)) for b in np.array_split(squares, parts)]
    estimation = float(np.sqrt(plain.cost(fitted.point) / target.size / variance))
    errors = np.array(collected) / variance
    return Candidate(problem.structure, errors, estimation, fitted.status)


def choose(candidates: Sequence[Candidate], tolerance: float) -> tuple[int, tuple[Rung, ...]]:
    """Index of the chosen candidate and all rungs.

    Chosen: the fewest parameters within one standard error of the best (and a tenth of its NRMSE),
    or within the fraction `tolerance` of its NRMSE and a thousandth of the output's variance.

    A fit that ended on the stability limit (a pole driven onto the unit circle by what is not
    linear) is shown but not chosen while there is another.
    """
    means = np.array([float(np.mean(c.errors)) for c in candidates])
    allowed = [i for i, c in enumerate(candidates) if c.status != "boundary"]
    allowed = allowed or list(range(len(candidates)))
    best = min(allowed, key=lambda i: means[i])
    rungs = []
    chosen = best
    for index, candidate in enumerate(candidates):
        difference = candidate.errors - candidates[best].errors
        error = standard_error(difference)
        excess = float(np.mean(difference))
        rungs.append(
            Rung(
                candidate.structure,
                float(np.sqrt(means[index])),
                candidate.estimation,
                excess,
                error,
                candidate.status,
            )
        )
        alike = np.sqrt(means[index]) <= (1 + tolerance) * np.sqrt(means[best])
        exact = means[index] <= ROUNDING
        near = means[index] <= (1.0 + CLOSE) ** 2 * means[best]
        close = exact or (near and excess <= error) or (alike and excess <= NEGLIGIBLE)
        if index in allowed and close and _size(candidate) < _size(candidates[chosen]):
            chosen = index
    return chosen, tuple(rungs)


def standard_error(x: Array) -> float:
    """Of the mean of a correlated sequence: first-order correlation makes the samples count less."""
    centred = x - x.mean()
    power = float(centred @ centred)
    if power == 0:
        return 0.0
    rho = float(np.clip(centred[1:] @ centred[:-1] / power, 0.0, 0.9))
    return float(np.sqrt(power / (x.size - 1) / x.size * (1 + rho) / (1 - rho)))


def _size(candidate: Candidate) -> int:
    """Parameters, a dead time counting as one."""
    return candidate.structure.n_parameters + (candidate.structure.delay > 0)

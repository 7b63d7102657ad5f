"""From scaled pieces and a structure to the best of several converged searches."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import scipy.linalg

from ffl.identify.linear.coordinates import Point, Structure, linear_directions
from ffl.identify.linear.levenberg import Fitted, linear_step, minimise
from ffl.identify.linear.noise import burg
from ffl.identify.linear.predictors import Innovation, Predictor, Simulation
from ffl.identify.linear.problem import Problem
from ffl.identify.linear.signals import Scale, Signals
from ffl.identify.linear.subspace import (
    LongModel,
    fit_structure,
    long_arx,
    realise,
    regularised_fir,
    stabilise,
)
from ffl.systems import Controller

Method = Literal["output_error", "prediction_error", "closed_loop"]
Noise = Literal["white", "autoregressive"]
TRIAL = 12_000  # samples on which rival starts are compared


def predictor_of(
    method: Method, s: Structure, controller: Controller | None, scale: Scale
) -> Predictor:
    if method == "prediction_error":
        return Innovation(s)
    if method == "closed_loop" and controller is not None:
        return Simulation.in_loop(s, controller, scale)
    return Simulation.open_loop(s)


@dataclass
class Search:
    """One set of scaled pieces; long models are estimated once and serve every order."""

    pieces: tuple[Signals, ...]
    method: Method
    scale: Scale
    controller: Controller | None
    noise: Noise = "white"
    max_iterations: int = 50
    largest_order: int = 8
    tolerance: float = 1e-6
    _long: dict[tuple[str, int, bool], LongModel] = field(default_factory=dict)

    def problem(self, s: Structure, pieces: tuple[Signals, ...] | None = None) -> Problem:
        predictor = predictor_of(self.method, s, self.controller, self.scale)
        return Problem(predictor, s, self.pieces if pieces is None else pieces)

    def long_model(self, kind: str, s: Structure) -> LongModel:
        key = (kind, s.delay, s.feedthrough)
        if key not in self._long:
            make = long_arx if kind == "arx" else regularised_fir
            largest = replace(s, order=max(self.largest_order, s.order))
            self._long[key] = make(_head(self.pieces, TRIAL), largest)
        return self._long[key]

    def starts(self, s: Structure, problem: Problem) -> list[Point]:
        """Subspace and realisation starts, brought to the structure, stable, numerator refitted."""
        kinds = ["arx"]
        if self.method == "output_error" and not s.integrators:
            kinds.append("fir")
        found: list[Point] = []
        for kind in kinds:
            try:
                raw = realise(self.long_model(kind, s), s.order, kind == "arx")
                found.append(self._prepare(fit_structure(raw, s), s, problem))
            except (np.linalg.LinAlgError, ValueError):
                continue  # this start has no answer here; the others stand
        return found

    def _prepare(self, point: Point, s: Structure, problem: Problem) -> Point:
        if s.innovation:
            inner = point.a - np.outer(point.k, point.c)
            tame = stabilise(inner)
            return replace(point, k=point.k) if tame is inner else _retuned(point, s)
        m = s.order - s.integrators
        a = point.a.copy()
        a[:m, :m] = stabilise(a[:m, :m])
        point = replace(point, a=a)
        if self.method == "output_error":
            point = linear_step(problem, point, linear_directions(point, s, "b"))
            if s.integrators:
                point = linear_step(problem, point, linear_directions(point, s, "c"))
        return point

    def fit(self, s: Structure, more: Iterable[Point] = ()) -> tuple[Fitted, Problem]:
        """Short searches from every start on at most `TRIAL` samples, the best carried on with all;
        then, where asked for, noise weighting."""
        problem = self.problem(s)
        trial = replace(problem, pieces=_head(self.pieces, TRIAL))
        starts = [*self.starts(s, trial), *more]
        if self.method == "closed_loop":
            starts += self._from_prediction(s)
        short = [minimise(trial, start, 6, 1e-2) for start in starts]
        best = min(short, key=lambda f: f.cost)
        if np.isfinite(best.cost):
            best = minimise(problem, best.point, self.max_iterations, self.tolerance)
        if self.method == "closed_loop" and best.status in ("stalled", "inadmissible_start"):
            again = [self._shoot(problem, start) for start in (starts[0], starts[-1])]
            found = [minimise(problem, p, self.max_iterations, self.tolerance) for p in again]
            best = min([best, *found], key=lambda f: f.cost)
        if not np.isfinite(best.cost):
            return best, problem
        if self.noise == "autoregressive" and not s.innovation:
            best, problem = self.weighted(problem, best)
        return self.marked(best, s), problem

    def marked(self, fitted: Fitted, s: Structure) -> Fitted:
        """Status `boundary` where a free-running pole decays slower than the longest record lasts:
        such a mode is a trend that the record cannot tell from a drift."""
        m = s.order - s.integrators
        if self.method != "output_error" or m == 0 or not np.isfinite(fitted.cost):
            return fitted
        radius = np.abs(np.linalg.eigvals(fitted.point.a[:m, :m])).max()
        limit = 1.0 - 1.0 / max(len(piece) for piece in self.pieces)
        return replace(fitted, status="boundary") if radius > limit else fitted

    def _shoot(self, problem: Problem, start: Point) -> Point:
        """The start improved on short pieces first, then longer ones: a loop that is almost right
        may be unstable, and the way to the right one then leads over the stability limit."""
        longest = max(len(piece) for piece in problem.pieces)
        shortest = 20 * (start.a.shape[0] + 2)
        for parts in (32, 8, 2):
            if longest // parts < shortest:
                continue
            found = minimise(problem.cut(longest // parts), start, 12, 1e-2)
            if np.isfinite(found.cost):
                start = found.point
        return start

    def weighted(self, problem: Problem, best: Fitted, rounds: int = 3) -> tuple[Fitted, Problem]:
        """Alternates an autoregressive noise model and the fit weighted by its inverse."""
        for _ in range(rounds):
            plain = replace(problem, autoregression=np.ones(1))
            coefficients, _ = burg([plain.residual(best.point, p).error for p in plain.pieces])
            problem = replace(problem, autoregression=coefficients)
            before = problem.cost(best.point)
            best = minimise(problem, best.point, self.max_iterations, self.tolerance)
            if before - best.cost < 1e-4 * before / problem.n_samples:
                break
        return best, problem

    def _from_prediction(self, s: Structure) -> list[Point]:
        """Plants of the one-step predictor: consistent under feedback, a start for the loop."""
        inner = Search(
            self.pieces,
            "prediction_error",
            self.scale,
            None,
            max_iterations=15,
            largest_order=self.largest_order,
            tolerance=1e-2,
            _long=self._long,
        )
        structure = replace(s, innovation=True, offset="input" if s.integrators else s.offset)
        fitted, _ = inner.fit(structure)
        if not np.isfinite(fitted.cost):
            return []
        offset = fitted.point.offset if structure.offset == s.offset else 0.0
        return [replace(fitted.point, k=np.zeros(s.order), offset=offset)]


def _head(pieces: tuple[Signals, ...], n_samples: int) -> tuple[Signals, ...]:
    """The first pieces, or the first part of one, up to `n_samples` in all."""
    kept: list[Signals] = []
    room = n_samples
    for piece in pieces:
        if room < min(len(piece), n_samples // 4):
            break
        kept.append(piece.cut(0, min(len(piece), room)))
        room -= len(kept[-1])
    return tuple(kept)


def _retuned(point: Point, s: Structure) -> Point:
    """A predictor gain that makes A - k c stable: the Kalman gain for process noise through b."""
    b = point.b[:, None]
    noise = b @ b.T + 1e-6 * np.eye(s.order)
    p = scipy.linalg.solve_discrete_are(point.a.T, point.c[:, None], noise, np.eye(1))
    gain = point.a @ p @ point.c / (1.0 + point.c @ p @ point.c)
    return replace(point, k=gain)


def extended(point: Point, s: Structure, smaller: Structure) -> Point:
    """An optimum of `smaller` as a start for `s`: further fast states that barely act."""
    extra = s.order - smaller.order
    m = smaller.order - smaller.integrators
    at = [m] * extra
    a = np.insert(np.insert(point.a, at, 0.0, axis=0), at, 0.0, axis=1)
    for i in range(extra):
        a[m + i, m + i] = (0.4, -0.4)[i % 2]
    # weak enough never to destabilise a loop that stands
    weak = 1e-6 * np.abs(point.c).max()
    b, c = np.insert(point.b, at, 0.3), np.insert(point.c, at, weak)
    return Point(a, b, c, point.d, np.insert(point.k, at, 0.0), point.offset)

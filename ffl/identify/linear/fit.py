"""`fit_linear`: one structure. `best_linear`: the order (and delay, integrators) by held-out error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from ffl import __version__
from ffl.errors import InputError, WorkError
from ffl.identify.linear.coordinates import Point, Port, Structure
from ffl.identify.linear.delay import estimate_delay
from ffl.identify.linear.ladder import Candidate, choose, held_out, standard_error
from ffl.identify.linear.levenberg import Fitted, minimise
from ffl.identify.linear.noise import independence, uncertainty, whiteness
from ffl.identify.linear.problem import Problem
from ffl.identify.linear.result import LinearModel, Rung
from ffl.identify.linear.roots import pole_estimates, zero_estimates
from ffl.identify.linear.search import Method, Noise, Search, extended
from ffl.identify.linear.signals import (
    Scale,
    Signals,
    as_signals,
    check_excitation,
    feedback_present,
    needs_controller,
)
from ffl.systems import Controller, StateSpace

DIRECT = 3.0  # standard errors by which feedthrough must win on held-out data
METHODS = ("auto", "output_error", "prediction_error", "closed_loop")


def _method(wanted: str, pieces: Sequence[Signals], controller: Controller | None) -> Method:
    if wanted not in METHODS:
        raise InputError(f"method '{wanted}' is not known; known: {', '.join(METHODS)}")
    if wanted == "closed_loop":
        needs_controller(controller, pieces)
    if wanted != "auto":
        return wanted  # type: ignore[return-value]
    if controller is not None and any(p.r is not None or p.f is not None for p in pieces):
        return "closed_loop"
    return "prediction_error" if feedback_present(pieces) else "output_error"


def _structure(
    order: int, integrators: int, delay: int, feedthrough: bool, method: Method, offset: str
) -> Structure:
    if order < 1 or integrators < 0 or integrators > order or delay < 0:
        raise InputError(
            f"order {order}, integrators {integrators}, delay {delay}: give order >= 1, 0 <= "
            "integrators <= order, delay >= 0"
        )
    if offset not in ("auto", "none", "output", "input"):
        raise InputError(f"offset '{offset}' is not known; give auto, none, output or input")
    port: Port = ("input" if integrators else "output") if offset == "auto" else offset  # type: ignore[assignment]
    return Structure(order, integrators, delay, feedthrough, method == "prediction_error", port)


def _check_length(pieces: Sequence[Signals], s: Structure) -> None:
    check_excitation(pieces, s.n_parameters, s.order)
    for piece in pieces:
        if len(piece) - s.delay < 4 * (s.order + 1):
            raise InputError(
                f"{piece.source}: {len(piece)} samples are too few for order {s.order} with delay "
                f"{s.delay}; leave this recording out or ask for a lower order"
            )


def fit_linear(
    recordings: Any,
    order: int,
    *,
    method: Literal["auto", "output_error", "prediction_error", "closed_loop"] = "auto",
    controller: Controller | None = None,
    integrators: int = 0,
    delay: int = 0,
    feedthrough: bool = False,
    offset: Literal["auto", "none", "output", "input"] = "auto",
    noise: Noise = "white",
    max_iterations: int = 50,
) -> LinearModel:
    """A linear model u -> y of given order from one or several recordings.

    Minimises the sum of squares of y - yhat over the plant, an offset and one initial state per
    recording (or whitened y - yhat, `noise="autoregressive"`), where yhat is

    - `output_error`: P u in free run (open loop);
    - `closed_loop`: the simulated loop of P and the known `controller` from r and f; without bias
      whatever the noise, and for plants that integrate;
    - `prediction_error`: the one-step prediction of the innovation form x+ = A x + B u + K e (any
      unknown feedback; a plant that integrates is predicted through its observer).

    `auto` takes `closed_loop` where a controller is given and r or f recorded, `prediction_error`
    where the data show feedback (r moves, or u is more than f), else `output_error`.
    `integrators` poles stand at 1 exactly; `delay` whole samples come on top of a strictly proper
    plant (`feedthrough`: y(t) sees u(t - delay)). Cost O(N order^3) per iteration.

    Source: L. Ljung, System Identification, 2nd ed., 1999, chapters 7, 9, 13; local coordinates of
    McKelvey et al. 2004. Raises `InputError` for data that cannot carry the model, `WorkError`
    where no start gives an admissible model.

    >>> rng = np.random.default_rng(1)
    >>> u = rng.standard_normal(500)
    >>> truth = StateSpace(0.8, 1.0, 0.5, 0.0, 0.01)
    >>> model = fit_linear(Signals(u, truth.filter(u) + 0.01 * rng.standard_normal(500), 0.01), 1)
    >>> abs(model.poles[0].value.real - 0.8) < 4 * model.poles[0].std_real
    True
    """
    pieces = as_signals(recordings, controller)
    kind = _method(method, pieces, controller)
    s = _structure(order, integrators, delay, feedthrough, kind, offset)
    _check_length(pieces, s)
    search = _search(pieces, kind, controller, noise, max_iterations, order, offset)
    fitted, problem = search.fit(s)
    _require(fitted, s, kind)
    return _result(search, fitted, problem, pieces, ())


def best_linear(
    recordings: Any,
    orders: Sequence[int] = tuple(range(1, 9)),
    *,
    method: Literal["auto", "output_error", "prediction_error", "closed_loop"] = "auto",
    controller: Controller | None = None,
    integrators: Sequence[int] | None = None,
    delays: Sequence[int] | None = None,
    feedthrough: bool | None = False,
    offset: Literal["auto", "none", "output", "input"] = "auto",
    noise: Noise = "white",
    n_folds: int = 5,
    tolerance: float = 0.02,
    max_iterations: int = 50,
) -> LinearModel:
    """The linear model whose order (and delay, and number of integrators) held-out data choose.

    Every candidate is fitted on all data and, from there, on the data without each of `n_folds`
    contiguous blocks; its error is that of the run through the blocks left out (the first part of a
    recording is never left out: it gives the initial state). Chosen is the candidate with the
    fewest parameters whose held-out error is within one standard error (paired over blocks) and a
    tenth of the best, or within the fraction `tolerance` of it and a thousandth of the output's
    variance.
    `feedthrough` None: none, unless in open loop and without delay the chosen order does better with it
    on held-out data by more than three standard errors (a recorder that filters u and y alike, whose u
    is no staircase, looks like that too); the order is then chosen anew among models with feedthrough,
    for what u does at once hides the poles: of P = 0.8 (z - 1.25)(z - 0.4) / ((z - 0.7)(z - 0.5)) one is
    left without it, whatever the noise. `delays` None: none, and what `estimate_delay` finds; `integrators`
    None: none in open loop, 0 and 1 under feedback. The rest as in `fit_linear`, all rungs in
    `ladder`.
    """
    pieces = as_signals(recordings, controller)
    kind = _method(method, pieces, controller)
    orders = sorted({int(order) for order in orders})
    if not orders or n_folds < 2:
        raise InputError("orders is empty or n_folds below 2; give orders such as 1 2 3, n_folds 5")
    if orders[0] < 1:
        raise InputError(f"order {orders[0]} is not 1 or more; give orders such as 1 2 3")
    if integrators is None:
        integrators = (0,) if kind == "output_error" else (0, 1)
    if delays is None:
        delays = sorted({0, estimate_delay(pieces, bool(feedthrough))})
    search = _search(pieces, kind, controller, noise, 15, max(orders), offset)
    search.tolerance = 1e-2  # a tenth of a standard error; the rung chosen is finished below
    kinds = [
        _structure(max(count, 1), count, delay, bool(feedthrough), kind, offset)
        for delay in delays
        for count in integrators
    ]
    _check_length(pieces, replace(kinds[0], order=max(orders[0], kinds[0].order)))
    _check_blocks(pieces, kinds, orders, n_folds)
    tried = _climb(search, kinds, orders, n_folds)
    if not tried:
        raise WorkError(_none_admissible(pieces, orders, kind))
    chosen = _settled(search, tried, tolerance, max_iterations)
    if feedthrough is None and _sees_at_once(search, chosen, n_folds):
        # what u does at once was in the way of the order too: climb again with it
        direct = replace(chosen.problem.structure, order=1, delay=0, feedthrough=True)
        beside = chosen.rungs
        chosen = _settled(
            search, _climb(search, [direct], orders, n_folds), tolerance, max_iterations
        )
        chosen = replace(chosen, rungs=beside + chosen.rungs)
    return _result(search, chosen.fitted, chosen.problem, pieces, chosen.rungs)


def _least_samples(s: Structure, n_folds: int) -> int:
    """Samples of a recording of which each block left out still shows a model of this order."""
    return (n_folds + 1) * (3 * (s.order + 1) + s.delay)


def _check_blocks(
    pieces: Sequence[Signals], kinds: Sequence[Structure], orders: Sequence[int], n_folds: int
) -> None:
    """Raises `InputError` where a recording is too short for the lowest order of every kind."""
    rungs = [replace(k, order=o) for k in kinds for o in orders if o >= max(k.integrators, 1)]
    if not rungs:
        return
    lowest = min(rungs, key=lambda s: _least_samples(s, n_folds))
    least, shortest = _least_samples(lowest, n_folds), min(pieces, key=len)
    if len(shortest) < least:
        lower = " or ask for a lower order" if lowest.order > 1 else ""
        raise InputError(
            f"{shortest.source}: {len(shortest)} samples are too few to choose among orders on held-out "
            f"blocks, of which order {lowest.order} needs {least}; record longer{lower}"
        )


def _none_admissible(pieces: Sequence[Signals], orders: Sequence[int], method: Method) -> str:
    listed = ", ".join(str(order) for order in orders)
    check = "check the controller, or " if method == "closed_loop" else ""
    return (
        f"{pieces[0].source}: none of the orders {listed} gave an admissible model with method "
        f"{method}; {check}try other orders"
    )


@dataclass(frozen=True)
class _Tried:
    """A rung of the ladder with the search that gave it."""

    candidate: Candidate
    fitted: Fitted
    problem: Problem


@dataclass(frozen=True)
class _Settled:
    """The rung chosen, its search carried to the end, and all rungs it was chosen from."""

    candidate: Candidate
    fitted: Fitted
    problem: Problem
    rungs: tuple[Rung, ...]


def _climb(
    search: Search, kinds: Sequence[Structure], orders: Sequence[int], n_folds: int
) -> list[_Tried]:
    """Every order of every kind (delay, integrators, feedthrough), from the smaller ones too."""
    tried: list[_Tried] = []
    shortest = min(len(p) for p in search.pieces)
    for kind in kinds:
        smaller: list[tuple[Structure, Point]] = []
        for order in (o for o in orders if o >= max(kind.integrators, 1)):
            s = replace(kind, order=order)
            if shortest < _least_samples(s, n_folds):
                break  # the blocks are too short for more
            more = [extended(point, s, small) for small, point in smaller[-2:]]
            fitted, problem = search.fit(s, more)
            if not np.isfinite(fitted.cost):
                continue
            smaller.append((s, fitted.point))
            tried.append(_Tried(held_out(fitted, problem, n_folds), fitted, problem))
    return tried


def _settled(
    search: Search, tried: Sequence[_Tried], tolerance: float, max_iterations: int
) -> _Settled:
    """The choice among the rungs, its search finished."""
    candidates = [one.candidate for one in tried]
    while True:
        index, rungs = choose(candidates, tolerance)
        problem = tried[index].problem
        finished = minimise(problem, tried[index].fitted.point, max_iterations)
        finished = search.marked(finished, problem.structure)
        if finished.status != "boundary" or candidates[index].status == "boundary":
            return _Settled(candidates[index], finished, problem, rungs)
        # carried to its end the fit ran onto the stability limit: choose again without it
        candidates[index] = replace(candidates[index], status="boundary")


def _sees_at_once(search: Search, chosen: _Settled, n_folds: int) -> bool:
    """Whether the structure chosen predicts held-out data better with feedthrough, surely."""
    s = chosen.problem.structure
    if search.method != "output_error" or s.delay or s.integrators:
        return False
    found, wider = search.fit(replace(s, feedthrough=True), [chosen.fitted.point])
    if not np.isfinite(found.cost) or found.status == "boundary":
        return False
    difference = held_out(found, wider, n_folds).errors - chosen.candidate.errors
    return float(np.mean(difference)) < -DIRECT * standard_error(difference)


def _search(
    pieces: tuple[Signals, ...],
    method: Method,
    controller: Controller | None,
    noise: str,
    max_iterations: int,
    largest_order: int,
    offset: str,
) -> Search:
    if noise not in ("white", "autoregressive"):
        raise InputError(f"noise '{noise}' is not known; give white or autoregressive")
    scale = Scale.of(pieces, centred=method != "closed_loop" and offset != "none")
    scaled = tuple(scale.apply(piece) for piece in pieces)
    return Search(
        scaled,
        method,
        scale,
        controller,
        noise,  # type: ignore[arg-type]
        max_iterations,
        largest_order,
    )


def _require(fitted: Fitted, s: Structure, method: Method) -> None:
    if not np.isfinite(fitted.cost):
        raise WorkError(
            f"order {s.order} with method {method}: no start gave an admissible model (stable, or "
            "stabilised by the stated controller); check the controller, or use prediction_error"
        )


def _offset(point: Point, s: Structure, scale: Scale) -> float:
    """The offset in the units of the data, the means that were taken off put back."""
    if s.offset == "none":
        return 0.0
    if s.offset == "input":
        return point.offset * scale.u - scale.u_mean
    found = point.offset * scale.y + scale.y_mean
    if scale.u_mean:
        found -= float(point.system(1.0).at(1.0)[0].real) * scale.y / scale.u * scale.u_mean
    return found


def _result(
    search: Search,
    fitted: Fitted,
    problem: Problem,
    pieces: Sequence[Signals],
    rungs: tuple[Rung, ...],
) -> LinearModel:
    point, s, scale = fitted.point, problem.structure, search.scale
    t = pieces[0].sample_time
    sure = uncertainty(problem, point)
    cov = sure.covariance
    plain = replace(problem, autoregression=np.ones(1))
    errors = [plain.residual(point, piece).error for piece in problem.pieces]
    n = sum(e.size for e in errors)
    spread = np.concatenate([plain.predictor.target(p) for p in problem.pieces]).std()
    rms = float(np.sqrt(sum(float(e @ e) for e in errors) / n))
    fitted_noise = s.order if s.innovation else problem.autoregression.size - 1
    signal = "u"
    if search.method == "closed_loop":
        moving = [x for x in ("r", "f") if all(getattr(p, x) is not None for p in pieces)]
        signal = max(moving, key=lambda x: sum(np.ptp(getattr(p, x)) > 0 for p in pieces))
    return LinearModel(
        state_space=StateSpace(
            point.a,
            point.b[:, None] / scale.u,
            point.c[None, :] * scale.y,
            point.d * scale.y / scale.u,
            t,
        ),
        structure=s,
        method=search.method,
        offset=_offset(point, s, scale),
        noise_std=float(np.sqrt(sure.noise_variance)) * scale.y,
        innovation_gain=point.k / scale.y,
        poles=pole_estimates(point, s, sure.directions, cov, t),
        zeros=zero_estimates(point, sure.directions, cov, t),
        nrmse=rms / float(spread),
        whiteness=whiteness(sure.residuals, fitted_noise),
        independence=independence(problem, point, sure, signal),
        status=fitted.status,
        iterations=fitted.iterations,
        ladder=rungs,
        sources=tuple(piece.source for piece in pieces),
        settings={"structure": asdict(s), "method": search.method, "noise": search.noise},
        version=__version__,
        point=point,
        scale=scale,
        uncertainty=sure,
        controller=search.controller,
    )

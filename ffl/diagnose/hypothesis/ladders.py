"""Starts where the cost is not convex: ladders of simulations over the parameter that decides."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.parallel import each
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import Fit, fit
from ffl.diagnose.hypothesis.linear import modal_terms
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.hypothesis.span import orthonormal
from ffl.diagnose.hypothesis.triangle import lengths
from ffl.diagnose.screen.candidate import Candidate
from ffl.effects import EFFECTS
from ffl.effects.base import Setting
from ffl.effects.mechanics import Mechanics
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

COMMANDS = (0.7, 0.8, 0.87, 0.92, 0.95, 0.97, 0.98, 0.99)  # shares of samples below a limit
GLIMPSE = 8  # of so many samples one is simulated to see which starts are not worth the others
LIMIT, LOWEST, LEVELS = "saturation", 0.01, 28  # shares of the largest command
NEAR = 0.5  # of what the best start takes off the sum of squares
BOUND = 0.1  # logarithm of a ratio: so near it stands at its bound
SLACK = 1e-9  # of a sum of squares: rounding
FALLS = 0.5  # of the sum of squares: left by a start that the screen overlooked
PLAY, GAPS = "backlash", np.geomspace(3e-5, 0.03, 7)  # shares of the positions travelled
TAKEN = 32.0  # off the sum of squares, at least, by a form of it that no first order shows
# The same by another to first order: it joins first, and plays are looked for beside it.
MUCH = 200.0


def with_best_start(scene: Scene, c: Candidate, others: Sequence[EffectSpec] = ()) -> Model:
    """The model that the candidate is seen beside with its effect, in the valley, the form and with its
    decisive parameter at the rung of a ladder of simulations that leave least, whatever the numbers
    fitted there can mend beside it; `others`: further starts as they are."""
    starts = [m for spec in (c.spec, *c.valleys) for m in _rungs(scene, c.like.model, spec)]
    for other in (relieved, evened):
        starts += [m for start in starts if (m := other(start)) is not None]
    starts += [_beside(c.like.model, spec) for spec in others]
    if EFFECTS[c.spec.name].scan == "position":
        starts = _of_periods(scene, c.like, starts)
    return _best(scene, c.like, starts) or starts[0]


def _of_periods(scene: Scene, like: Fit, starts: Sequence[Model]) -> list[Model]:
    """Of `starts` with other periods those that may be the deepest; of more than one the likeliest after a
    few rounds, each by its own noise. (Half of a period, 86 um, took 597 off under noise as least as
    recordings can show, the whole one 421; by what each left as noise the whole one was 150 ahead.)"""
    base, costs = scene.cost(like.model), each(scene.cost, starts)
    least = min(costs)
    near = [m for m, cost in zip(starts, costs, strict=True) if base - cost > NEAR * (base - least)]
    if len(near) < 2:
        return near or list(starts)

    def likelihood(start: Model) -> tuple[float, Model]:
        model = fit(scene, start, rounds=3, known=like.shared(start)).model
        residuals = scene.residuals(model)
        return -np.inf if residuals is None else scene.in_own_noise(residuals), model

    return [max(each(likelihood, near), key=lambda pair: pair[0])[1]]


def _beside(model: Model, spec: EffectSpec) -> Model:
    """`model` with the effect, its numbers within bounds."""
    start = model.with_effect(spec)
    return start.at(start.theta)


def relieved(model: Model) -> Model | None:
    """An identified model with a spring that is softer by what its last effect, which remembers, holds with
    when it is small: it was learned with that in it. None where the effect is stiffer, or the model stated.
    (Without, the start that leaves least of a hysteresis as stiff as the spring is nearly none.)"""
    spec, mechanics = model.effects[-1], model.base.simulator.mechanics
    if not (model.base.plant.is_identified and EFFECTS[spec.name].remembers):
        return None
    bounds = next((c for c in model.base.corrections if c.name == "stiffness"), None)
    if bounds is None or "stiffness" in model.held:
        return None
    effect = EFFECTS[spec.name]
    setting = Setting(model.base.simulator.force_per_input, mechanics, spec.options)
    held = effect.stiffness(effect.pack(effect.check(spec), setting))
    own = modal_terms(mechanics, mechanics.modes[0])[1] * mechanics.moving_mass
    softer = model.corrections.get("stiffness", 0.0) - held / own
    if not (held > 0.0 and bounds.lower < softer < bounds.upper):
        return None
    return replace(model, corrections={**model.corrections, "stiffness": softer})


def evened(model: Model) -> Model | None:
    """`model` with equal masses at motor and load where their ratio stands at a bound, to which what is
    missing has pushed it. (Beside a spring alone 20 : 1, and no mode at such a motor left less than none;
    at 1 : 1 one of 110 Hz was 1,770 ahead.)"""
    theta = model.theta.copy()
    for k, c in enumerate(model.coordinates):
        if c.name == "mass_ratio" and (theta[k] < c.lower + BOUND or theta[k] > c.upper - BOUND):
            theta[k] = 0.0
            return model.at(theta)
    return None


def _rungs(scene: Scene, model: Model, spec: EffectSpec) -> list[Model]:
    """All starts of one valley."""
    mechanics = model.simulator.mechanics
    forms = _forms(spec.name, mechanics)
    values = [spec.parameters]
    ladder = EFFECTS[spec.name].ladder
    if ladder and ladder[0] in spec.parameters:
        name, factors = ladder
        bounds = EFFECTS[spec.name].parameter(name)
        scaled = EFFECTS[spec.name].scaled(spec.parameters, name, factors)
        rungs = np.append(scaled, _measured_levels(scene, spec.name))
        rungs = np.clip(rungs, bounds.lower, bounds.upper)
        values += [EFFECTS[spec.name].rung(spec.parameters, name, float(value)) for value in rungs]
    return [
        _beside(model, replace(spec, parameters=p, options={**spec.options, **form}))
        for form in forms
        for p in values
    ]


def _forms(name: str, mechanics: Mechanics) -> list[dict[str, Any]]:
    """Forms of the effect that such a plant may have: no play of a measuring head where y is a speed."""
    forms = EFFECTS[name].forms(len(mechanics.modes) > 1, mechanics.sample_time)
    return [form for form in forms if mechanics.place is None or form.get("kind") != "play"]


def _best(scene: Scene, like: Fit, starts: Sequence[Model], below: float = np.inf) -> Model | None:
    """The start that leaves least, None where none leaves less than `below`.

    What the first samples leave alone, mended by numbers that need to fit no others, is less than what
    all leave: starts are simulated to the end in its order, up to the one that is beyond the best.
    """
    if len(starts) == 1 and below == np.inf:
        return starts[0]
    columns = scene.whiten_stacked(like.columns)
    rows = min(len(scene.trials[0]), max(scene.samples // GLIMPSE, 1))
    head = scene.head(rows)
    size = np.maximum(lengths(columns[:rows]), 1e-300)
    begun = np.linalg.qr(columns[:rows] / size)[0]
    least = each(lambda start: left_by(head, begun, start), starts)
    basis, costs = orthonormal(columns), np.full(len(starts), np.inf)
    order = deque(np.argsort(least, kind="stable"))

    def complete(_: int) -> None:
        k = order.popleft()
        if least[k] <= min(below, costs.min()) * (1.0 + SLACK):
            costs[k] = left_by(scene, basis, starts[k])

    each(complete, range(len(starts)))
    k = int(np.argmin(costs))
    return starts[k] if costs[k] < below else None


def left_by(scene: Scene, basis: Array, start: Model) -> float:
    """Sum of squares that a start leaves beyond `basis`."""
    residuals = scene.residuals(start)
    if residuals is None:
        return np.inf
    white = scene.whiten(residuals)
    with np.errstate(over="ignore", invalid="ignore"):  # a start that runs away
        mended = basis.T @ white
        cost = float(white @ white - mended @ mended)
    return cost if np.isfinite(cost) else np.inf


def _measured_levels(scene: Scene, name: str) -> Array:
    """Levels at which a limit would show in what was measured: of u as sent, which goes beyond a
    limit, and of y as seen, which ends there."""
    if name == "saturation":
        u = np.abs(np.concatenate([t.u for t in scene.trials]))
        return np.quantile(u[np.isfinite(u)], COMMANDS) if np.isfinite(u).any() else np.zeros(0)
    if name == "sensor_nonlinearity":
        return np.quantile(np.abs(np.concatenate([t.y for t in scene.trials])), [0.98, 0.999])
    return np.zeros(0)


def _limits(scene: Scene, like: Fit, known: Collection[str]) -> list[Candidate]:
    """A limit of the command where first order has none to propose, in which it would swing: at the
    share of the largest command that the simulation beside `like` sends which leaves least; `gain`: what
    that takes off the sum of squares."""
    if LIMIT in known:
        return []
    largest = max(float(np.abs(like.model.simulate(t).u).max()) for t in scene.trials)
    basis = orthonormal(scene.whiten_stacked(like.columns))
    levels = largest * np.geomspace(LOWEST, 1.0, LEVELS)
    specs = [EffectSpec(LIMIT, {"limit": float(level)}) for level in levels if level > 0.0]
    if not specs:
        return []
    left = np.array(each(lambda spec: left_by(scene, basis, like.model.with_effect(spec)), specs))
    gain = max(left_by(scene, basis, like.model) - float(left.min()), 0.0)
    return [Candidate(specs[int(np.argmin(left))], gain, 1, Place(EFFECTS[LIMIT].port), like)]


def _plays(scene: Scene, like: Fit, barred: Collection[str]) -> list[Candidate]:
    """A backlash from where it leaves least of all its forms and gaps, unless it is `barred` or takes
    nothing off. First order knows the play of what is measured alone: of a part that knocks behind it,
    which comes to nothing where it is small, it says nothing. (A gap of 0.12 mm, half of all that was
    left, took 5 off to first order, and 650 with 30 % of the mass behind it.)"""
    if PLAY in barred:
        return []
    travelled = max(float(np.ptp(trial.y)) for trial in scene.trials)
    mechanics = like.model.simulator.mechanics
    forms = _forms(PLAY, mechanics)
    specs = [EffectSpec(PLAY, {"gap": float(g)}, f) for f in forms for g in travelled * GAPS]
    if not specs:
        return []
    start = _best(scene, like, [_beside(like.model, s) for s in specs], like.cost - TAKEN)
    if start is None:
        return []
    return [Candidate(start.effects[-1], 0.0, 1, Place(EFFECTS[PLAY].port), like)]


def overlooked(
    quiet: Scene,
    base: Judged,
    like: Fit,
    fresh: Sequence[Candidate],
    listed: Sequence[Candidate],
    taken: Collection[str] = (),
) -> list[Candidate]:
    """Effects of which a simulation on their `ladder` shows what no first order does (a limit that makes
    the loop swing): a start from which the sum of squares falls to a small part, where noise is as small a
    part of it; a limit of the command, unless it is `taken`, also where first order proposes none, and
    where noise is a larger part if it takes more off than anyone listed does to first order. Where nobody
    takes much off to first order, a play of any form that does, unless it is listed or taken."""
    names = {c.spec.name for c in listed}
    most = max((c.gain for c in listed), default=0.0)
    out = _plays(quiet, like, names.union(taken)) if most < MUCH else []
    noisy, wanted = FALLS * base.fit.cost < len(base.fit.white), max(most, TAKEN)
    if noisy and base.fit.cost - len(base.fit.white) < wanted:
        return out
    limits = _limits(quiet, like, {c.spec.name for c in fresh} | set(taken))
    if noisy:
        return out + [c for c in limits if c.gain > wanted]
    names.update(c.spec.name for c in out)
    for c in [*fresh, *limits]:
        if EFFECTS[c.spec.name].ladder and c.spec.name not in names:
            names.add(c.spec.name)
            least = FALLS * base.fit.cost
            start = _best(quiet, c.like, _rungs(quiet, c.like.model, c.spec), least)
            residuals = None if start is None else quiet.residuals(start)
            if residuals is not None and float(np.sum(quiet.whiten(residuals) ** 2)) < least:
                out.append(c)
    return out

"""Starts where the cost is not convex: ladders of simulations over the parameter that decides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.fit import Fit, Scene
from ffl.diagnose.judging import Judged
from ffl.diagnose.model import Model
from ffl.diagnose.screen import Candidate, orthonormal
from ffl.effects import EFFECTS
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

COMMANDS = (0.7, 0.8, 0.87, 0.92, 0.95, 0.97, 0.98, 0.99)  # shares of samples below a limit
SWINGS = 4.0  # mean square of the whitened residual from which first orders may mislead
FALLS = 0.5  # of the sum of squares: left by a start that the screen overlooked


def with_best_start(scene: Scene, like: Fit, spec: EffectSpec) -> Model:
    """The model of `like` with the effect, in the form and with its decisive parameter at the rung
    of a ladder of simulations that leave least, whatever the numbers fitted in `like` can mend
    beside it."""
    model = like.model
    forms = EFFECTS[spec.name].forms(len(model.simulator.mechanics.modes) > 1)
    values = [spec.parameters]
    ladder = EFFECTS[spec.name].ladder
    if ladder and ladder[0] in spec.parameters:
        name, factors = ladder
        bounds = EFFECTS[spec.name].parameter(name)
        rungs = np.append(spec.parameters[name] * factors, _measured_levels(scene, spec.name))
        rungs = np.clip(rungs, bounds.lower, bounds.upper)
        values += [{**spec.parameters, name: float(value)} for value in rungs]
    tried = [
        replace(spec, parameters=p, options={**spec.options, **form})
        for form in forms
        for p in values
    ]
    starts = [model.with_effect(s) for s in tried]
    starts = [start.at(start.theta) for start in starts]  # within bounds
    if len(starts) == 1:
        return starts[0]
    basis = orthonormal(scene.whiten_stacked(like.columns))
    costs = []
    for start in starts:
        residuals = scene.residuals(start)
        if residuals is None:
            costs.append(np.inf)
            continue
        white = scene.whiten(residuals)
        with np.errstate(over="ignore", invalid="ignore"):  # a start that runs away
            mended = basis.T @ white
            cost = float(white @ white - mended @ mended)
        costs.append(cost if np.isfinite(cost) else np.inf)
    return starts[int(np.argmin(costs))]


def _measured_levels(scene: Scene, name: str) -> Array:
    """Levels at which a limit would show in what was measured: of u as sent, which goes beyond a
    limit, and of y as seen, which ends there."""
    if name == "saturation":
        u = np.abs(np.concatenate([t.u for t in scene.trials]))
        return np.quantile(u[np.isfinite(u)], COMMANDS) if np.isfinite(u).any() else np.zeros(0)
    if name == "sensor_nonlinearity":
        return np.quantile(np.abs(np.concatenate([t.y for t in scene.trials])), [0.98, 0.999])
    return np.zeros(0)


def overlooked(
    quiet: Scene, base: Judged, fresh: Sequence[Candidate], listed: Sequence[Candidate]
) -> list[Candidate]:
    """Effects of which a simulation on their `ladder` shows what no first order does: where the motion
    is far from what was measured (a limit that makes the loop swing), a start from which the sum of
    squares falls to a small part."""
    if base.fit.cost < SWINGS * len(base.fit.white):
        return []
    names = {c.spec.name for c in listed}
    out = []
    for c in fresh:
        if EFFECTS[c.spec.name].ladder and c.spec.name not in names:
            names.add(c.spec.name)
            residuals = quiet.residuals(with_best_start(quiet, c.like, c.spec))
            left = np.inf if residuals is None else float(np.sum(quiet.whiten(residuals) ** 2))
            if left < FALLS * base.fit.cost:
                out.append(c)
    return out

"""The rival without a name: a smooth map of position, velocity, direction, command and time.

It is fitted to the whitened residual as a force (or at the output) by smooth basis functions, judged
on held-out recordings, and pruned: variables whose shuffling does not cost anything are not part of
the answer. Where it beats what the catalogue left, something is there that has no name yet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ffl.diagnose.fit import Fit, Scene, fit
from ffl.diagnose.model import Model
from ffl.diagnose.screen import Place, Screen
from ffl.effects import Motion
from ffl.systems.state_space import Array

RIDGE = 1.0  # each coefficient's prior: one standard deviation of the noise in the whitened output


@dataclass(frozen=True)
class Term:
    """Smooth functions of the named variables, (N, k) for one motion."""

    name: str
    variables: tuple[str, ...]
    port: str


@dataclass(frozen=True)
class FreeForm:
    """What the nameless rival found: `gain` on the held-out recordings' log-likelihood, by term."""

    fitted: float
    held_out: float
    terms: tuple[Term, ...]
    variables: tuple[str, ...]
    port: str


TERMS = (
    Term("position", ("position",), "force"),
    Term("velocity", ("velocity",), "force"),
    Term("position and direction", ("position", "direction"), "force"),
    Term("position and velocity", ("position", "velocity"), "force"),
    Term("position and acceleration", ("position", "acceleration"), "force"),
    Term("acceleration and direction", ("acceleration", "direction"), "force"),
    Term("command", ("command",), "command"),
    Term("command and direction", ("command", "direction"), "command"),
    Term("command and position", ("command", "position"), "command"),
    Term("command and velocity", ("command", "velocity"), "command"),
    Term("history of position", ("history", "position"), "force"),
    Term("history of command", ("history", "command"), "command"),
    Term("time", ("time",), "force"),
    Term("position at the sensor", ("position",), "output"),
    Term("time and command", ("time", "command"), "command"),
)


def _hats(x: Array, low: float, high: float, k: int) -> Array:
    grid = np.linspace(low, high, k)
    return np.array([np.interp(x, grid, row) for row in np.eye(k)]).T


def _columns(term: Term, m: Motion, ranges: Mapping[str, tuple[float, float]]) -> Array:
    side = m.direction[:, None]
    x = _hats(m.x, *ranges["x"], 13)
    small = _hats(m.x, *ranges["x"], 6)
    if term.name == "position" or term.port == "output":
        return _hats(m.x, *ranges["x"], 21)
    if term.name == "velocity":
        top = max(abs(v) for v in ranges["v"])
        knots = top * np.array([0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.55, 0.8, 1.0])
        hats = np.array([np.interp(np.abs(m.v), knots, row) for row in np.eye(len(knots))]).T
        return np.hstack([hats * np.maximum(side, 0), hats * np.maximum(-side, 0)])
    if term.name == "position and direction":
        return np.hstack([x * np.maximum(side, 0), x * np.maximum(-side, 0)])
    if term.name == "position and velocity":
        return np.hstack([small * m.v[:, None], small * m.v[:, None] ** 2])
    if term.name == "position and acceleration":
        return np.hstack([small * m.a[:, None], small * m.v[:, None] ** 2])
    if term.name == "acceleration and direction":
        size = np.abs(m.a)[:, None]
        return np.hstack([size * np.maximum(side, 0), size * np.maximum(-side, 0)])
    if term.name == "command":
        return _hats(m.u, *ranges["u"], 13)
    if term.name == "command and direction":
        u = m.u[:, None]
        return np.hstack([np.abs(u) * side, np.maximum(u, 0) * np.maximum(side, 0)])
    if term.name == "command and position":
        return m.u[:, None] * _hats(m.x, *ranges["x"], 21)
    if term.name == "command and velocity":
        speed = _hats(np.abs(m.v), 0.0, max(abs(v) for v in ranges["v"]), 5)
        return np.hstack([np.maximum(m.u, 0)[:, None] * speed, np.minimum(m.u, 0)[:, None] * speed])
    if term.name == "history of position":
        return np.column_stack(
            [_high_pass(m.x, tau, m.sample_time) for tau in (0.03, 0.1, 0.3, 1.0)]
        )
    if term.name == "history of command":
        heat = [_low_pass(m.u**2, tau, m.sample_time) for tau in (0.3, 1.0, 3.0, 10.0)]
        return np.column_stack([m.u * h for h in heat])
    t = m.t - m.t[0]
    duration = max(float(t[-1]), m.sample_time)
    waves = [np.cos(np.pi * k * t / duration) for k in range(8)]
    if term.name == "time and command":
        return np.column_stack([m.u * w for w in waves[:4]])
    return np.column_stack(waves)


def _low_pass(x: Array, tau: float, step: float) -> Array:
    from scipy.signal import lfilter

    a = np.exp(-step / tau)
    return lfilter([1 - a], [1, -a], x)


def _high_pass(x: Array, tau: float, step: float) -> Array:
    return x - x[0] - _low_pass(x - x[0], tau, step)


def _ranges(motions: Sequence[Motion]) -> dict[str, tuple[float, float]]:
    out = {}
    for name in ("x", "v", "u"):
        joined = np.concatenate([getattr(m, name) for m in motions])
        out[name] = (float(joined.min()), float(joined.max()))
    return out


def free_form(scene: Scene, held: Scene | None, model: Model, standing: Fit | None = None):  # type: ignore[no-untyped-def]
    """The best smooth map beside `model`, judged on the held-out recordings; list best first."""
    base = standing or fit(scene, model, rounds=2)
    train = Screen(scene, base)
    own = None
    if held is not None and held.trials:
        from dataclasses import replace

        judged = replace(held, noise=scene.noise)
        residuals = judged.residuals(model)
        if residuals is not None:
            blank = Fit(
                model, judged.whiten(residuals), *[np.zeros((judged.samples, 0))] * 2, "held out"
            )
            own = Screen(judged, blank)
    out = []
    for term in TERMS:
        place = Place(term.port, "motor" if term.port == "force" and _flexible(model) else "sensor")
        motions = train.motions(place)
        ranges = _ranges(motions)
        columns = train.through(place, [_columns(term, m, ranges) for m in motions])
        beyond = columns - train.basis @ (train.basis.T @ columns)
        size = np.linalg.norm(beyond, axis=0)
        kept = size > 1e-6 * max(float(size.max(initial=0.0)), 1e-300)
        if not kept.any():
            continue
        table = beyond[:, kept] / size[kept]
        q, r = np.linalg.qr(np.vstack([table, 1e-3 * np.eye(table.shape[1])]))
        target = q[: len(table)].T @ train.residual
        gain = float(target @ target)
        coefficients = np.zeros(columns.shape[1])
        coefficients[kept] = np.linalg.solve(r, target) / size[kept]
        held_gain = 0.0
        if own is not None:
            seen = own.through(place, [_columns(term, m, ranges) for m in own.motions(place)])
            nuisance = np.linalg.lstsq(scene_basis(train), columns @ coefficients, rcond=None)[0]
            prediction = seen @ coefficients - held_jacobian(own, model, train) @ nuisance
            held_gain = float(own.residual @ own.residual) - float(
                np.sum((own.residual - prediction) ** 2)
            )
        freedom = int(kept.sum())
        out.append(
            FreeForm(0.5 * (gain - freedom), 0.5 * held_gain, (term,), term.variables, term.port)
        )
    return sorted(out, key=lambda f: -(f.fitted + f.held_out))


def scene_basis(screen: Screen) -> Array:
    """Columns of the fitted model's own freedom."""
    return screen.fit.jacobian


def held_jacobian(own: Screen, model: Model, train: Screen) -> Array:
    """What the model's own freedom does to the held-out recordings."""
    from ffl.diagnose.fit import jacobian

    key = "_held_jacobian"
    if not hasattr(own, key):
        base = own.scene.residuals(model)
        setattr(own, key, own.scene.whiten_stacked(jacobian(own.scene, model, base)))
    return getattr(own, key)


def _flexible(model: Model) -> bool:
    return len(model.simulator.mechanics.modes) > 1
